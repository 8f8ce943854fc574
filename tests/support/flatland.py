"""A robot in a plane of cells, without errors: what the planner's tests drive.

The robot obeys every command at once, unless it would touch something: then it stands and the touch
is counted. Its lidar sees a grid of what really stands there, which may differ from the map.
"""

import math
from dataclasses import dataclass, field
from functools import lru_cache

import msgspec
import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D, Twist2D, integrate_twist
from trolley.gridmap import FREE, OCCUPIED, GridMap, cast_rays, distance_transform
from trolley.messages import (
    OccupancyGrid,
    Odometry,
    PoseEstimate,
    Robot,
    Scan,
    Transform,
    Zone,
    Zones,
)
from trolley.messages.types import floats_to_bytes

BOX = [(0.15, 0.12), (-0.15, 0.12), (-0.15, -0.12), (0.15, -0.12)]
RANGE_MAX = 8.0
BEAMS = 360
# Touches are judged by parts of cells.
FINE_PARTS = 5
# Between the true map and the odometry: the planner must not mix the two up.
MAP_T_ODOM = Pose2D(0.4, -0.3, 0.5)


def empty_room(
    width_m: float = 8.0, height_m: float = 6.0, edge_m: float = 0.05, origin: Pose2D | None = None
) -> GridMap:
    """A room with walls of two cells."""
    cells = np.full((round(height_m / edge_m), round(width_m / edge_m)), FREE, dtype=np.int8)
    cells[:2] = cells[-2:] = cells[:, :2] = cells[:, -2:] = OCCUPIED
    return GridMap("room", edge_m, origin or Pose2D.identity(), cells)


def with_block(grid: GridMap, x: float, y: float, width: float, height: float) -> GridMap:
    """The same with a block, given in frame `grid` by its corner and size [m]."""
    cells = grid.cells.copy()
    rows = slice(round(y / grid.resolution), round((y + height) / grid.resolution))
    cols = slice(round(x / grid.resolution), round((x + width) / grid.resolution))
    cells[rows, cols] = OCCUPIED
    return GridMap(grid.name, grid.resolution, grid.origin, cells)


def two_rooms(door_m: float = 0.8) -> GridMap:
    """Two rooms of 4 x 6 m with a door between them in the middle."""
    walled = with_block(empty_room(), 3.95, 0.0, 0.1, 3.0 - door_m / 2.0)
    return with_block(walled, 3.95, 3.0 + door_m / 2.0, 0.1, 3.0 - door_m / 2.0)


@lru_cache(maxsize=8)
def fine_distance(occupied: bytes, shape: tuple[int, int], fine_m: float) -> NDArray[np.float32]:
    """From each part of a cell to the nearest part of an occupied cell [m].

    Kept, since most tests drive in the same few rooms.
    """
    mask = np.frombuffer(occupied, np.bool_).reshape(shape)
    return distance_transform(mask.repeat(FINE_PARTS, 0).repeat(FINE_PARTS, 1), fine_m)


@dataclass
class Flatland:
    """The true world, and the messages that it gives.

    Poses are in the frame of the map's corner (`grid`); messages are in `map` and `odom`.
    """

    grid: GridMap
    pose: Pose2D
    truth: GridMap | None = None
    footprint: list[tuple[float, float]] = field(default_factory=lambda: list(BOX))
    base_T_laser: Pose2D = field(default_factory=lambda: Pose2D(0.05, 0.0, 0.7))
    zones: list[Zone] = field(default_factory=list)
    twist: Twist2D = field(default_factory=Twist2D.zero)
    touches: int = 0
    clearance: float = math.inf
    """The smallest so far [m]."""

    def __post_init__(self) -> None:
        self.odom_T_base = MAP_T_ODOM.inverse() @ self.grid.origin @ self.pose
        corners = np.array(self.footprint)
        shares = np.linspace(0.0, 1.0, 12, endpoint=False)[:, None]
        self._outline = np.concatenate(
            [a + shares * (b - a) for a, b in zip(corners, np.roll(corners, -1, 0), strict=True)]
        )
        self._lasting: NDArray[np.bool_] | NDArray[np.uint8] | None = None
        self.set_truth(self.truth or self.grid)

    def set_truth(self, truth: GridMap) -> None:
        """Let something else stand around from now on."""
        self.truth = truth
        self._occupied = occupied = truth.occupied_mask()
        self._fine_m = truth.resolution / FINE_PARTS
        lasting = self._lasting
        if lasting is None or lasting.shape != truth.cells.shape or (lasting & ~occupied).any():
            lasting = occupied
            self._distance = fine_distance(occupied.tobytes(), occupied.shape, self._fine_m)
        # What came to it since, such as people who walk: a few cells, for which the distance
        # everywhere is not computed anew.
        self._lasting, self._added = lasting, FINE_PARTS * np.argwhere(occupied & ~lasting)

    @property
    def map_T_base(self) -> Pose2D:
        return self.grid.origin @ self.pose

    def drive(self, twist: Twist2D, dt: float) -> None:
        """Move for a while, but not into anything."""
        moved = integrate_twist(self.pose, twist, dt)
        clearance = self.clearance_at(moved)
        if clearance <= 0.0 and not twist.is_zero and clearance < self.clearance_at(self.pose):
            self.touches += 1
            self.twist = Twist2D.zero()
            return
        self.pose, self.twist = moved, twist
        self.odom_T_base = integrate_twist(self.odom_T_base, twist, dt)
        self.clearance = min(self.clearance, clearance)

    def clearance_at(self, pose: Pose2D) -> float:
        """From the outline to the nearest border of an occupied cell, to about a centimetre."""
        points = pose.transform_points(self._outline) / self._fine_m
        cells = np.floor(points[:, ::-1]).astype(int)
        if (cells < 0).any() or (cells >= self._distance.shape).any():
            return 0.0
        nearest = float(self._distance[cells[:, 0], cells[:, 1]].min())
        if len(self._added):
            before = self._added - cells[:, None]  # [fine cells], to the first of each cell
            away = np.maximum(np.maximum(before, 1 - FINE_PARTS - before), 0)
            nearest = min(nearest, float(np.hypot(*np.moveaxis(away, -1, 0)).min()) * self._fine_m)
        return nearest - self._fine_m

    # Messages.

    def robot(self) -> Robot:
        return Robot(
            stamp_ns=0,
            name="flat",
            title="",
            footprint=self.footprint,
            drive="differential",
            max_speed=0.5,
            max_wz=1.5,
            deceleration=1.0,
        )

    def map(self) -> OccupancyGrid:
        return OccupancyGrid(
            stamp_ns=0,
            name=self.grid.name,
            frame="map",
            resolution=self.grid.resolution,
            width=self.grid.cols,
            height=self.grid.rows,
            origin=self.grid.origin,
            cells=memoryview(self.grid.cells.tobytes()),
        )

    def zone_list(self) -> Zones:
        return Zones(stamp_ns=0, map=self.grid.name, zones=self.zones)

    def mounting(self) -> Transform:
        return Transform(stamp_ns=0, parent="base_link", child="laser", pose=self.base_T_laser)

    def correction(self, stamp_ns: int) -> Transform:
        return Transform(stamp_ns=stamp_ns, parent="map", child="odom", pose=MAP_T_ODOM)

    def odometry(self, stamp_ns: int) -> Odometry:
        return Odometry(stamp_ns=stamp_ns, pose=self.odom_T_base, twist=self.twist)

    def estimate(
        self, stamp_ns: int, state: str = "localized", off_map: float | None = None
    ) -> PoseEstimate:
        return PoseEstimate(
            stamp_ns=stamp_ns,
            map=self.grid.name,
            pose=self.map_T_base,
            covariance=[0.0] * 9,
            state=state,  # pyrefly: ignore[bad-argument-type]
            match=1.0,
            spread=0.0,
            off_map=off_map,
        )

    def scan(self, stamp_ns: int) -> Scan:
        return scan_message(self.ranges(), stamp_ns)

    def ranges(self) -> NDArray[np.float32]:
        """What the lidar measures from where the robot is."""
        truth = self.truth or self.grid
        laser = self.pose @ self.base_T_laser
        angles = laser.yaw + np.arange(BEAMS) * (2.0 * math.pi / BEAMS)
        return cast_rays(self._occupied, truth.resolution, (laser.x, laser.y), angles, RANGE_MAX)


def scan_message(ranges: NDArray[np.float32], stamp_ns: int) -> Scan:
    """A scan of one revolution, taken in an instant."""
    return Scan(
        stamp_ns=stamp_ns,
        frame="laser",
        angle_min=0.0,
        angle_increment=2.0 * math.pi / len(ranges),
        time_increment=0.0,
        range_min=0.05,
        range_max=RANGE_MAX,
        ranges=floats_to_bytes(ranges),
    )


class Ice(Flatland):
    """The wheels turn, the robot stays; the localizer sees that."""

    def drive(self, twist: Twist2D, dt: float) -> None:
        stays = self.pose
        super().drive(twist, dt)
        self.pose = stays

    def correction(self, stamp_ns: int):
        true = self.map_T_base @ self.odom_T_base.inverse()
        return msgspec.structs.replace(super().correction(stamp_ns), pose=true)


class HalfBlind(Flatland):
    """The lidar sees half a circle, ahead."""

    def scan(self, stamp_ns: int) -> Scan:
        around = np.roll(self.ranges(), BEAMS // 4)[: BEAMS // 2 + 1].copy()
        ahead = {"angle_min": -0.5 * math.pi, "angle_increment": 2.0 * math.pi / BEAMS}
        return msgspec.structs.replace(scan_message(around, stamp_ns), **ahead)


class Masked(Flatland):
    """The lidar sees all round, but for a third behind, where the robot itself is masked."""

    def ranges(self) -> NDArray[np.float32]:
        ranges = super().ranges()
        ranges[BEAMS // 3 : -(BEAMS // 3)] = 0.0
        return ranges
