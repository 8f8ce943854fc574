"""Each lidar's driver and an emulated device, in simulated time: echoes must lie on the walls.

The robot turns while it measures, so that a wrong sign, a wrong moment or beams in a wrong order
put them elsewhere.
"""

from collections.abc import Callable

import numpy as np
import pytest
from bench.base.lidars.catalogue import RECORDS
from numpy.typing import NDArray

from trolley.config.hardware import LidarConfig
from trolley.geometry import Pose2D, Twist2D
from trolley_base.drivers.interface import LidarScan
from trolley_base.drivers.lidars import make_lidar
from trolley_base.emulators.catalogue import LIDARS
from trolley_base.emulators.lidar import Mount
from trolley_base.emulators.line import Line
from trolley_base.emulators.port import USB_BAUD
from trolley_base.world import STEP_NS, LidarSpec, Simulation

pytestmark = pytest.mark.drives

MOUNT = Pose2D(0.08, 0.03, 0.6)
NEAR_M = 0.06
"""Half a cell of the map, and the sensor's noise."""
HOST_NS = 2_000_000
"""How often the host reads its port."""
SECONDS = 2.5
MAIN_MODELS = {one.model for one in RECORDS.values() if not one.is_twin}
"""Those whose decoders nobody else tries; the others are tried in the slow run."""
TRIED = [
    pytest.param(one, marks=[pytest.mark.slow] * (one not in MAIN_MODELS))
    for one in (*LIDARS, "rplidar_a1, standard")
]


class Drive:
    """A robot that turns in the room with one lidar: its track, and what the driver made of it."""

    def __init__(self, simulation: Simulation, model: str, mode: str, wz: float) -> None:
        config = LidarConfig(model=model, mode=mode)  # pyrefly: ignore[bad-argument-type]
        dialogue = make_lidar(config)
        device = LIDARS[model](Mount(MOUNT), LidarSpec(), np.random.default_rng(5))
        line = Line(USB_BAUD if device.is_usb else device.baud, device.buffer_bytes)
        device.restart(0)
        dialogue.begin(0)
        self.scans: list[LidarScan] = []
        rows: list[tuple[float, float, float, float]] = []
        for _ in range(round(SECONDS * 1e9) // STEP_NS):
            from_ns = simulation.now_ns
            pose = simulation.truth().pose
            rows.append((from_ns * 1e-9, pose.x, pose.y, pose.yaw))
            simulation.step(Twist2D(0.0, 0.0, wz))
            device.step(simulation, from_ns, from_ns + STEP_NS)
            for now_ns in range(from_ns + HOST_NS, from_ns + STEP_NS + 1, HOST_NS):
                for frame in device.take_frames():
                    line.push(frame.due_ns, frame.data)
                if data := line.take(now_ns):
                    dialogue.receive(data, now_ns)
                if said := dialogue.outgoing(now_ns):
                    device.receive(said, now_ns)
                self.scans += dialogue.take(now_ns).scans
        self._track = np.array(rows)
        self._track[:, 3] = np.unwrap(self._track[:, 3])

    def echoes_in_map(self, scan: LidarScan) -> NDArray[np.float64]:
        """Return the echoes (n, 2) [m] in `map`, each from where the robot was at its moment."""
        beams = np.flatnonzero(np.isfinite(scan.ranges) & (scan.ranges > 0.0))
        at_s = scan.stamp_ns * 1e-9 + beams * scan.time_increment
        x, y, yaw = (np.interp(at_s, self._track[:, 0], self._track[:, i]) for i in (1, 2, 3))
        laser_x = x + np.cos(yaw) * MOUNT.x - np.sin(yaw) * MOUNT.y
        laser_y = y + np.sin(yaw) * MOUNT.x + np.cos(yaw) * MOUNT.y
        angles = yaw + MOUNT.yaw + scan.angle_min + beams * scan.angle_increment
        ahead = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        ranges = scan.ranges[beams, None].astype(np.float64)
        return np.stack([laser_x, laser_y], axis=1) + ranges * ahead


@pytest.mark.parametrize("wz", [1.0, pytest.param(-1.0, marks=pytest.mark.slow)])
@pytest.mark.parametrize("model", TRIED)
def test_echoes_lie_on_the_walls(
    simulate: Callable[..., Simulation], model: str, wz: float
) -> None:
    name, _, mode = model.partition(", ")
    drive = Drive(simulate(), name, mode or "auto", wz)
    scans = drive.scans[1:-1]  # the track holds all of these
    assert len(scans) >= 6
    points = np.abs(np.concatenate([drive.echoes_in_map(scan) for scan in scans]))
    off_m = np.minimum(np.abs(points[:, 0] - 3.0), np.abs(points[:, 1] - 2.0))
    assert np.mean(off_m < NEAR_M) > 0.98, np.percentile(off_m, [50, 90, 99])
    assert all(scan.angle_increment > 0.0 for scan in scans)
