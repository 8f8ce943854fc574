"""What the lidar's beams meet: walls, things, people, mirrors and glass, in frame `map`, SI.

A beam is followed as a straight ray. Through the map it goes from cell to cell and ends exactly on
the border of the first solid one; segments and circles are intersected in closed form. At a mirror
it is reflected and continues: its range is the length of the whole path, so a lidar sees the
mirrored room behind the mirror. A beam that comes back from a mirror also meets the robot itself.

Source:
    Amanatides and Woo, A Fast Voxel Traversal Algorithm for Ray Tracing (1987).
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.gridmap.kernels import first_occupied
from trolley.jit import kernel

OPAQUE, MIRROR, MIRROR_LEFT, GLASS, DULL, UNSEEN = range(6)
"""Kinds of segments: `MIRROR_LEFT` reflects on the left of who walks from its first to its end;
beams pass over or under what is `UNSEEN`."""

# A beam that was reflected this often is too weak to measure.
MAX_BOUNCES = 4
# A ray starts this far ahead of the mirror that reflected it, so that it cannot meet it again, nor
# the wall that the mirror hangs on [m].
_OFF_MIRROR = 1e-6
# Steps of the golden ratio spread the draws of one beam at several panes evenly over 0...1.
_GOLDEN = 0.6180339887498949


class Scene(NamedTuple):
    """What beams can meet.

    Attributes:
        frame: (5,) map_T_grid as x, y, cos, sin, then the cell edge [m].
        solid: (rows, cols) uint8, 1 where a cell is occupied.
        segments: (n, 4) x, y, x, y [m] in `map`.
        kinds: (n,) uint8: `OPAQUE`, `MIRROR`, `MIRROR_LEFT`, `GLASS`, `DULL`,
            `UNSEEN`.
        echoes: (n, 2) of mirrors, glass and dull surfaces: share of beams that come straight back,
            and the incidence from the perpendicular within which all do (not mirrors) [rad].
        circles: (m, 3) x, y, radius [m] in `map`.
        body: (k, 2) corners of the robot's own outline [m] in `map`.
    """

    frame: NDArray[np.float64]
    solid: NDArray[np.uint8]
    segments: NDArray[np.float64]
    kinds: NDArray[np.uint8]
    echoes: NDArray[np.float64]
    circles: NDArray[np.float64]
    body: NDArray[np.float64]


@kernel
def grid_range(
    frame: NDArray[np.float64],
    solid: NDArray[np.uint8],
    x: float,
    y: float,
    dx: float,
    dy: float,
    reach: float,
) -> float:
    """Return how far a ray goes to the first solid cell, `reach` if none is nearer.

    Args:
        frame: (5,) map_T_grid as x, y, cos, sin, then the cell edge [m].
        solid: (rows, cols) uint8; off the grid everything is free.
        x: start [m] in `map`, may lie off the grid or in a solid cell (range 0).
        y: the same.
        dx: direction, a unit vector in `map`.
        dy: the same.
        reach: end of the ray [m].
    """
    edge = frame[4]
    px, py = (x - frame[0]) / edge, (y - frame[1]) / edge
    gx, gy = px * frame[2] + py * frame[3], py * frame[2] - px * frame[3]
    ux, uy = dx * frame[2] + dy * frame[3], dy * frame[2] - dx * frame[3]
    return min(first_occupied(solid, gx, gy, ux, uy, reach / edge) * edge, reach)


@kernel
def segment_range(
    ax: float, ay: float, bx: float, by: float, x: float, y: float, dx: float, dy: float
) -> float:
    """Return how far a ray goes to segment a-b, inf if it misses it or runs along it."""
    ex, ey = bx - ax, by - ay
    across = dx * ey - dy * ex
    if across == 0.0:
        return math.inf
    t = ((ax - x) * ey - (ay - y) * ex) / across
    s = ((ax - x) * dy - (ay - y) * dx) / across
    return t if t >= 0.0 and 0.0 <= s <= 1.0 else math.inf


@kernel
def circle_range(
    cx: float, cy: float, radius: float, x: float, y: float, dx: float, dy: float
) -> float:
    """Return how far a ray goes to a circle, 0 if it starts inside, inf if it misses."""
    ox, oy = x - cx, y - cy
    outside = ox * ox + oy * oy - radius * radius
    if outside <= 0.0:
        return 0.0
    along = ox * dx + oy * dy
    rest = along * along - outside
    if along >= 0.0 or rest < 0.0:
        return math.inf
    return -along - math.sqrt(rest)


@kernel
def comes_back(
    segment: NDArray[np.float64],
    kind: int,
    echo: NDArray[np.float64],
    direction: NDArray[np.float64],
    draw: float,
) -> bool:
    """Say whether a beam comes back from a segment; else it is reflected, goes on or is lost.

    Args:
        segment: (4,) x, y, x, y.
        kind: of the segment.
        echo: (2,) share that comes back, incidence within which all do [rad].
        direction: (4,) the ray's start x, y and its unit vector.
        draw: 0...1 of this beam at this segment.
    """
    ex, ey = segment[2] - segment[0], segment[3] - segment[1]
    if kind == OPAQUE or draw < echo[0]:
        return True
    if kind in (GLASS, DULL):
        across = abs(direction[2] * ey - direction[3] * ex) / math.hypot(ex, ey)
        return across >= math.cos(echo[1])
    if kind == MIRROR_LEFT:
        return ex * (direction[1] - segment[1]) - ey * (direction[0] - segment[0]) < 0.0
    return False


@kernel
def _nearest_segment(
    scene: Scene, ray: NDArray[np.float64], reach: float, skip: int, draw: float
) -> tuple[float, int]:
    """Return range and index of the first segment that stops or turns the ray; -1: none.

    Args:
        scene: what there is.
        ray: (4,) start x, y and unit vector.
        reach: end of the ray [m].
        skip: segment that the ray comes from, -1 if none.
        draw: 0...1 of this beam.
    """
    best, index = reach, -1
    for i in range(scene.segments.shape[0]):
        if scene.kinds[i] == UNSEEN:
            continue
        segment = scene.segments[i]
        t = segment_range(
            segment[0], segment[1], segment[2], segment[3], ray[0], ray[1], ray[2], ray[3]
        )
        if i == skip or t >= best:
            continue
        spread = (draw + i * _GOLDEN) % 1.0
        if scene.kinds[i] == GLASS and not comes_back(segment, GLASS, scene.echoes[i], ray, spread):
            continue
        best, index = t, i
    return best, index


@kernel
def _reflect(ray: NDArray[np.float64], segment: NDArray[np.float64], distance: float) -> None:
    """Move a ray to the mirror that it meets and turn it; it starts just off the mirror."""
    ex, ey = segment[2] - segment[0], segment[3] - segment[1]
    length = math.hypot(ex, ey)
    ex, ey = ex / length, ey / length
    ray[0] += distance * ray[2]
    ray[1] += distance * ray[3]
    along = ray[2] * ex + ray[3] * ey
    ray[2], ray[3] = 2.0 * along * ex - ray[2], 2.0 * along * ey - ray[3]
    side = 1.0 if ex * ray[3] - ey * ray[2] > 0.0 else -1.0
    ray[0] -= side * _OFF_MIRROR * ey
    ray[1] += side * _OFF_MIRROR * ex


@kernel
def beam_range(scene: Scene, ray: NDArray[np.float64], reach: float, draw: float) -> float:
    """Return the length of a beam's path to its echo, inf if there is none within reach.

    Args:
        scene: what there is.
        ray: (4,) start x, y [m] and unit vector, in `map`; overwritten.
        reach: longest path [m].
        draw: 0...1, decides what partly reflecting mirrors and panes do to this beam.
    """
    travelled, skip = 0.0, -1
    for bounce in range(MAX_BOUNCES + 1):
        rest = reach - travelled
        best, index = _nearest_segment(scene, ray, rest, skip, draw)
        for i in range(scene.circles.shape[0]):
            circle = scene.circles[i]
            t = circle_range(circle[0], circle[1], circle[2], ray[0], ray[1], ray[2], ray[3])
            if t < best:
                best, index = t, -1
        if bounce > 0:
            t = _body_range(scene.body, ray)
            if t < best:
                best, index = t, -1
        # A mirror that is flush with its wall is met before the wall.
        limit = best - _OFF_MIRROR if index >= 0 else best
        t = grid_range(scene.frame, scene.solid, ray[0], ray[1], ray[2], ray[3], limit)
        if t < limit:
            return travelled + t
        if index < 0:
            return travelled + best if best < rest else math.inf
        spread = (draw + index * _GOLDEN) % 1.0
        if scene.kinds[index] == GLASS or comes_back(
            scene.segments[index], scene.kinds[index], scene.echoes[index], ray, spread
        ):
            return travelled + best
        if scene.kinds[index] == DULL:
            return math.inf
        _reflect(ray, scene.segments[index], best)
        travelled += best
        skip = index
    return math.inf


@kernel
def _body_range(body: NDArray[np.float64], ray: NDArray[np.float64]) -> float:
    best = math.inf
    j = body.shape[0] - 1
    for i in range(body.shape[0]):
        t = segment_range(
            body[j, 0], body[j, 1], body[i, 0], body[i, 1], ray[0], ray[1], ray[2], ray[3]
        )
        best = min(best, t)
        j = i
    return best
