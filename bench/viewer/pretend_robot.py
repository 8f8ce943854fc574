"""A pretend robot for `cost.py` and `thin_link.py`: it says as much as a busy one.

    python -m bench.viewer.pretend_robot --config robot.toml

Scans of 720 beams at 10 Hz with their classes, 2000 particles at 5 Hz, odometry at 30 Hz. Beam 0
tells when its scan was published: its range is 1 m and as many metres as there are seconds of the
host's clock, modulo `SPAN_S`. As the robot's x is always 0, that is the x of the first point. Its y
is as many metres as there are seconds when its odometry was published, so it tells that in turn.
"""

import time

import numpy as np

from trolley import topics
from trolley.config import RobotConfig
from trolley.geometry import Pose2D, Twist2D
from trolley.messages import (
    BaseState,
    BeamClasses,
    Clock,
    OccupancyGrid,
    Odometry,
    ParticleCloud,
    PoseEstimate,
    Robot,
    Scan,
    Transform,
    floats_to_bytes,
)
from trolley.runtime.process import main
from trolley.runtime.service import Service, every

BEAMS, PARTICLES = 720, 2000
SCAN_HZ, PARTICLES_HZ = 10.0, 5.0
SPAN_S = 8.0
NEAREST_M = 1.0
HERE = Pose2D.identity()


class BusyRobot(Service):
    """Stands at the origin of a room of 20 m x 20 m."""

    name = "base"

    def __init__(self, config: RobotConfig) -> None:
        """Needs nothing of the configuration but its name, which the runtime knows."""
        self._random = np.random.default_rng(1)

    def start(self) -> None:
        """Say what does not change."""
        self._epoch_ns = self.monotonic_ns
        self.publish(
            topics.ROBOT,
            Robot(
                stamp_ns=0,
                name=self.robot,
                title="Busy",
                footprint=[(0.2, -0.2), (0.2, 0.2), (-0.2, 0.2), (-0.2, -0.2)],
                drive="differential",
                max_speed=0.6,
                max_wz=1.5,
                deceleration=0.8,
            ),
        )
        cells = np.zeros((400, 400), np.int8)
        cells[[0, -1]], cells[:, [0, -1]] = 100, 100
        self.publish(
            topics.MAP,
            OccupancyGrid(
                stamp_ns=0,
                name="room",
                frame="map",
                resolution=0.05,
                width=400,
                height=400,
                origin=Pose2D(-10.0, -10.0, 0.0),
                cells=memoryview(cells.tobytes()),
            ),
        )
        self._tell_transform("base_link", "laser")

    @every(0.1, clock="local")
    def tell_time(self) -> None:
        """The clock, and what comes with each scan."""
        now_ns = self.monotonic_ns
        self.publish(topics.CLOCK, Clock(stamp_ns=now_ns, rate=1.0, epoch=self._epoch_ns))
        self._tell_transform("map", "odom")
        self.publish(topics.BASE, BaseState(stamp_ns=now_ns, mode="ok"))

    @every(1.0 / 30.0, clock="local")
    def tell_odometry(self) -> None:
        """Sliding to its left; where it is says when it was there."""
        still = Twist2D(0.0, 0.0, 0.0)
        here = Pose2D(0.0, time.time() % SPAN_S, 0.0)
        self.publish(topics.ODOM, Odometry(stamp_ns=self.monotonic_ns, pose=here, twist=still))

    @every(1.0 / SCAN_HZ, clock="local")
    def tell_scan(self) -> None:
        """A scan that is another each time, the pose and the classes of the beams."""
        stamp_ns = self.monotonic_ns
        ranges = self._random.uniform(2.0, 9.0, BEAMS).astype(np.float32)
        ranges[0] = NEAREST_M + time.time() % SPAN_S
        self.publish(
            topics.SCAN,
            Scan(
                stamp_ns=stamp_ns,
                frame="laser",
                angle_min=0.0,
                angle_increment=2.0 * np.pi / BEAMS,
                time_increment=0.0,
                range_min=0.1,
                range_max=12.0,
                ranges=floats_to_bytes(ranges),
            ),
        )
        classes = self._random.integers(0, 3, BEAMS).astype(np.uint8)
        self.publish(
            topics.BEAMS, BeamClasses(stamp_ns=stamp_ns, classes=memoryview(classes.tobytes()))
        )
        self.publish(
            topics.POSE,
            PoseEstimate(
                stamp_ns=stamp_ns,
                map="room",
                pose=HERE,
                covariance=[1e-4, 0.0, 0.0, 0.0, 1e-4, 0.0, 0.0, 0.0, 1e-4],
                state="localized",
                match=0.95,
                spread=0.05,
            ),
        )

    @every(1.0 / PARTICLES_HZ, clock="local")
    def tell_particles(self) -> None:
        """A cloud that is another each time."""
        poses = self._random.normal(0.0, 0.3, (PARTICLES, 3))
        weights = self._random.uniform(0.1, 1.0, PARTICLES)
        self.publish(
            topics.PARTICLES,
            ParticleCloud(
                stamp_ns=self.monotonic_ns,
                poses=floats_to_bytes(poses),
                weights=floats_to_bytes(weights),
            ),
        )

    def _tell_transform(self, parent: str, child: str) -> None:
        link = Transform(stamp_ns=self.monotonic_ns, parent=parent, child=child, pose=HERE)
        self.publish(topics.TF, link, child)


if __name__ == "__main__":
    main(BusyRobot)
