"""A flat with rooms of different shapes, and scans of it without errors."""

import math
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest

from trolley.config.localizer import LocalizerConfig
from trolley.geometry import Pose2D, Twist2D, integrate_twist
from trolley.gridmap import FREE, OCCUPIED, GridMap, cast_rays
from trolley.scanning import ScanInput
from trolley_localizer.core import Localizer
from trolley_localizer.estimate import Estimate
from trolley_localizer.matching.global_search import SearchJob

BEAMS = 360
RESOLUTION = 0.05
RANGE_MAX = 8.0
INCREMENT = 2.0 * math.pi / BEAMS
# The lidar sits in front of the centre and looks to the left.
BASE_T_LASER = Pose2D(0.1, 0.0, 0.5 * math.pi)


def make_flat() -> GridMap:
    """A flat of 8 x 6 m that looks different from everywhere; its origin is turned."""
    cells = np.full((124, 164), OCCUPIED, np.int8)
    cells[2:-2, 2:-2] = FREE
    cells[2:70, 80:82] = OCCUPIED
    cells[70:72, 40:82] = OCCUPIED
    cells[90:104, 120:150] = OCCUPIED
    cells[20:34, 20:26] = OCCUPIED
    cells[40:44, 110:114] = OCCUPIED
    return GridMap("flat", RESOLUTION, Pose2D(1.0, -2.0, 0.3), cells)


def at(grid: GridMap, x: float, y: float, yaw: float) -> Pose2D:
    """A pose given in the grid's own frame [m], in `map`."""
    return grid.origin @ Pose2D(x, y, yaw)


def cast(grid: GridMap, map_T_laser: Pose2D, angles: np.ndarray) -> np.ndarray:
    """The ranges of beams, to the borders of the cells that they hit."""
    pose = grid.origin.inverse() @ map_T_laser
    return cast_rays(
        grid.occupied_mask(), grid.resolution, (pose.x, pose.y), pose.yaw + angles, RANGE_MAX
    )


def make_scan(
    grid: GridMap,
    map_T_base: Pose2D,
    odom_T_base: Pose2D,
    stamp_ns: int = 1,
    twist: Twist2D | None = None,
    sweep_s: float = 0.1,
    turn: "Turn | None" = None,
) -> ScanInput:
    """A scan without noise, taken from a moving robot if a twist is given.

    A negative `sweep_s` is a lidar that turns clockwise: its last beam is the earliest.
    """
    twist = twist or Twist2D.zero()
    turn = turn or Turn()
    increment = 2.0 * math.pi / turn.beams
    angles = turn.angle_min + np.arange(turn.beams) * increment
    if twist.is_zero:
        ranges = cast(grid, map_T_base @ BASE_T_LASER, angles)
    else:
        ranges = np.empty(turn.beams, np.float32)
        for i in range(turn.beams):
            moved = integrate_twist(map_T_base, twist, sweep_s * i / (turn.beams - 1))
            ranges[i] = cast(grid, moved @ BASE_T_LASER, angles[i : i + 1])[0]
    ranges.setflags(write=False)
    return ScanInput(
        stamp_ns=stamp_ns,
        ranges=ranges,
        angle_min=turn.angle_min,
        angle_increment=increment,
        range_min=0.1,
        range_max=RANGE_MAX,
        base_T_laser=BASE_T_LASER,
        odom_T_base=odom_T_base,
        odom_T_base_end=integrate_twist(odom_T_base, twist, sweep_s),
    )


class Turn(NamedTuple):
    """What one turn of the lidar gives; the motors of real ones are not steady."""

    beams: int = BEAMS
    angle_min: float = -math.pi
    """Direction of the first beam [rad]."""


class Drive:
    """A robot that drives through the flat at 10 scans a second, with a localizer on board."""

    def __init__(self, grid: GridMap, localizer: Localizer, start: Pose2D) -> None:
        self.grid = grid
        self.localizer = localizer
        self.pose = start
        self.odom = Pose2D.identity()
        self.stamp_ns = 0
        self.odometry_scale = 1.0
        self.alter: Callable[[np.ndarray], None] = lambda ranges: None
        self.turn: Callable[[], Turn] = Turn

    def scan(self, vx: float = 0.0, wz: float = 0.0, seconds: float = 0.1) -> Estimate:
        """Move on, take a scan, run the search if one is wanted, and return the estimate."""
        self.pose = integrate_twist(self.pose, Twist2D(vx, 0.0, wz), seconds)
        measured = Twist2D(self.odometry_scale * vx, 0.0, self.odometry_scale * wz)
        self.odom = integrate_twist(self.odom, measured, seconds)
        self.stamp_ns += int(seconds * 1e9)
        scan = make_scan(self.grid, self.pose, self.odom, self.stamp_ns, turn=self.turn())
        ranges = scan.ranges.copy()
        self.alter(ranges)
        object.__setattr__(scan, "ranges", ranges)
        estimate = self.localizer.step(scan)
        assert isinstance(estimate, Estimate)
        job = self.localizer.take_job()
        if job is not None:
            self.localizer.finish(job.run())
        return estimate

    def error_m(self, estimate: Estimate) -> float:
        """Distance of an estimate from the truth."""
        return (
            math.inf if estimate.map_T_base is None else estimate.map_T_base.distance_to(self.pose)
        )


LATE = [9, *(pytest.param(late, marks=pytest.mark.slow) for late in (0, 1, 4, 20))]
"""How many scans later a search delivers."""


def make_house() -> GridMap:
    """Two rooms of different shapes, side by side, with a door between them."""
    cells = np.full((100, 260), OCCUPIED, np.int8)
    cells[2:98, 2:128] = FREE
    cells[2:98, 132:258] = FREE
    cells[40:60, 128:132] = FREE
    for r0, r1, c0, c1 in (
        (2, 22, 30, 50), (80, 98, 70, 95), (60, 70, 10, 16),
        (2, 30, 160, 175), (70, 98, 200, 214), (30, 38, 236, 258), (64, 72, 150, 158),
    ):  # fmt: skip
        cells[r0:r1, c0:c1] = OCCUPIED
    return GridMap("house", RESOLUTION, Pose2D(0.0, 0.0, 0.0), cells)


class LateDrive(Drive):
    """A drive on which searches deliver some scans late."""

    def __init__(self, grid: GridMap, localizer: Localizer, start: Pose2D, late: int) -> None:
        super().__init__(grid, localizer, start)
        self._late = late
        self._scans = 0
        self.worst_m = 0.0
        self.searches = 0
        self._jobs: deque[tuple[int, SearchJob]] = deque()

    def look(self) -> Estimate:
        """Take a scan from where the robot is."""
        while self._jobs and self._jobs[0][0] <= self._scans:
            self.localizer.finish(self._jobs.popleft()[1])
        self._scans += 1
        self.stamp_ns += 100_000_000
        scan = make_scan(self.grid, self.pose, self.odom, self.stamp_ns)
        estimate = self.localizer.step(scan)
        assert isinstance(estimate, Estimate)
        job = self.localizer.take_job()
        if job is not None:
            self.searches += 1
            self._jobs.append((self._scans + self._late, job.run()))
        self.worst_m = max(self.worst_m, self.error_m(estimate))
        return estimate

    def go(self, metres: float, scale: float = 1.03) -> list[Estimate]:
        """Drive straight on; the odometry is off by a factor."""
        found: list[Estimate] = []
        for _ in range(round(abs(metres) / 0.05)):
            step = math.copysign(0.05, metres)
            self.pose = self.pose @ Pose2D(step, 0.0, 0.0)
            self.odom = self.odom @ Pose2D(scale * step, 0.0, 0.0)
            found.append(self.look())
        return found

    def arc(self, vx: float, wz: float, scans: int) -> list[Estimate]:
        """Drive along an arc at 10 scans a second."""
        step = integrate_twist(Pose2D.identity(), Twist2D(vx, 0.0, wz), 0.1)
        found: list[Estimate] = []
        for _ in range(scans):
            self.pose, self.odom = self.pose @ step, self.odom @ step
            found.append(self.look())
        return found

    def stand(self, scans: int) -> list[Estimate]:
        return [self.look() for _ in range(scans)]


@pytest.fixture(scope="session")
def flat() -> GridMap:
    return make_flat()


@pytest.fixture
def make_drive(flat: GridMap) -> Callable[..., Drive]:
    """A drive that begins at x, y, yaw in the grid's frame."""

    def make(x: float = 5.5, y: float = 3.0, yaw: float = 0.4, seed: int = 0) -> Drive:
        return Drive(flat, Localizer(flat, [], LocalizerConfig(), seed), at(flat, x, y, yaw))

    return make
