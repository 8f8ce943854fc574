"""The emulated lidars' bytes, read by decoders that others wrote: what they see lies on the walls.

lds2d is a port of kaiaai/LDS to Python. Its angles are the sensor's own, turned to grow clockwise
where they do not.
"""

from collections.abc import Callable, Iterator
from typing import Any

import lds2d
import numpy as np
import pytest
from support.room_with_posts import THINGS, distances_to_walls

from trolley.geometry import Pose2D, Twist2D
from trolley_base.emulators.catalogue import LIDARS
from trolley_base.emulators.lidar import Mount, SpinningLidar
from trolley_base.emulators.line import Line
from trolley_base.emulators.port import USB_BAUD
from trolley_base.world import STEP_NS, LidarSpec, Simulation

PERFECT = LidarSpec(noise_m=0.0, noise_share=0.0, drop_out=0.0, invalid=0.0)
TURNS = 3
NAMES = {
    "camsense_x1": "CAMSENSE-X1",
    "coin_d4": "COIN-D4",
    "delta2a": "DELTA-2A",
    "delta2b": "DELTA-2B",
    "ld19": "LD19",
    "lds02rr": "LDS02RR",
    "rplidar_a1": "RPLIDAR-A1",
    "rplidar_c1": "RPLIDAR-C1",
    "xv11": "XV11",
    "ydlidar_x2": "YDLIDAR-X2",
    "ydlidar_x4": "YDLIDAR-X4",
    "ydlidar_x4_pro": "YDLIDAR-X4-PRO",
}
"""What the library calls them. Left out are an LD14P, whose oblique beams it does not correct; an
LDS-01, whose sum it takes in another way than the maker; a T-mini, of which it reads firmware
without intensities."""
NEAR_M = {"coin_d4": 0.05}
"""How near most echoes are to a wall; the library rounds the steps between a COIN-D4's beams down
to 1/64 of a degree."""


class EndOfTestError(Exception):
    """The library reads for ever."""


class Cable:
    """An emulated lidar on a line, in simulated time, as a port that the library reads."""

    def __init__(self, device: SpinningLidar, simulation: Simulation, seconds: float) -> None:
        self._device, self._simulation = device, simulation
        self._line = Line(USB_BAUD if device.is_usb else device.baud, device.buffer_bytes)
        self._steps_left = round(seconds * 1e9) // STEP_NS
        self._waiting = bytearray()
        device.restart(0)

    def read(self, size: int) -> bytes:
        while len(self._waiting) < size:
            self._step()
        taken = bytes(self._waiting[:size])
        del self._waiting[:size]
        return taken

    def write(self, data: bytes) -> int:
        self._device.receive(data, self._simulation.now_ns)
        return len(data)

    def _step(self) -> None:
        if not self._steps_left:
            raise EndOfTestError
        self._steps_left -= 1
        from_ns = self._simulation.now_ns
        self._simulation.step(Twist2D.zero())
        self._device.step(self._simulation, from_ns, from_ns + STEP_NS)
        for frame in self._device.take_frames():
            self._line.push(frame.due_ns, frame.data)
        self._waiting += self._line.take(from_ns + STEP_NS)


class NoMotor:
    """The motor turns by itself here."""

    def set_duty(self, duty: float) -> None:
        """Change nothing."""


def points(name: str, cable: Cable) -> Iterator[Any]:
    driver = lds2d.core.driver_for(name)
    assert driver is not None
    options: dict[str, Any] = {"motor": NoMotor()} if driver.NEEDS_MOTOR else {}
    reader = driver(cable, **options)
    try:
        reader.start()
    except lds2d.NotSupportedError:
        assert name in ("CAMSENSE-X1", "LD19")  # which cannot be told to
    try:
        yield from reader.points()
    except EndOfTestError:
        return


@pytest.mark.parametrize("model", NAMES)
def test_another_decoder_sees_the_walls_where_they_are(
    model: str, simulate: Callable[..., Simulation]
) -> None:
    device = LIDARS[model](Mount(Pose2D.identity()), PERFECT, np.random.default_rng(1))
    cable = Cable(device, simulate(THINGS), TURNS / device.facts.turns_hz + 0.1)
    read = np.array([(one.angle_deg, one.dist_mm) for one in points(NAMES[model], cable)])
    seen = read[read[:, 1] > 0.0]
    turns = np.ptp(np.unwrap(seen[:, 0], period=360.0)) / 360.0
    assert turns > TURNS - 1.2
    off = np.abs(distances_to_walls(-np.radians(seen[:, 0])) - seen[:, 1] / 1000.0)
    assert np.percentile(off, 95.0) < NEAR_M.get(model, 0.003)
    assert np.median(off) < 0.001
