"""Beams that continue behind a wall of the map: mirrored, seen through a gap, or neither?"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel, lean_kernel
from trolley.scanning import Points
from trolley_localizer.kernels.matching import BEHIND_MIRROR, UNUSED, first_wall, sample_field

NOTHING = 0
"""The beam says nothing: unused, blocked before the wall, or ambiguous."""
STOPPED = 1
"""It ended at the wall, as it should."""
PASSED = 2
"""It continued, and what it saw is not what is in front of the wall."""
NO_IMAGE = 3
"""It continued; in a mirror it would have met its own lidar, but it did not."""
MIRRORED = 4
"""It continued and saw what is in front of the wall, and nothing else fits."""
IMAGE = 5
"""It continued and saw the robot itself in a mirror."""

NORMAL_X, NORMAL_Y = 2, 3
"""Columns of the wall's normal in the record of each beam."""


class ReflectionParams(NamedTuple):
    """When a beam counts as mirrored. All values were found by hand."""

    at_wall_m: float = 0.2
    """Distance from the wall within which a beam ended at it [m]."""
    behind_m: float = 0.3
    """Distance behind the wall from which on a beam ended behind it [m]."""
    wall_reach_m: float = 0.4
    """Distance from a hit within which the line of a wall is fitted [m]."""
    wall_side_m: float = 0.1
    """Extent of the wall needed on both sides: beams that graze an edge tell nothing [m]."""
    wall_roughness_m: float = 0.04
    """Distance that hits may lie from the line [m]."""
    min_hits: int = 4
    """Number of hits that a line needs."""
    min_incidence: float = 0.3
    """Least cosine of the angle to the normal: flatter beams are scattered too far by a small error
    of the wall's direction."""
    near_m: float = 0.1
    """Distance from a wall within which a mirrored end lies [m]."""
    near_share: float = 0.02
    """Share of its distance from the mirror that adds to `near_m`."""
    plain_m: float = 0.15
    """Distance from a wall within which an end that was not mirrored lies [m]."""
    free_margin_m: float = 0.3
    """Length before the end up to which the reflected path must be free of walls [m]."""
    body_m: float = 0.35
    """Radius of the circle that holds the robot [m]."""
    lidar_m: float = 0.05
    """Least radius of the lidar [m]."""


PARAMS = ReflectionParams()


@lean_kernel
def wall_about(hits: NDArray[np.float64], index: int, reach: float) -> tuple[int, int]:
    """Return the first and the last of the neighbouring hits that lie within reach of one.

    Args:
        hits: (n, 2) where neighbouring beams meet the map's walls [cells], NaN where nowhere.
        index: of the one.
        reach: [cells].
    """
    x = hits[index, 0]
    y = hits[index, 1]
    first = index
    while first > 0 and math.hypot(hits[first - 1, 0] - x, hits[first - 1, 1] - y) <= reach:
        first -= 1
    last = index + 1
    while last < hits.shape[0] and math.hypot(hits[last, 0] - x, hits[last, 1] - y) <= reach:
        last += 1
    return first, last - 1


@lean_kernel
def fit_wall(
    out_line: NDArray[np.float64], hits: NDArray[np.float64], index: int, resolution: float
) -> bool:
    """Fit a straight line to the wall around a hit, as seen from the origin of the beams.

    Args:
        out_line: (4,) a point of the line [cells] and its unit normal, overwritten.
        hits: (n, 2) where neighbouring beams meet the map's walls [cells], NaN where nowhere.
        index: of the hit.
        resolution: cell edge [m].

    Returns:
        Whether the wall is straight and continues on both sides.
    """
    first, last = wall_about(hits, index, PARAMS.wall_reach_m / resolution)
    count = last - first + 1
    if count < PARAMS.min_hits:
        return False
    near = hits[first : last + 1]
    mx = near[:, 0].sum() / count
    my = near[:, 1].sum() / count
    cxx = cxy = cyy = 0.0
    for j in range(count):
        dx = near[j, 0] - mx
        dy = near[j, 1] - my
        cxx += dx * dx / count
        cxy += dx * dy / count
        cyy += dy * dy / count
    # The smaller eigenvalue is the mean square distance from the line.
    least = 0.5 * (cxx + cyy) - math.hypot(0.5 * (cxx - cyy), cxy)
    if least > (PARAMS.wall_roughness_m / resolution) ** 2:
        return False
    along = 0.5 * math.atan2(2.0 * cxy, cxx - cyy)
    tx = math.cos(along)
    ty = math.sin(along)
    lowest = highest = 0.0
    for j in range(count):
        way = (near[j, 0] - hits[index, 0]) * tx + (near[j, 1] - hits[index, 1]) * ty
        lowest = min(lowest, way)
        highest = max(highest, way)
    out_line[:] = (mx, my, -ty, tx)
    side = PARAMS.wall_side_m / resolution
    return lowest <= -side and highest >= side


@lean_kernel
def meet_mirror(
    out_place: NDArray[np.float64],
    out_back: NDArray[np.float64],
    line: NDArray[np.float64],
    ray: NDArray[np.float64],
    resolution: float,
) -> bool:
    """Reflect a beam at a wall as if a mirror hung there.

    Args:
        out_place: (5,) point of the wall's line, its normal towards the robot, and how far
            behind the line the end lies, overwritten [cells].
        out_back: (5,) where the reflected beam begins, its direction, its length, overwritten
            [cells].
        line: (4,) a point of the wall and its unit normal.
        ray: (6,) as `cast_beams` writes it [cells].
        resolution: cell edge [m].

    Returns:
        Whether it continues far enough behind the wall, and meets it steeply enough, to judge.
    """
    nx = line[2]
    ny = line[3]
    cosine = -(ray[2] * nx + ray[3] * ny)
    if cosine < 0.0:
        nx, ny, cosine = -nx, -ny, -cosine
    if cosine < PARAMS.min_incidence:
        return False
    to_line = ((ray[0] - line[0]) * nx + (ray[1] - line[1]) * ny) / cosine
    behind = ray[4] - to_line
    x = ray[0] + to_line * ray[2]
    y = ray[1] + to_line * ray[3]
    out_place[:] = (x, y, nx, ny, behind * cosine)
    back_x = ray[2] + 2.0 * cosine * nx
    back_y = ray[3] + 2.0 * cosine * ny
    out_back[:] = (x, y, back_x, back_y, behind)
    return behind >= PARAMS.behind_m / resolution


@lean_kernel
def judge_passage(
    place: NDArray[np.float64],
    back: NDArray[np.float64],
    ray: NDArray[np.float64],
    base: NDArray[np.float64],
    field: NDArray[np.float32],
    resolution: float,
) -> int:
    """Judge one beam that continued behind a wall.

    Args:
        place: (5,) as `meet_mirror` writes it [cells].
        back: (5,) as `meet_mirror` writes it [cells].
        ray: (6,) as `cast_beams` writes it [cells].
        base: (2,) the robot's centre [cells].
        field: (rows + 2, cols + 2) distance to the nearest wall [cells].
        resolution: cell edge [m].
    """
    behind = back[4]
    end_x = back[0] + behind * back[2]
    end_y = back[1] + behind * back[3]
    body = PARAMS.body_m / resolution
    if math.hypot(end_x - base[0], end_y - base[1]) <= body:
        return IMAGE
    # How the reflected beam passes the place that it came from.
    abeam = abs((ray[0] - back[0]) * back[3] - (ray[1] - back[1]) * back[2])
    along = (ray[0] - back[0]) * back[2] + (ray[1] - back[1]) * back[3]
    if abeam <= PARAMS.lidar_m / resolution and 0.0 < along < behind - body:
        return NO_IMAGE
    near = PARAMS.near_m / resolution + PARAMS.near_share * behind
    if sample_field(field, end_x, end_y) > near:
        return PASSED
    # A little off the wall, so that the ray does not meet it again.
    x = back[0] + place[NORMAL_X]
    y = back[1] + place[NORMAL_Y]
    free = first_wall(field, x, y, back[2], back[3], behind)
    if free < behind - PARAMS.free_margin_m / resolution:
        return PASSED
    plain = sample_field(field, ray[0] + ray[4] * ray[2], ray[1] + ray[4] * ray[3])
    return NOTHING if plain <= PARAMS.plain_m / resolution else MIRRORED


@lean_kernel
def cast_beams(
    out_rays: NDArray[np.float64],
    out_hits: NDArray[np.float64],
    pose: NDArray[np.float64],
    beams: tuple[Points, Points],
    classes: NDArray[np.uint8],
    field: NDArray[np.float32],
    margin: float,
) -> None:
    """Find where beams meet the map's walls, whatever they saw.

    Args:
        out_rays: (n, 6) where a beam begins, its direction, its length, the distance to the wall,
            overwritten [cells].
        out_hits: (n, 2) where it meets the wall, NaN where it meets none, overwritten [cells].
        pose: (3,) x, y [cells], yaw [rad] in `grid`.
        beams: (n,) end points, and where the laser was, in `base_link` [cells].
        classes: (n,) of the beams; unused ones and those behind known mirrors are left out.
        field: (rows + 2, cols + 2) distance to the nearest wall [cells].
        margin: a beam is followed this far behind its end [cells].
    """
    end, start = beams
    cos = math.cos(pose[2])
    sin = math.sin(pose[2])
    out_hits[:] = np.nan
    for i in range(end.x.size):
        if classes[i] == UNUSED or classes[i] == BEHIND_MIRROR:
            continue
        dx = end.x[i] - start.x[i]
        dy = end.y[i] - start.y[i]
        length = max(math.hypot(dx, dy), 1e-6)
        x = pose[0] + cos * start.x[i] - sin * start.y[i]
        y = pose[1] + sin * start.x[i] + cos * start.y[i]
        dir_x = (cos * dx - sin * dy) / length
        dir_y = (sin * dx + cos * dy) / length
        way = first_wall(field, x, y, dir_x, dir_y, length + margin)
        out_rays[i] = (x, y, dir_x, dir_y, length, way)
        if way < math.inf:
            out_hits[i] = (x + way * dir_x, y + way * dir_y)


@kernel
def judge_beams(
    out_verdict: NDArray[np.uint8],
    out_place: NDArray[np.float64],
    out_cell: NDArray[np.int64],
    pose: NDArray[np.float64],
    beams: tuple[Points, Points],
    classes: NDArray[np.uint8],
    field: NDArray[np.float32],
    resolution: float,
) -> None:
    """Judge each beam by the wall of the map that it should have ended at.

    Args:
        out_verdict: (n,) NOTHING, STOPPED, PASSED, NO_IMAGE, MIRRORED or IMAGE, overwritten.
        out_place: (n, 5) where a beam that continued met the wall, the wall's normal towards the
            robot, and the depth behind it, written from PASSED on [cells].
        out_cell: (n,) four times the number of the wall's cell, and the quadrant that the beam
            points to; written where the verdict is not NOTHING.
        pose: (3,) x, y [cells], yaw [rad] in `grid`.
        beams: (n,) end points, and where the laser was, in `base_link` [cells].
        classes: (n,) of the beams; unused ones and those behind known mirrors are left out.
        field: (rows + 2, cols + 2) distance to the nearest wall [cells].
        resolution: cell edge [m].
    """
    count = classes.size
    hits = np.empty((count, 2))
    rays = np.empty((count, 6))
    line = np.empty(4)
    back = np.empty(5)
    cast_beams(rays, hits, pose, beams, classes, field, 2.0 * PARAMS.wall_reach_m / resolution)
    for i in range(count):
        out_verdict[i] = NOTHING
        if math.isnan(hits[i, 0]):
            continue
        cell = int(hits[i, 1] + 1.0) * field.shape[1] + int(hits[i, 0] + 1.0)
        out_cell[i] = 4 * cell + 2 * int(rays[i, 2] > 0.0) + int(rays[i, 3] > 0.0)
        behind_m = (rays[i, 4] - rays[i, 5]) * resolution
        if abs(behind_m) <= PARAMS.at_wall_m:
            out_verdict[i] = STOPPED
        elif (
            behind_m >= PARAMS.behind_m
            and fit_wall(line, hits, i, resolution)
            and meet_mirror(out_place[i], back, line, rays[i], resolution)
        ):
            out_verdict[i] = judge_passage(out_place[i], back, rays[i], pose[:2], field, resolution)
