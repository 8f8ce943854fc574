"""The static layer of the costmap: map and zones as arrays."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.gridmap import OCCUPIED_FROM, UNKNOWN, distance_transform
from trolley.messages import Zone
from trolley.zones import LINE_KINDS
from trolley_planner.costmap.inflation import FREE, WALL
from trolley_planner.costmap.inflation import UNKNOWN as UNKNOWN_KIND


@dataclass(frozen=True, slots=True)
class SpeedZoneParams:
    """How the robot slows down before a speed zone; by hand."""

    braking_mps2: float = 0.5
    """Deceleration before the zone."""
    early_m: float = 0.1
    """The robot is slow this much before the zone, since it follows commands late."""
    reach_m: float = 1.2
    """Farther away than this the zone does not matter yet."""


SPEED_ZONES = SpeedZoneParams()


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


def line_segments(
    lines: Sequence[Sequence[tuple[float, float]]], grid_T_map: Pose2D
) -> NDArray[np.float64]:
    """Return the segments (m, 4) x1, y1, x2, y2 [m] of lines, in `grid`."""
    segments = [np.empty((0, 4))]
    for line in lines:
        points = grid_T_map.transform_points(np.array(line, dtype=np.float64).reshape(-1, 2))
        segments.append(np.hstack([points[:-1], points[1:]]))
    return np.concatenate(segments)


def draw_segments(
    grid: NDArray[np.uint8], segments: NDArray[np.float64], resolution_m: float, value: int
) -> None:
    """Set every cell that a segment (m, 4) [m] passes.

    Points are set a quarter of a cell apart, so that a cell is left out only where the line cuts
    off a corner of less than that.
    """
    rows, cols = grid.shape
    for segment in segments / resolution_m:
        x1, y1, x2, y2 = (float(value) for value in segment)
        count = max(2, math.ceil(4.0 * math.hypot(x2 - x1, y2 - y1)) + 1)
        along_cols = np.floor(np.linspace(x1, x2, count)).astype(np.int64)
        along_rows = np.floor(np.linspace(y1, y2, count)).astype(np.int64)
        on_grid = (along_cols >= 0) & (along_cols < cols) & (along_rows >= 0) & (along_rows < rows)
        grid[along_rows[on_grid], along_cols[on_grid]] = value


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
            away = distance_transform(mask, resolution_m, SPEED_ZONES.reach_m)
            remaining_goal = np.maximum(away - np.float32(SPEED_ZONES.early_m), np.float32(0.0))
            before = np.sqrt(
                zone.speed**2 + 2.0 * SPEED_ZONES.braking_mps2 * remaining_goal, dtype=np.float32
            )
            before[away >= SPEED_ZONES.reach_m] = np.inf
            limits = np.minimum(limits, np.where(mask, np.float32(zone.speed), before))
    return limits
