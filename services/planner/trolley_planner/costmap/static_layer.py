"""The static layer of the costmap: map and zones as arrays."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.geometry.polygon import polygon_contains
from trolley.gridmap import OCCUPIED_FROM, UNKNOWN, GridMap, distance_transform
from trolley.gridmap.segments import draw_segments, line_segments
from trolley.messages import Zone
from trolley.zones import LINE_KINDS
from trolley_planner.costmap.inflation import FREE, LETHAL, TABLE_STEP_M, WALL, weigh_into
from trolley_planner.costmap.inflation import UNKNOWN as UNKNOWN_KIND


@dataclass(frozen=True, slots=True)
class SpeedZoneParams:
    """How the robot slows down before a speed zone; by hand."""

    braking_mps2: float = 0.5
    """Deceleration before the zone."""
    early_m: float = 0.1
    """Distance before the zone at which its limit already holds, since the robot follows commands
    late."""
    reach_m: float = 1.2
    """Distance from the zone beyond which it has no effect."""
    most_mps: float = 100.0
    """A higher limit counts as this: its square must be a number, and no robot gets near it."""


SPEED_ZONES = SpeedZoneParams()


class StaticLayer:
    """Map and zones; all arrays have the shape (rows, cols) and lie in frame `grid`.

    Args:
        grid: the map.
        table: weights by the distance to the nearest obstacle, in steps of `TABLE_STEP_M`.
        unknown_is_free: whether cells that nobody has seen may be passed.
    """

    def __init__(self, grid: GridMap, table: NDArray[np.uint8], unknown_is_free: bool) -> None:
        self._map_kinds = map_kinds(grid.cells)
        self._resolution_m = grid.resolution
        self._grid_T_frame = grid.origin.inverse()
        self._table = table
        self._unknown_is_free = unknown_is_free
        self._zones: list[Zone] = []
        self._leaving: tuple[str, ...] = ()
        self._suspects = np.empty((0, 4))
        self.set_zones([])

    def set_zones(self, zones: Sequence[Zone]) -> None:
        """Replace the zones (points in the frame of the goals)."""
        self._zones = list(zones)
        self.mirrors = line_segments(mirror_polylines(zones), self._grid_T_frame)
        """(m, 4) x1, y1, x2, y2 [m] of mirrors and glass."""
        self.kinds = self._map_kinds.copy()
        """FREE, UNKNOWN or WALL."""
        draw_segments(self.kinds, self.mirrors, self._resolution_m, WALL)
        self.walls = (self.kinds == WALL).astype(np.uint8)
        """Set where a beam ends for certain."""
        reach_m = self._table.shape[0] * TABLE_STEP_M
        self.wall_distance_m = distance_transform(self.walls, self._resolution_m, reach_m)
        """Distance to the nearest of these, up to the inflation's reach [m]."""
        shape = self.kinds.shape[0], self.kinds.shape[1]
        self.speed_limits = speed_limits(shape, zones, self._grid_T_frame, self._resolution_m)
        """Lowest speed of the zones over each cell [m/s], +inf where there is none."""
        self.has_speed_limits = bool(np.isfinite(self.speed_limits).any())
        self._leaving = ()
        self._inflate()

    def set_suspects(self, lines: Sequence[Sequence[tuple[float, float]]]) -> None:
        """Replace the lines on which mirrors are suspected (points in the frame of the goals)."""
        self._suspects = line_segments(lines, self._grid_T_frame)

    @property
    def reflecting(self) -> NDArray[np.float64]:
        """(m, 4) x1, y1, x2, y2 [m] of mirrors, glass and suspected mirrors."""
        return np.concatenate([self.mirrors, self._suspects])

    def set_position(self, x: float, y: float) -> bool:
        """Open the keep-out zones that hold the robot; True if that changes anything.

        Args:
            x: in the frame of the goals [m].
            y: in the frame of the goals [m].
        """
        leaving = tuple(zone.name for zone in self.keepouts_at(x, y))
        if leaving == self._leaving:
            return False
        self._leaving = leaving
        self._inflate()
        return True

    def keepouts_at(self, x: float, y: float) -> list[Zone]:
        """Return the keep-out zones that hold a point of the frame of the goals [m]."""
        point = np.array([[x, y]])
        return [
            zone
            for zone in self._zones
            if zone.kind == "keepout" and polygon_contains(np.array(zone.points), point)[0]
        ]

    def is_unknown(self, x_grid: float, y_grid: float) -> bool:
        """Say whether the map knows nothing of a point of `grid` [m] on the costmap."""
        return bool(self.kinds[self._cell(x_grid, y_grid)] == UNKNOWN_KIND)

    def is_wall(self, x_grid: float, y_grid: float) -> bool:
        """Say whether a point of `grid` [m] on the costmap lies in a wall, mirror or pane."""
        return bool(self.walls[self._cell(x_grid, y_grid)])

    def _cell(self, x_grid: float, y_grid: float) -> tuple[int, int]:
        return int(y_grid / self._resolution_m), int(x_grid / self._resolution_m)

    def _inflate(self) -> None:
        """Recompute distances and weights after the map or the zones changed."""
        shape = self.kinds.shape[0], self.kinds.shape[1]
        self.keepout = np.zeros(shape, dtype=np.uint8)
        """(rows, cols) 1 in keep-out zones, except those that the robot is in and must leave."""
        leaving = np.zeros(shape, dtype=np.bool_)
        for zone in self._zones:
            if zone.kind == "keepout":
                points = zone_points(zone, self._grid_T_frame)
                mask = polygon_mask(shape, points, self._resolution_m)
                if zone.name in self._leaving:
                    leaving |= mask
                else:
                    self.keepout[mask] = 1
        self.leaving = leaving if self._leaving else None
        """(rows, cols) cells of the zones that the robot must leave; None if there are none."""
        blocked = self.walls | self.keepout
        if not self._unknown_is_free:
            blocked |= (self.kinds == UNKNOWN_KIND).astype(np.uint8)
        reach_m = self._table.shape[0] * TABLE_STEP_M
        self.distance_m = distance_transform(blocked, self._resolution_m, reach_m)
        """Distance to the nearest obstacle of map and zones, up to the inflation's reach [m]."""
        self.weights = np.empty(shape, dtype=np.uint8)
        """Weights by map and zones alone (units: `WEIGHT_UNIT`)."""
        weigh_into(self.weights, self.distance_m, self._table, TABLE_STEP_M)
        close_border(self.weights)


def close_border(weights: NDArray[np.uint8]) -> None:
    """Make the outermost cells lethal: a search then needs no test for the grid's edge."""
    weights[0, :] = weights[-1, :] = LETHAL
    weights[:, 0] = weights[:, -1] = LETHAL


def map_kinds(cells: NDArray[np.int8]) -> NDArray[np.uint8]:
    """Return FREE, UNKNOWN or WALL for each cell of a map (rows, cols)."""
    kinds = np.full(cells.shape, FREE, dtype=np.uint8)
    kinds[cells == UNKNOWN] = UNKNOWN_KIND
    kinds[cells >= OCCUPIED_FROM] = WALL
    return kinds


def zone_points(zone: Zone, grid_T_map: Pose2D) -> NDArray[np.float64]:
    """Return the points of a zone (n, 2) in frame `grid` [m]."""
    return grid_T_map.transform_points(np.array(zone.points, dtype=np.float64))


def mirror_polylines(zones: Sequence[Zone]) -> list[list[tuple[float, float]]]:
    """Return the points of all mirrors and glass."""
    return [zone.points for zone in zones if zone.kind in LINE_KINDS]


def polygon_mask(
    shape: tuple[int, int], points: NDArray[np.float64], resolution_m: float
) -> NDArray[np.bool_]:
    """Return (rows, cols), true where a cell's centre lies in a polygon (n, 2) in `grid` [m].

    Source:
        Shimrat, Algorithm 112: Position of point relative to polygon (1962), crossings of a ray.
    """
    xs = (np.arange(shape[1]) + 0.5) * resolution_m
    ys = (np.arange(shape[0]) + 0.5) * resolution_m
    inside = np.zeros(shape, dtype=np.bool_)
    for (x1, y1), (x2, y2) in zip(points, np.roll(points, -1, axis=0), strict=True):
        rows = np.flatnonzero((ys < y1) != (ys < y2))
        if rows.size:
            crossing = x1 + (ys[rows] - y1) * (x2 - x1) / (y2 - y1)
            inside[rows] ^= xs[None, :] < crossing[:, None]
    return inside


def disc_mask(
    shape: tuple[int, int], centre: tuple[float, float], radius_m: float, resolution_m: float
) -> NDArray[np.bool_]:
    """Return (rows, cols), true where a cell's centre lies in a circle in `grid` [m]."""
    xs = (np.arange(shape[1]) + 0.5) * resolution_m - centre[0]
    ys = (np.arange(shape[0]) + 0.5) * resolution_m - centre[1]
    return np.hypot(xs[None, :], ys[:, None]) <= radius_m


def speed_limits(
    shape: tuple[int, int], zones: Sequence[Zone], grid_T_map: Pose2D, resolution_m: float
) -> NDArray[np.float32]:
    """Return the lowest speed limit of each cell (rows, cols) [m/s], +inf where there is none.

    In front of a zone it falls to the zone's speed, so that the robot is slow when it gets there.
    """
    limits = np.full(shape, np.inf, dtype=np.float32)
    for zone in zones:
        if zone.kind == "speed" and zone.speed is not None:
            mask = polygon_mask(shape, zone_points(zone, grid_T_map), resolution_m)
            if not mask.any():
                continue
            speed = min(zone.speed, SPEED_ZONES.most_mps)
            away = distance_transform(mask, resolution_m, SPEED_ZONES.reach_m)
            remaining_goal = np.maximum(away - np.float32(SPEED_ZONES.early_m), np.float32(0.0))
            before = np.sqrt(
                speed**2 + 2.0 * SPEED_ZONES.braking_mps2 * remaining_goal, dtype=np.float32
            )
            before[away >= SPEED_ZONES.reach_m] = np.inf
            limits = np.minimum(limits, np.where(mask, np.float32(speed), before))
    return limits
