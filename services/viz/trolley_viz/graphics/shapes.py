"""Geometry for drawing: triangles of outlines, walls of a grid, arrows, quaternions, rays."""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trolley.geometry import Pose2D
from trolley.geometry.polygon import signed_area

Mesh = tuple[NDArray[np.float32], NDArray[np.uint32]]
"""Vertices (v, 3) [m] and faces (f, 3)."""

CHI2_95 = 5.991
"""95 % of the chi-squared distribution with two degrees of freedom."""
MAX_WALL_RUNS = 40_000
MAX_FILLED_CORNERS = 500


def quaternion(yaw: float) -> tuple[float, float, float, float]:
    """Return a heading as the quaternion w, x, y, z."""
    return math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw)


def is_near(one: NDArray[np.float64], other: NDArray[np.float64]) -> bool:
    """Whether two positions [m] or orientations are so alike that nobody sees a difference."""
    # Asked with each picture; `np.allclose` takes ten times as long.
    return all(abs(a - b) < 1e-3 for a, b in zip(one.tolist(), other.tolist(), strict=True))


def triangulate(polygon: ArrayLike) -> NDArray[np.uint32]:
    """Cut a simple polygon (n, 2) into triangles by clipping ears.

    Returns:
        (m, 3) corner indices, counter-clockwise; fewer than n - 2 where the polygon crosses
        itself or degenerates, none where it has too many corners to fill while people wait.

    Source:
        Meisters, Polygons Have Ears (1975).
    """
    points = np.asarray(polygon, dtype=np.float64)
    if not 3 <= len(points) <= MAX_FILLED_CORNERS:
        return np.zeros((0, 3), np.uint32)
    left = list(range(len(points)))
    if signed_area(points) < 0.0:
        left.reverse()
    triangles: list[tuple[int, int, int]] = []
    while len(left) >= 3:
        ear = next((i for i in range(len(left)) if _is_ear(points, left, i)), None)
        if ear is None:
            break
        triangles.append((left[ear - 1], left[ear], left[(ear + 1) % len(left)]))
        del left[ear]
    return np.array(triangles, np.uint32).reshape(-1, 3)


def prism(polygon: ArrayLike, bottom: float, top: float) -> Mesh:
    """Raise an outline (n, 2) [m] to a body between two heights [m], open below."""
    points = np.asarray(polygon, dtype=np.float32)
    if signed_area(points.astype(np.float64)) < 0.0:
        points = points[::-1]
    n = len(points)
    vertices = np.concatenate(
        [np.column_stack([points, np.full(n, z, np.float32)]) for z in (bottom, top)]
    )
    sides: list[tuple[int, int, int]] = []
    for i in range(n):
        j = (i + 1) % n
        sides += [(i, j, n + j), (i, n + j, n + i)]
    roof = triangulate(points) + np.uint32(n)
    return vertices, np.concatenate([np.array(sides, np.uint32), roof])


def flat(polygon: ArrayLike) -> Mesh:
    """Fill an outline (n, 2) [m] on the floor."""
    points = np.asarray(polygon, dtype=np.float32)
    return np.column_stack([points, np.zeros(len(points), np.float32)]), triangulate(points)


def arrow_outline(length: float, width: float) -> NDArray[np.float64]:
    """Return an arrow from the origin along +x as an outline (7, 2) [m]."""
    neck, shaft = length - 0.9 * width, 0.17 * width
    half = 0.5 * width
    return np.array(
        [
            [0, -shaft],
            [neck, -shaft],
            [neck, -half],
            [length, 0],
            [neck, half],
            [neck, shaft],
            [0, shaft],
        ]
    )


def ellipse(covariance: ArrayLike, min_axis: float) -> NDArray[np.float64]:
    """Return the outline (48, 2) [m] around the origin that holds 95 % of a normal distribution.

    Args:
        covariance: (2, 2) of x, y [m^2].
        min_axis: half the least width [m].
    """
    variances, axes = np.linalg.eigh(np.asarray(covariance, np.float64))
    half = np.maximum(np.sqrt(CHI2_95 * np.maximum(variances, 0.0)), min_axis)
    angles = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
    circle = np.stack([np.cos(angles), np.sin(angles)])
    return ((axes * half) @ circle).T


def circle(radius: float) -> np.ndarray:
    """A circle as an outline (24, 2) [m]."""
    angles = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    return radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def closed_segments(polygon: ArrayLike, z: float) -> NDArray[np.float32]:
    """Return the edges of an outline (n, 2) [m] as line segments (n, 2, 3)."""
    points = np.asarray(polygon, dtype=np.float32).reshape(-1, 2)
    return _segments(points, np.roll(points, -1, axis=0), z)


def open_segments(points: ArrayLike, z: float) -> NDArray[np.float32]:
    """Return the pieces of a polyline (n, 2) [m] as line segments (n - 1, 2, 3)."""
    line = np.asarray(points, dtype=np.float32).reshape(-1, 2)
    return _segments(line[:-1], line[1:], z)


def particle_segments(
    poses: NDArray[np.floating[Any]], length: float, z: float
) -> NDArray[np.float32]:
    """Draw poses (n, 3) as strokes from where they are ahead: line segments (n, 2, 3)."""
    out = np.empty((len(poses), 2, 3), np.float32)
    out[..., 2] = z
    out[:, 0, :2] = poses[:, :2]
    out[:, 1, 0] = poses[:, 0] + length * np.cos(poses[:, 2])
    out[:, 1, 1] = poses[:, 1] + length * np.sin(poses[:, 2])
    return out


def wall_rectangles(mask: NDArray[np.bool_]) -> NDArray[np.int64] | None:
    """Cover the set cells of a grid with rectangles: runs of cells, merged over equal rows.

    Returns:
        (k, 4) first row, row past the end, first column, column past the end; None where the grid
        is so ragged that its walls would be too much to draw.
    """
    edges = np.diff(np.pad(mask, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    starts, ends = np.argwhere(edges == 1), np.argwhere(edges == -1)
    if len(starts) > MAX_WALL_RUNS:
        return None
    rectangles: list[tuple[int, int, int, int]] = []
    growing: dict[tuple[int, int], tuple[int, int]] = {}
    for (row, first), (_, past) in zip(starts.tolist(), ends.tolist(), strict=True):
        begin, end = growing.get((first, past), (row, row))
        if end != row:
            rectangles.append((begin, end, first, past))
            begin = row
        growing[first, past] = (begin, row + 1)
    rectangles += [(begin, end, first, past) for (first, past), (begin, end) in growing.items()]
    return np.array(rectangles, np.int64).reshape(-1, 4)


def boxes(rectangles: NDArray[np.int64], cell: float, height: float) -> Mesh:
    """Raise rectangles of cells (see `wall_rectangles`) to boxes in frame `grid`, open below."""
    k = len(rectangles)
    row0, row1, col0, col1 = (rectangles[:, i] * cell for i in range(4))
    ground = np.stack(
        [np.stack(xy, axis=1) for xy in ((col0, row0), (col1, row0), (col1, row1), (col0, row1))],
        axis=1,
    )
    vertices = np.zeros((k, 8, 3), np.float32)
    vertices[:, :4, :2], vertices[:, 4:, :2] = ground, ground
    vertices[:, 4:, 2] = height
    sides = [
        f for i in range(4) for j in ((i + 1) % 4,) for f in ((i, j, 4 + j), (i, 4 + j, 4 + i))
    ]
    one = np.array([*sides, (4, 5, 6), (4, 6, 7)], np.uint32)
    faces = one[None] + (8 * np.arange(k, dtype=np.uint32))[:, None, None]
    return vertices.reshape(-1, 3), faces.reshape(-1, 3)


def meet_floor(
    origin: ArrayLike, direction: ArrayLike, reach: float = 1000.0
) -> tuple[float, float] | None:
    """Return where a ray meets the floor z = 0 (x, y [m]), None if not within `reach` [m]."""
    start, along = np.asarray(origin, np.float64), np.asarray(direction, np.float64)
    length = float(np.linalg.norm(along))
    if not length > 0.0 or not np.isfinite(start).all():
        return None
    slope = float(along[2]) / length
    if abs(slope) < 1e-9:
        return None
    distance = -float(start[2]) / slope
    if not 0.0 <= distance <= reach:
        return None
    met = start + along / length * distance
    return float(met[0]), float(met[1])


def place(handle: Any, pose: Pose2D, z: float) -> None:
    """Move a scene node to a pose, `z` [m] above the floor."""
    # viser asks `np.allclose` each time, which takes fifty times as long as this.
    position, wxyz = (pose.x, pose.y, z), quaternion(pose.yaw)
    if tuple(handle.position.tolist()) != position:
        handle.position = position
    if tuple(handle.wxyz.tolist()) != wxyz:
        handle.wxyz = wxyz


def _segments(
    starts: NDArray[np.float32], ends: NDArray[np.float32], z: float
) -> NDArray[np.float32]:
    out = np.full((len(starts), 2, 3), z, np.float32)
    out[:, 0, :2], out[:, 1, :2] = starts, ends
    return out


def _is_ear(points: NDArray[np.float64], left: list[int], i: int) -> bool:
    a, b, c = points[left[i - 1]], points[left[i]], points[left[(i + 1) % len(left)]]
    if _turn(a, b, c) <= 0.0:
        return False
    corners = {left[i - 1], left[i], left[(i + 1) % len(left)]}
    rest = points[[k for k in left if k not in corners]]
    inside = np.ones(len(rest), np.bool_)
    for p, q in ((a, b), (b, c), (c, a)):
        inside &= (q[0] - p[0]) * (rest[:, 1] - p[1]) - (q[1] - p[1]) * (rest[:, 0] - p[0]) >= 0.0
    return not inside.any()


def _turn(a: NDArray[np.float64], b: NDArray[np.float64], c: NDArray[np.float64]) -> float:
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))
