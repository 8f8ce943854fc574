"""A flat, and a robot that drives through it with a mapper on board."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from trolley.config.mapper import MapperConfig
from trolley.geometry import Pose2D, Twist2D, integrate_twist
from trolley.gridmap import FREE, OCCUPIED, GridMap, cast_rays
from trolley.scanning import ScanInput
from trolley.slices import whole
from trolley_mapper.slam.estimate import MapEstimate
from trolley_mapper.slam.mapper import Mapper

BEAMS = 180
RANGE_MAX = 8.0
BASE_T_LASER = Pose2D(0.1, 0.0, 0.5 * math.pi)
START = Pose2D(5.5, 1.0, 1.5)


def make_flat() -> GridMap:
    """A flat of 8 x 6 m that looks different from everywhere."""
    cells = np.full((124, 164), OCCUPIED, np.int8)
    cells[2:-2, 2:-2] = FREE
    cells[2:70, 80:82] = OCCUPIED
    cells[70:72, 40:82] = OCCUPIED
    cells[90:104, 120:150] = OCCUPIED
    cells[20:34, 20:26] = OCCUPIED
    cells[40:44, 110:114] = OCCUPIED
    return GridMap("flat", 0.05, Pose2D.identity(), cells)


class Drive:
    """Ten scans a second; `pose` is true, the mapper's map begins at the true start."""

    def __init__(self, grid: GridMap, mapper: Mapper, start: Pose2D = START) -> None:
        self.grid = grid
        self.mapper = mapper
        self.pose = start
        self.odom = Pose2D.identity()
        self.stamp_ns = 0
        self.odometry_scale = 1.0
        # Besides, of turns alone.
        self.odometry_turn_scale = 1.0
        # What the wheels tell of the time of a scan, in which the robot stands still.
        self.told_in_scan = Pose2D.identity()
        self.is_covered = False
        self.rng = np.random.default_rng(0)
        self.last: MapEstimate | None = None

    def scan(self, vx: float = 0.0, wz: float = 0.0, seconds: float = 0.1) -> MapEstimate:
        """Move on, take a scan, run the job if there is one."""
        self.pose = integrate_twist(self.pose, Twist2D(vx, 0.0, wz), seconds)
        told = Twist2D(
            self.odometry_scale * vx, 0.0, self.odometry_scale * self.odometry_turn_scale * wz
        )
        self.odom = integrate_twist(self.odom, told, seconds)
        return self.look(seconds)

    def look(self, seconds: float = 0.1) -> MapEstimate:
        """Take a scan from where the robot is."""
        self.stamp_ns += round(seconds * 1e9)
        estimate = self.mapper.step(self.make_scan())
        assert isinstance(estimate, MapEstimate)
        job = self.mapper.take_job()
        if job is not None:
            whole(job.slices())
            self.mapper.finish(job)
        self.last = estimate
        return estimate

    def make_scan(self) -> ScanInput:
        at = self.pose @ BASE_T_LASER
        angles = at.yaw - math.pi + np.arange(BEAMS) * (2.0 * math.pi / BEAMS)
        ranges = cast_rays(self.grid.occupied_mask(), 0.05, (at.x, at.y), angles, RANGE_MAX)
        ranges = (ranges + 0.01 * self.rng.standard_normal(BEAMS)).astype(np.float32)
        if self.is_covered:
            ranges[:] = 0.12
        ranges.setflags(write=False)
        return ScanInput(
            stamp_ns=self.stamp_ns + 1,
            ranges=ranges,
            angle_min=-math.pi,
            angle_increment=2.0 * math.pi / BEAMS,
            range_min=0.1,
            range_max=RANGE_MAX,
            base_T_laser=BASE_T_LASER,
            odom_T_base=self.odom,
            odom_T_base_end=self.odom @ self.told_in_scan,
        )

    def tour(self) -> None:
        """Through the right half, round the corner and into the left."""
        self.scan()
        for vx, wz, count in ((0.5, 0.0, 60), (0.0, 0.8, 20), (0.5, 0.0, 60), (0.0, 0.8, 18)):
            for _ in range(count):
                self.scan(vx, wz)
        for _ in range(40):
            self.scan(0.5, 0.0)

    def error_m(self) -> float:
        """How far the mapper's last pose is from the true one."""
        assert self.last is not None
        return self.last.pose.distance_to(self.pose)


@pytest.fixture(scope="session")
def flat() -> GridMap:
    return make_flat()


@pytest.fixture
def make_drive(flat: GridMap) -> Callable[..., Drive]:
    def make(mapper: Mapper | None = None, start: Pose2D = START) -> Drive:
        return Drive(flat, mapper or Mapper(MapperConfig(), start), start)

    return make
