"""Distances between the robot's outline and everything solid, in frame `map`, SI.

The walls come as the outlines of the map's occupied cells: straight segments, split at the borders
of square buckets so that only those near the robot are looked at. All other things are segments
and circles that belong to a numbered body; body 0 is the map.

A gap is the exact distance between outline and body. Where the two overlap it is negative: only its
order means something (deeper is smaller), so that a robot in an overlap can be let out of it.

Source:
    Ericson, Real-Time Collision Detection (2005), sections 5.1.2 and 5.1.9 (closest points).
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel

# Bodies farther away than the nearest one by more than this keep a lower bound as their gap.
EXACT_WITHIN = 0.1


class Walls(NamedTuple):
    """The map as the kernels want it.

    Attributes:
        frame: (5,) map_T_grid as x, y, cos, sin, then the cell edge [m].
        solid: (rows, cols) uint8, 1 where a cell is occupied.
        distance: (rows, cols) float32, from a cell's centre to the nearest solid cell's [m].
        edges: (n, 4) x, y, x, y [m] in `map`: outlines of the solid cells, sorted by bucket.
        buckets: (bucket rows, bucket cols, 2) int64: first edge of the bucket and first behind it.
        bucket_edge: (1,) edge of a bucket [m].
    """

    frame: NDArray[np.float64]
    solid: NDArray[np.uint8]
    distance: NDArray[np.float32]
    edges: NDArray[np.float64]
    buckets: NDArray[np.int64]
    bucket_edge: NDArray[np.float64]


class Things(NamedTuple):
    """Everything solid that is not on the map, and whose body each piece is.

    Attributes:
        segments: (n, 4) x, y, x, y [m] in `map`.
        segment_body: (n,) int64.
        circles: (m, 3) x, y, radius [m] in `map`.
        circle_body: (m,) int64.
    """

    segments: NDArray[np.float64]
    segment_body: NDArray[np.int64]
    circles: NDArray[np.float64]
    circle_body: NDArray[np.int64]


class Touch(NamedTuple):
    """A distance and its two ends: on the outline, and on the other thing [m]."""

    gap: float
    x: float
    y: float
    other_x: float
    other_y: float


@kernel
def place_outline_into(
    out_outline: NDArray[np.float64],
    footprint: NDArray[np.float64],
    x: float,
    y: float,
    yaw: float,
) -> None:
    """Write the corners of a footprint (n, 2) [m] that stands at a pose, in the pose's frame."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    for i in range(footprint.shape[0]):
        out_outline[i, 0] = x + cos * footprint[i, 0] - sin * footprint[i, 1]
        out_outline[i, 1] = y + sin * footprint[i, 0] + cos * footprint[i, 1]


@kernel
def closest_on_segment(
    px: float, py: float, ax: float, ay: float, bx: float, by: float
) -> tuple[float, float]:
    """Return the point of segment a-b that is nearest to p."""
    ex, ey = bx - ax, by - ay
    length_squared = ex * ex + ey * ey
    if length_squared <= 0.0:
        return ax, ay
    s = ((px - ax) * ex + (py - ay) * ey) / length_squared
    s = min(1.0, max(0.0, s))
    return ax + s * ex, ay + s * ey


@kernel
def is_inside(outline: NDArray[np.float64], x: float, y: float) -> bool:
    """Say whether a point lies inside a polygon (n, 2), by counting crossings."""
    inside = False
    j = outline.shape[0] - 1
    for i in range(outline.shape[0]):
        yi, yj = outline[i, 1], outline[j, 1]
        if (yi > y) != (yj > y):
            at = outline[i, 0] + (y - yi) / (yj - yi) * (outline[j, 0] - outline[i, 0])
            if x < at:
                inside = not inside
        j = i
    return inside


@kernel
def outline_to_point(
    outline: NDArray[np.float64], x: float, y: float
) -> tuple[float, float, float]:
    """Return a point's distance to a polygon (< 0 inside) and the nearest point on it."""
    best, best_x, best_y = math.inf, x, y
    j = outline.shape[0] - 1
    for i in range(outline.shape[0]):
        qx, qy = closest_on_segment(
            x, y, outline[j, 0], outline[j, 1], outline[i, 0], outline[i, 1]
        )
        distance = math.hypot(x - qx, y - qy)
        if distance < best:
            best, best_x, best_y = distance, qx, qy
        j = i
    if is_inside(outline, x, y):
        best = -best
    return best, best_x, best_y


@kernel
def _side(ax: float, ay: float, bx: float, by: float, x: float, y: float) -> float:
    return (bx - ax) * (y - ay) - (by - ay) * (x - ax)


@kernel
def outline_to_segment(outline: NDArray[np.float64], segment: NDArray[np.float64]) -> Touch:
    """Return the gap of a polygon (n, 2) to a segment (4,) x, y, x, y; -1 if they overlap."""
    ax, ay, bx, by = segment[0], segment[1], segment[2], segment[3]
    best = Touch(math.inf, ax, ay, ax, ay)
    j = outline.shape[0] - 1
    for i in range(outline.shape[0]):
        px, py, qx, qy = outline[j, 0], outline[j, 1], outline[i, 0], outline[i, 1]
        a_side, b_side = _side(px, py, qx, qy, ax, ay), _side(px, py, qx, qy, bx, by)
        p_side, q_side = _side(ax, ay, bx, by, px, py), _side(ax, ay, bx, by, qx, qy)
        if a_side * b_side < 0.0 and p_side * q_side < 0.0:
            return Touch(-1.0, px, py, ax, ay)
        sx, sy = closest_on_segment(px, py, ax, ay, bx, by)
        distance = math.hypot(px - sx, py - sy)
        if distance < best.gap:
            best = Touch(distance, px, py, sx, sy)
        for end in range(2):
            ex, ey = segment[2 * end], segment[2 * end + 1]
            ox, oy = closest_on_segment(ex, ey, px, py, qx, qy)
            distance = math.hypot(ex - ox, ey - oy)
            if distance < best.gap:
                best = Touch(distance, ox, oy, ex, ey)
        j = i
    if is_inside(outline, ax, ay) or is_inside(outline, bx, by):
        return Touch(-1.0, best.x, best.y, best.other_x, best.other_y)
    return best


@kernel
def _note_segment(
    out_gaps: NDArray[np.float64],
    out_touches: NDArray[np.float64],
    outline: NDArray[np.float64],
    circle: NDArray[np.float64],
    segment: NDArray[np.float64],
    body: int,
    nearest: float,
) -> float:
    """Lower a body's gap to that of one of its segments; return the nearest gap of all so far.

    Args:
        out_gaps: (bodies,).
        out_touches: (bodies, 4).
        outline: (n, 2).
        circle: (3,) centre and radius of a circle around the outline.
        segment: (4,).
        body: whose segment it is.
        nearest: nearest gap of all bodies so far.
    """
    sx, sy = closest_on_segment(
        circle[0], circle[1], segment[0], segment[1], segment[2], segment[3]
    )
    centre_distance = math.hypot(circle[0] - sx, circle[1] - sy)
    bound = centre_distance - circle[2]
    if bound >= out_gaps[body]:
        return nearest
    if bound > nearest and bound > EXACT_WITHIN:
        out_gaps[body] = bound
        return nearest
    touch = outline_to_segment(outline, segment)
    if touch.gap < 0.0:
        touch = Touch(min(bound, 0.0), circle[0], circle[1], sx, sy)
    if touch.gap < out_gaps[body]:
        out_gaps[body] = touch.gap
        out_touches[body, 0], out_touches[body, 1] = touch.x, touch.y
        out_touches[body, 2], out_touches[body, 3] = touch.other_x, touch.other_y
    return min(nearest, touch.gap)


@kernel
def _wall_gap_into(
    out_gaps: NDArray[np.float64],
    out_touches: NDArray[np.float64],
    outline: NDArray[np.float64],
    circle: NDArray[np.float64],
    walls: Walls,
    reach: float,
) -> float:
    """Write the gap between the outline and the map (body 0), if it is below `reach`; return it."""
    frame, bucket_edge = walls.frame, walls.bucket_edge[0]
    dx, dy = circle[0] - frame[0], circle[1] - frame[1]
    gx, gy = dx * frame[2] + dy * frame[3], dy * frame[2] - dx * frame[3]
    rows, cols = walls.solid.shape
    row, col = math.floor(gy / frame[4]), math.floor(gx / frame[4])
    nearest = reach
    if 0 <= row < rows and 0 <= col < cols:
        # Some point of the outline is within the radius of the centre, and the centre within 0.71
        # cells of its cell's centre: the nearest wall cannot be farther than this.
        nearest = min(nearest, walls.distance[row, col] + circle[2] + frame[4])
        if walls.solid[row, col]:
            out_gaps[0] = -circle[2]
            out_touches[0, 0], out_touches[0, 1] = circle[0], circle[1]
            out_touches[0, 2], out_touches[0, 3] = circle[0], circle[1]
    window = nearest + circle[2]
    bucket_rows, bucket_cols = walls.buckets.shape[0], walls.buckets.shape[1]
    first_row = max(0, math.floor((gy - window) / bucket_edge))
    last_row = min(bucket_rows - 1, math.floor((gy + window) / bucket_edge))
    first_col = max(0, math.floor((gx - window) / bucket_edge))
    last_col = min(bucket_cols - 1, math.floor((gx + window) / bucket_edge))
    for r in range(first_row, last_row + 1):
        away_y = max(0.0, r * bucket_edge - gy, gy - (r + 1) * bucket_edge)
        for c in range(first_col, last_col + 1):
            away_x = max(0.0, c * bucket_edge - gx, gx - (c + 1) * bucket_edge)
            if math.hypot(away_x, away_y) - circle[2] > nearest:
                continue
            for i in range(walls.buckets[r, c, 0], walls.buckets[r, c, 1]):
                _note_segment(out_gaps, out_touches, outline, circle, walls.edges[i], 0, math.inf)
                nearest = min(nearest, out_gaps[0])
    return out_gaps[0]


@kernel
def gaps_into(
    out_gaps: NDArray[np.float64],
    out_touches: NDArray[np.float64],
    outline: NDArray[np.float64],
    circle: NDArray[np.float64],
    walls: Walls,
    things: Things,
    reach: float,
) -> float:
    """Write the gap between the outline and each body; return the smallest.

    Args:
        out_gaps: (bodies,) [m]; exact where it is the smallest or under 0.1 m, else a lower bound
            that is no smaller than the smallest; `reach` where there is nothing within reach.
        out_touches: (bodies, 4): nearest point on the outline, then on the body, where exact; in an
            overlap from the outline's centre.
        outline: (n, 2) corners of the footprint [m] in `map`.
        circle: (3,) centre and radius of a circle around the outline [m].
        walls: the map.
        things: everything else.
        reach: farthest gap of interest [m].
    """
    out_gaps[:] = reach
    nearest = _wall_gap_into(out_gaps, out_touches, outline, circle, walls, reach)
    for i in range(things.segments.shape[0]):
        nearest = _note_segment(
            out_gaps, out_touches, outline, circle,
            things.segments[i], things.segment_body[i], nearest,
        )  # fmt: skip
    for i in range(things.circles.shape[0]):
        x, y, radius = things.circles[i, 0], things.circles[i, 1], things.circles[i, 2]
        body = things.circle_body[i]
        bound = math.hypot(circle[0] - x, circle[1] - y) - radius - circle[2]
        if bound >= out_gaps[body]:
            continue
        if bound > nearest and bound > EXACT_WITHIN:
            out_gaps[body] = bound
            continue
        distance, px, py = outline_to_point(outline, x, y)
        gap = distance - radius
        if gap < out_gaps[body]:
            out_gaps[body] = gap
            out_touches[body, 0], out_touches[body, 1] = px, py
            out_touches[body, 2], out_touches[body, 3] = x, y
        nearest = min(nearest, gap)
    return nearest
