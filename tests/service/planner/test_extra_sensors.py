"""The planner drives around what an extra sensor sees and the lidar does not."""

import math
from pathlib import Path

import numpy as np
from msgspec import convert
from support.flatland import Flatland, two_rooms

from trolley import topics
from trolley.geometry import Pose2D
from trolley.messages import Scan, floats_to_bytes
from trolley_planner.service import PlannerService

from .conftest import START, Stage

THERE = Pose2D(3.2, 3.0, 0.0)
BOX_M = (2.2, 3.0, 0.2)
"""Something low on the straight way: x, y and half of its width."""


class WithCamera(Stage):
    """A stage whose planner knows a camera ahead."""

    def __init__(self, folder: Path, listed: dict[str, object]) -> None:
        super().__init__(folder, Flatland(two_rooms(), START))
        plain = {"robot": {"name": "trolley", "footprint": {"length_m": 0.4, "width_m": 0.3}}}
        config = convert(plain | {"base": {"scans": listed}}, type(self.config))
        self.lockstep.kill("planner")
        self.planner = self.lockstep.add(PlannerService(config))
        self.lockstep.run(0.5)
        self.nearest_m = math.inf

    def look(self) -> bool:
        """Publish what the camera sees; say whether the robot has arrived."""
        pose, (x, y, half) = self.world.pose, BOX_M
        angles = np.radians(np.arange(-35.0, 35.5, 1.0))
        steps = np.arange(0.2, 3.0, 0.02)
        along = pose.yaw + angles
        xs = pose.x + steps * np.cos(along)[:, None]
        ys = pose.y + steps * np.sin(along)[:, None]
        hit = (np.abs(xs - x) < half) & (np.abs(ys - y) < half)
        ranges = np.where(hit.any(axis=1), steps[hit.argmax(axis=1)], math.inf)
        message = Scan(
            stamp_ns=self.robot.robot_ns,
            frame="front",
            angle_min=float(angles[0]),
            angle_increment=math.radians(1.0),
            time_increment=0.0,
            range_min=0.2,
            range_max=3.0,
            ranges=floats_to_bytes(ranges),
        )
        self.publish(message)
        self.nearest_m = min(self.nearest_m, math.hypot(pose.x - x, pose.y - y))
        return self.goals[-1].state == "arrived"

    def publish(self, message: Scan) -> None:
        """Say what the camera sees."""
        self.robot.publish(topics.EXTRA_SCAN, message, "front")

    def drive(self, there: Pose2D) -> None:
        self.send(there)
        self.lockstep.run_until(self.look, 60.0)


def nearest_on_the_way(folder: Path, listed: dict[str, object]) -> float:
    stage = WithCamera(folder, listed)
    try:
        stage.drive(THERE)
        assert stage.goals[-1].state == "arrived"
        return stage.nearest_m
    finally:
        stage.lockstep.close()


def test_it_drives_around_what_only_the_camera_sees(tmp_path: Path) -> None:
    half = BOX_M[2]
    assert nearest_on_the_way(tmp_path / "with", {"front": {}}) > half + 0.12
    assert nearest_on_the_way(tmp_path / "stops", {"front": {"uses": ["stop"]}}) < half
