"""Surfels of a neighbourhood: filling them from keyframes, and comparing scans with them."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel
from trolley.scan_matching.layout import Cloud, Surfels

EXPLAINED = 0
UNKNOWN = 1
IN_FREE_SPACE = 2
THROUGH_SURFACE = 3

SAME_SIDE = 0.75
"""Least product of the normals of points that are averaged as one surface."""
PARTNERS = 0.6
"""Least product of the normals of a point and the surfel that it is aligned with."""
NOT_BEHIND = 0.0
"""Least product of the normals of a point and the surfel that explains it."""
MARGIN_M = 0.3
"""Distance behind a surface below which a beam that goes on does not contradict it [m]."""


@kernel
def clear_surfels(surfels: Surfels) -> None:
    """Forget all surfels and all that was seen to be free."""
    surfels.head[:] = -1
    surfels.seen_through[:] = 0


@kernel
def add_surfels(
    surfels: Surfels,
    count: int,
    points: NDArray[np.floating[Any]],
    normals: NDArray[np.floating[Any]],
    pose: NDArray[np.float64],
    owner: int,
) -> int:
    """Add the points of a keyframe that have a normal; those of one surface are averaged.

    Args:
        surfels: in place.
        count: how many surfels there are so far.
        points: (n, 2) of the keyframe in `base_link` [m].
        normals: (n, 2), zero where there is none.
        pose: (3,) map_T_base of the keyframe.
        owner: index of the keyframe.

    Returns:
        How many surfels there are now.
    """
    cos = math.cos(pose[2])
    sin = math.sin(pose[2])
    rows, cols = surfels.head.shape
    for i in range(points.shape[0]):
        if normals[i, 0] == 0.0 and normals[i, 1] == 0.0:
            continue
        x = pose[0] + cos * points[i, 0] - sin * points[i, 1]
        y = pose[1] + sin * points[i, 0] + cos * points[i, 1]
        nx = cos * normals[i, 0] - sin * normals[i, 1]
        ny = sin * normals[i, 0] + cos * normals[i, 1]
        col = math.floor((x - surfels.frame[0]) * surfels.frame[2])
        row = math.floor((y - surfels.frame[1]) * surfels.frame[2])
        if not (0 <= row < rows and 0 <= col < cols):
            continue
        at = surfels.head[row, col]
        while at >= 0:
            length = math.hypot(surfels.normal[at, 0], surfels.normal[at, 1])
            product = nx * surfels.normal[at, 0] + ny * surfels.normal[at, 1]
            if product > SAME_SIDE * length:
                break
            at = surfels.following[at]
        if at >= 0:
            surfels.weight[at] += 1.0
            share = 1.0 / surfels.weight[at]
            surfels.place[at, 0] += share * (x - surfels.place[at, 0])
            surfels.place[at, 1] += share * (y - surfels.place[at, 1])
            surfels.normal[at, 0] += nx
            surfels.normal[at, 1] += ny
        elif count < surfels.weight.size:
            surfels.place[count, 0] = x
            surfels.place[count, 1] = y
            surfels.normal[count, 0] = nx
            surfels.normal[count, 1] = ny
            surfels.weight[count] = 1.0
            surfels.owner[count] = owner
            surfels.following[count] = surfels.head[row, col]
            surfels.head[row, col] = count
            count += 1
    return count


@kernel
def normalise_surfels(surfels: Surfels, count: int) -> None:
    """Bring all normals to unit length."""
    for i in range(count):
        length = math.hypot(surfels.normal[i, 0], surfels.normal[i, 1])
        surfels.normal[i, 0] /= length
        surfels.normal[i, 1] /= length


@kernel
def mark_free(
    surfels: Surfels,
    points: NDArray[np.float32],
    laser: NDArray[np.float32],
    pose: NDArray[np.float64],
    every: int,
) -> None:
    """Count the keyframe where its beams pass, up to short of their ends.

    Args:
        surfels: in place.
        points: (n, 2) of the keyframe in `base_link` [m].
        laser: (2,) where the laser was in `base_link` [m].
        pose: (3,) map_T_base of the keyframe.
        every: use one beam in so many.
    """
    cos = math.cos(pose[2])
    sin = math.sin(pose[2])
    scale = surfels.frame[2]
    rows, cols = surfels.head.shape
    from_x = pose[0] + cos * laser[0] - sin * laser[1]
    from_y = pose[1] + sin * laser[0] + cos * laser[1]
    for i in range(0, points.shape[0], every):
        dx = pose[0] + cos * points[i, 0] - sin * points[i, 1] - from_x
        dy = pose[1] + sin * points[i, 0] + cos * points[i, 1] - from_y
        length = math.hypot(dx, dy)
        steps = math.floor((length - 1.5 / scale) * scale)
        for k in range(steps):
            share = k / (scale * length)
            col = math.floor((from_x + share * dx - surfels.frame[0]) * scale)
            row = math.floor((from_y + share * dy - surfels.frame[1]) * scale)
            if not (0 <= row < rows and 0 <= col < cols):
                break
            if surfels.seen_through[row, col] < 250:
                surfels.seen_through[row, col] += 1


@kernel
def mark_floor(surfels: Surfels, floor: NDArray[np.float32], times: int) -> None:
    """Count places (n, 2) x, y [m] in `map` as seen to be free so many times."""
    rows, cols = surfels.head.shape
    for i in range(floor.shape[0]):
        col = math.floor((floor[i, 0] - surfels.frame[0]) * surfels.frame[2])
        row = math.floor((floor[i, 1] - surfels.frame[1]) * surfels.frame[2])
        if 0 <= row < rows and 0 <= col < cols:
            surfels.seen_through[row, col] = max(surfels.seen_through[row, col], times)


@kernel
def nearest_surfel(
    surfels: Surfels, point: tuple[float, float, float, float], reach: float, facing: float
) -> int:
    """Return the nearest surfel that looks the same way, or -1.

    Args:
        surfels: of the neighbourhood.
        point: its x, y in `map` [m], and its unit normal; zeros if it has none.
        reach: farther ones do not count [m].
        facing: least product of the normals.
    """
    x, y, nx, ny = point
    scale = surfels.frame[2]
    rows, cols = surfels.head.shape
    left = max(math.floor((x - reach - surfels.frame[0]) * scale), 0)
    right = min(math.floor((x + reach - surfels.frame[0]) * scale), cols - 1)
    low = max(math.floor((y - reach - surfels.frame[1]) * scale), 0)
    high = min(math.floor((y + reach - surfels.frame[1]) * scale), rows - 1)
    best = -1
    best_square = reach * reach
    has_normal = nx != 0.0 or ny != 0.0
    for row in range(low, high + 1):
        for col in range(left, right + 1):
            at = surfels.head[row, col]
            while at >= 0:
                dx = x - surfels.place[at, 0]
                dy = y - surfels.place[at, 1]
                square = dx * dx + dy * dy
                if square < best_square:
                    product = nx * surfels.normal[at, 0] + ny * surfels.normal[at, 1]
                    if not has_normal or product > facing:
                        best = int(at)
                        best_square = square
                at = surfels.following[at]
    return best


@kernel
def _meets_surface(
    surfels: Surfels, from_x: float, from_y: float, to_x: float, to_y: float
) -> bool:
    """Say whether a beam crosses a cell with a surface that looks towards it, before its end."""
    scale = surfels.frame[2]
    rows, cols = surfels.head.shape
    dx = to_x - from_x
    dy = to_y - from_y
    length = math.hypot(dx, dy)
    steps = math.floor((length - MARGIN_M) * scale)
    for k in range(2, steps):
        share = k / (scale * length)
        col = math.floor((from_x + share * dx - surfels.frame[0]) * scale)
        row = math.floor((from_y + share * dy - surfels.frame[1]) * scale)
        if not (0 <= row < rows and 0 <= col < cols):
            return False
        at = surfels.head[row, col]
        while at >= 0:
            # A beam that grazes a wall, and a thing seen once, prove nothing.
            product = dx * surfels.normal[at, 0] + dy * surfels.normal[at, 1]
            if product < -0.5 * length and surfels.weight[at] >= 3.0:
                return bool(surfels.seen_through[row, col] <= 1)
            at = surfels.following[at]
    return False


@kernel
def classify_points(
    out_class: NDArray[np.uint8],
    surfels: Surfels,
    cloud: Cloud,
    laser: NDArray[np.float64],
    pose: NDArray[np.float64],
    near: float,
) -> None:
    """Say of each point what the neighbourhood makes of it.

    Args:
        out_class: (n,) overwritten: EXPLAINED, UNKNOWN, IN_FREE_SPACE or THROUGH_SURFACE.
        surfels: of the neighbourhood.
        cloud: the scan.
        laser: (2,) where the laser was in `base_link` [m].
        pose: (3,) map_T_base.
        near: a point this near to a surface is explained [m].
    """
    cos = math.cos(pose[2])
    sin = math.sin(pose[2])
    rows, cols = surfels.head.shape
    from_x = pose[0] + cos * laser[0] - sin * laser[1]
    from_y = pose[1] + sin * laser[0] + cos * laser[1]
    for i in range(cloud.points.shape[0]):
        px, py = cloud.points[i, 0], cloud.points[i, 1]
        x = pose[0] + cos * px - sin * py
        y = pose[1] + sin * px + cos * py
        # The back of a wall is not explained by its front, be it as thin as it may.
        nx = cos * cloud.normals[i, 0] - sin * cloud.normals[i, 1]
        ny = sin * cloud.normals[i, 0] + cos * cloud.normals[i, 1]
        at = nearest_surfel(surfels, (x, y, nx, ny), max(2.0 * near, 0.15), NOT_BEHIND)
        if at >= 0:
            off = surfels.normal[at, 0] * (x - surfels.place[at, 0]) + surfels.normal[at, 1] * (
                y - surfels.place[at, 1]
            )
            if abs(off) <= near:
                out_class[i] = EXPLAINED
                continue
        col = math.floor((x - surfels.frame[0]) * surfels.frame[2])
        row = math.floor((y - surfels.frame[1]) * surfels.frame[2])
        if 0 <= row < rows and 0 <= col < cols and surfels.seen_through[row, col] >= 2:
            out_class[i] = IN_FREE_SPACE
        elif _meets_surface(surfels, from_x, from_y, x, y):
            out_class[i] = THROUGH_SURFACE
        else:
            out_class[i] = UNKNOWN
