"""Compiled loops over the beams of a scan: where they lie, and where mirrors end them.

Everything is in frame `grid` [m]: x along the columns, y along the rows, the origin at the outer
corner of cell (0, 0).
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.jit import lean_kernel

X, Y, DX, DY, CLEAR, ECHO = range(6)
"""Columns of a beam: start [m], direction, length that is free [m], distance of the echo [m]."""
SURFACE_M, MAX_SMOOTHED = 0.012, 8
"""Distance [m] to either side, and number of echoes, within which echoes may lie on one surface."""
SAME_M = 0.04
"""Difference of range below which neighbouring echoes lie on one surface [m]."""


class ScanShape(NamedTuple):
    """How the beams of a scan lie, in frame `laser`."""

    angle_min: float
    angle_increment: float
    range_min: float
    range_max: float


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """One scan and how the lidar moved while it was taken.

    Attributes:
        ranges_m: (n,) float32; +inf = no echo, 0 or NaN = invalid.
        shape: how the beams lie in `laser`.
        start: pose of the lidar at the first beam, in the frame of the costmap.
        end: pose of the lidar at the last beam.
        body_laser: (m, 2) the robot's outline in `laser` [m].
    """

    ranges_m: NDArray[np.float32]
    shape: ScanShape
    start: Pose2D
    end: Pose2D
    body_laser: NDArray[np.float64]


@lean_kernel
def inside_polygon(polygon: NDArray[np.float64], x: float, y: float) -> bool:
    """Say whether a point lies in a polygon (n, 2), by counting crossings."""
    inside = False
    previous = polygon.shape[0] - 1
    for index in range(polygon.shape[0]):
        x1, y1 = polygon[index, 0], polygon[index, 1]
        x2, y2 = polygon[previous, 0], polygon[previous, 1]
        if (y1 > y) != (y2 > y) and x < (x2 - x1) * (y - y1) / (y2 - y1) + x1:
            inside = not inside
        previous = index
    return inside


@lean_kernel
def box_of(polygon: NDArray[np.float64]) -> tuple[float, float, float, float]:
    """Return the least x and y of some points (n, 2), and the greatest."""
    low_x, low_y, high_x, high_y = math.inf, math.inf, -math.inf, -math.inf
    for index in range(polygon.shape[0]):
        low_x, high_x = min(low_x, polygon[index, 0]), max(high_x, polygon[index, 0])
        low_y, high_y = min(low_y, polygon[index, 1]), max(high_y, polygon[index, 1])
    return low_x, low_y, high_x, high_y


@lean_kernel
def smooth_ranges_into(
    out_m: NDArray[np.float32], ranges_m: NDArray[np.float32], angle_increment: float
) -> None:
    """Write each range as the mean of itself and those beside it on the same surface.

    The nearest of a hundred noisy echoes lies well before the wall, and what is seen of a passage
    would be narrower than the passage is. Only pairs of one beam on each side count: so a wall
    that is seen at an angle stays where it is, and so do the edges of things.

    Args:
        out_m: (n,), overwritten.
        ranges_m: (n,) +inf = no echo, 0 or NaN = invalid.
        angle_increment: from beam to beam [rad].
    """
    count = ranges_m.shape[0]
    for beam in range(count):
        here = float(ranges_m[beam])
        out_m[beam] = ranges_m[beam]
        if not (0.0 < here < math.inf):
            continue
        width = math.floor(min(SURFACE_M / (here * angle_increment), float(MAX_SMOOTHED)))
        total, num = here, 1
        for shift in range(1, min(width, beam, count - 1 - beam) + 1):
            right, left = float(ranges_m[beam - shift]), float(ranges_m[beam + shift])
            # Of what is not finite neither comparison holds.
            if not (abs(right - here) < SAME_M and abs(left - here) < SAME_M):
                break
            total += right + left
            num += 2
        out_m[beam] = total / num


@lean_kernel
def place_beams_into(
    out_beams: NDArray[np.float64],
    ranges_m: NDArray[np.float32],
    shape: ScanShape,
    start_grid: NDArray[np.float64],
    end_grid: NDArray[np.float64],
    body_laser: NDArray[np.float64],
    clear_max_m: float,
) -> None:
    """Write where each beam starts and points, how far it is free, and where its echo lies.

    Beams that tell nothing (invalid, or hitting the robot's own body) get length 0.

    Args:
        out_beams: (n, 6), overwritten.
        ranges_m: (n,) +inf = no echo, 0 or NaN = invalid.
        shape: of the scan.
        start_grid: (3,) pose of the lidar at the first beam: x, y [m], yaw [rad].
        end_grid: (3,) pose of the lidar at the last beam; in between it moves evenly.
        body_laser: (m, 2) the robot's outline in frame `laser` [m].
        clear_max_m: beams count as free up to here at most [m].
    """
    count = ranges_m.shape[0]
    turn = wrapped(end_grid[2] - start_grid[2])
    reach = 0.0
    for corner in range(body_laser.shape[0]):
        reach = max(reach, math.hypot(body_laser[corner, 0], body_laser[corner, 1]))
    for beam in range(count):
        share = beam / (count - 1) if count > 1 else 0.0
        angle = shape.angle_min + beam * shape.angle_increment
        yaw = start_grid[2] + share * turn + angle
        out_beams[beam, X] = start_grid[0] + share * (end_grid[0] - start_grid[0])
        out_beams[beam, Y] = start_grid[1] + share * (end_grid[1] - start_grid[1])
        out_beams[beam, DX] = math.cos(yaw)
        out_beams[beam, DY] = math.sin(yaw)
        out_beams[beam, CLEAR] = 0.0
        out_beams[beam, ECHO] = 0.0
        measured = float(ranges_m[beam])
        if math.isnan(measured) or measured <= 0.0 or measured < shape.range_min:
            continue
        if measured > shape.range_max:  # +inf too
            out_beams[beam, CLEAR] = min(clear_max_m, shape.range_max)
            continue
        on_body = measured <= reach and inside_polygon(
            body_laser, measured * math.cos(angle), measured * math.sin(angle)
        )
        if not on_body:
            out_beams[beam, CLEAR] = min(measured, clear_max_m)
            out_beams[beam, ECHO] = measured


@lean_kernel
def cut_at_lines(
    beams: NDArray[np.float64], segments: NDArray[np.float64], tolerance_m: float
) -> None:
    """End each beam at the first mirror or glass it crosses; its echo is then no obstacle.

    Args:
        beams: (n, 6), changed in place.
        segments: (m, 4) x1, y1, x2, y2 [m]: mirrors and glass.
        tolerance_m: how far beyond its ends a segment still counts, for the error of the pose;
            an echo that close in front of it is the mirror itself.
    """
    for beam in range(beams.shape[0]):
        if beams[beam, CLEAR] <= 0.0:
            continue
        x, y, dx, dy = beams[beam, X], beams[beam, Y], beams[beam, DX], beams[beam, DY]
        length = max(beams[beam, CLEAR], beams[beam, ECHO])
        for index in range(segments.shape[0]):
            ax, ay = segments[index, 0], segments[index, 1]
            sx, sy = segments[index, 2] - ax, segments[index, 3] - ay
            size = math.hypot(sx, sy)
            cross = dx * sy - dy * sx
            if size == 0.0 or abs(cross) < 1e-9 * size:
                continue
            along = ((ax - x) * sy - (ay - y) * sx) / cross
            share = ((ax - x) * dy - (ay - y) * dx) / cross
            margin = tolerance_m / size
            if along <= 0.0 or share < -margin or share > 1.0 + margin:
                continue
            if along <= length + tolerance_m:
                beams[beam, CLEAR] = min(beams[beam, CLEAR], along)
                if beams[beam, ECHO] > along - tolerance_m:
                    beams[beam, ECHO] = 0.0


@lean_kernel
def wrapped(angle: float) -> float:
    """Return the same direction within [-pi, pi)."""
    return angle - 2.0 * math.pi * math.floor((angle + math.pi) / (2.0 * math.pi))
