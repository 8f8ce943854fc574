"""The direction of the surface at each point of a scan, and which points to keep."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel


class NormalParams(NamedTuple):
    """Which neighbours of a point show the direction of its surface. Set by hand."""

    reach: float = 0.12
    """Distance within which neighbours count [m]."""
    reach_gaps: float = 3.5
    """Number of gaps between beams within which neighbours count where beams lie farther apart."""
    most: int = 100
    """Number of neighbours on each side after which no more are needed: those within reach are more
    only in a corner of centimetres, or with beams that lie 1.2 mm apart."""
    jump: float = 0.08
    """Distance beyond which neighbours belong to two objects [m]."""
    jump_gaps: float = 4.0
    """Number of gaps beyond which neighbours belong to two objects where beams lie farther apart: a
    wall seen at 14 degrees."""
    rough: float = 0.02
    """Root mean square distance of the points beyond which they form no line [m]."""
    rough_share: float = 0.004
    """Extra distance for each metre of range."""


NORMAL = NormalParams()


@kernel
def _run_end(
    points: NDArray[np.float64], beams: NDArray[np.int32], at: int, step: int, gap: float
) -> int:
    """Return the last point of the surface around `at` in one direction."""
    reach = max(NORMAL.reach, NORMAL.reach_gaps * gap)
    jump = max(NORMAL.jump, NORMAL.jump_gaps * gap)
    last = at
    following = at + step
    while 0 <= following < beams.size and abs(beams[following] - beams[last]) <= 2:
        if abs(following - at) > NORMAL.most:
            break
        if (
            math.hypot(
                points[following, 0] - points[last, 0], points[following, 1] - points[last, 1]
            )
            > jump
        ):
            break
        away = math.hypot(
            points[following, 0] - points[at, 0], points[following, 1] - points[at, 1]
        )
        if away > reach and abs(following - at) > 1:
            break
        last = following
        following += step
    return last


@kernel
def fit_normals(
    out_normals: NDArray[np.float64],
    points: NDArray[np.float64],
    beams: NDArray[np.int32],
    laser: NDArray[np.float64],
    increment: float,
) -> None:
    """Write the unit normal of the surface at each point, towards the laser; zero if unclear.

    Args:
        out_normals: (n, 2), overwritten.
        points: (n, 2) in the order of the beams [m].
        beams: (n,) number of the beam of each.
        laser: (2,) where the laser was [m].
        increment: angle between two beams [rad].
    """
    for i in range(beams.size):
        out_normals[i, 0] = 0.0
        out_normals[i, 1] = 0.0
        dx = laser[0] - points[i, 0]
        dy = laser[1] - points[i, 1]
        reach = math.hypot(dx, dy)
        gap = reach * abs(increment)
        first = _run_end(points, beams, i, -1, gap)
        last = _run_end(points, beams, i, 1, gap)
        count = last - first + 1
        if count < 3:
            continue
        mean_x = 0.0
        mean_y = 0.0
        for j in range(first, last + 1):
            mean_x += points[j, 0]
            mean_y += points[j, 1]
        mean_x /= count
        mean_y /= count
        xx = 0.0
        xy = 0.0
        yy = 0.0
        for j in range(first, last + 1):
            ax = points[j, 0] - mean_x
            ay = points[j, 1] - mean_y
            xx += ax * ax
            xy += ax * ay
            yy += ay * ay
        half_trace = 0.5 * (xx + yy)
        root = math.sqrt(max(0.25 * (xx - yy) * (xx - yy) + xy * xy, 0.0))
        small = max(half_trace - root, 0.0) / count
        large = (half_trace + root) / count
        rough = NORMAL.rough + NORMAL.rough_share * reach
        if small > rough * rough or large < 6.0 * small:
            continue
        along = 0.5 * math.atan2(2.0 * xy, xx - yy)
        nx = -math.sin(along)
        ny = math.cos(along)
        if nx * dx + ny * dy < 0.0:
            nx = -nx
            ny = -ny
        out_normals[i, 0] = nx
        out_normals[i, 1] = ny


@kernel
def thin_points(out_kept: NDArray[np.int64], points: NDArray[np.float64], spacing: float) -> int:
    """Choose points so that neighbours in the scan are not nearer than `spacing` to each other.

    Args:
        out_kept: (n,) indices, its first entries are overwritten.
        points: (n, 2) in the order of the beams [m].
        spacing: [m].

    Returns:
        How many are kept.
    """
    kept = 0
    for i in range(points.shape[0]):
        if kept > 0:
            last = out_kept[kept - 1]
            if math.hypot(points[i, 0] - points[last, 0], points[i, 1] - points[last, 1]) < spacing:
                continue
        out_kept[kept] = i
        kept += 1
    return kept
