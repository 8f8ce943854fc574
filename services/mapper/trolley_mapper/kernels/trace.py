"""Beams of keyframes through the occupancy grid."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.gridmap.kernels import begin_march, next_cell
from trolley.jit import kernel


class SurfaceParams(NamedTuple):
    """Between which neighbouring ends of beams there is a surface. Set by hand."""

    noise_m: float = 0.02
    """Error of a range [m]."""
    noise_share: float = 0.004
    """Extra error for each metre of range."""
    bend: float = 0.3
    """Share of the step from one end to the next by which the step after it may differ."""
    missed: float = 2.5
    """Number of gaps between beams from which on there was no echo in between: a door, maybe."""
    reach_m: float = 0.3
    """Distance between ends beyond which nobody knows [m]: a robot may fit through."""
    squarely: float = 0.33
    """Sine of the angle between beam and surface from which on a beam that passes speaks fully
    against the surface: 20 degrees. At smaller ones it may well pass beside it."""


SURFACE = SurfaceParams()

FULL = 127
"""Length of a unit normal in the cells."""


class Cells(NamedTuple):
    """The arrays of an occupancy grid.

    Attributes:
        log_odds: (rows, cols), zero where nothing passes.
        marks: (rows, cols), the last keyframe that met the cell.
        normals: (rows, cols, 2), of the surface that was last seen there, of length `FULL`; zero
            where unclear.
    """

    log_odds: NDArray[np.int16]
    marks: NDArray[np.int32]
    normals: NDArray[np.int8]


@kernel
def trace_keyframe(
    cells: Cells,
    frame: NDArray[np.float64],
    points: NDArray[np.float32],
    normals: NDArray[np.float32],
    poses: tuple[NDArray[np.float64], NDArray[np.float32]],
    change: tuple[int, int, int, int],
) -> None:
    """Raise the log-odds of surfaces where beams end, and lower them where beams pass.

    Each cell changes once for a keyframe, however many beams meet it; ends win. A wall seen at a
    grazing angle ends few beams, so the cells between two ends of one surface are raised, too; and
    many pass close by, so a beam lowers a cell as much as it is likely to cross the surface there.

    Args:
        cells: of the grid, in place.
        frame: (3,) x, y [m] of the outer corner of cell (0, 0), and cells per metre.
        points: (n, 2) of the keyframe in `base_link`, in the order of its beams [m].
        normals: (n, 2), zero where unclear.
        poses: (3,) map_T_base, and (2,) the laser in `base_link` [m].
        change: mark of this keyframe, rise, fall, and the largest size of the log-odds.

    Source:
        Thrun, Burgard, Fox, Probabilistic Robotics (2005), table 9.1; Amanatides, Woo, A Fast
        Voxel Traversal Algorithm for Ray Tracing (1987). That a beam speaks against a surface as
        far as it crosses it: Saarinen, Andreasson, Stoyanov, Lilienthal, Normal Distributions
        Transform Occupancy Maps (2013).
    """
    pose, laser = poses
    mark, rise, fall, limit = change
    cos = math.cos(pose[2])
    sin = math.sin(pose[2])
    from_x = (pose[0] + cos * laser[0] - sin * laser[1] - frame[0]) * frame[2]
    from_y = (pose[1] + sin * laser[0] + cos * laser[1] - frame[1]) * frame[2]
    ends = np.empty((points.shape[0], 2))
    surface = np.empty((points.shape[0], 2))
    for i in range(points.shape[0]):
        ends[i, 0] = (pose[0] + cos * points[i, 0] - sin * points[i, 1] - frame[0]) * frame[2]
        ends[i, 1] = (pose[1] + sin * points[i, 0] + cos * points[i, 1] - frame[1]) * frame[2]
        surface[i, 0] = cos * normals[i, 0] - sin * normals[i, 1]
        surface[i, 1] = sin * normals[i, 0] + cos * normals[i, 1]
    joined = np.empty(points.shape[0], np.uint8)
    join_ends(joined, points, laser)
    for i in range(points.shape[0]):
        length = 0.0
        dx = 0.0
        dy = 0.0
        if joined[i]:
            dx = ends[i + 1, 0] - ends[i, 0]
            dy = ends[i + 1, 1] - ends[i, 1]
            length = math.hypot(dx, dy)
            dx /= length
            dy /= length
            for j in (i, i + 1):
                if surface[j, 0] == 0.0 and surface[j, 1] == 0.0:
                    surface[j, 0] = -dy
                    surface[j, 1] = dx
        raise_along(
            cells, (ends[i, 0], ends[i, 1], dx, dy, length), surface[i], (mark, rise, limit)
        )
    for i in range(points.shape[0]):
        dx = ends[i, 0] - from_x
        dy = ends[i, 1] - from_y
        length = math.hypot(dx, dy)
        if length < 1.0:
            continue
        dx /= length
        dy /= length
        # A beam that grazes a wall passes through its cells: stop a cell's width off the wall.
        facing = 1.0
        if surface[i, 0] != 0.0 or surface[i, 1] != 0.0:
            facing = max(abs(surface[i, 0] * dx + surface[i, 1] * dy), 0.05)
        lower_along(cells, (from_x, from_y, dx, dy, length - 1.0 / facing), mark, fall)


@kernel
def join_ends(
    joined: NDArray[np.uint8], points: NDArray[np.float32], laser: NDArray[np.float32]
) -> None:
    """Say between which ends of neighbouring beams there is a surface.

    The inverse of the range changes evenly along a straight wall. So two ends lie on one if it
    changes between them as it does towards the end before, or after.

    Args:
        joined: (n,), overwritten: whether an end is joined to the next.
        points: (n, 2) in the order of the beams [m].
        laser: (2,) where the laser was [m].
    """
    count = points.shape[0]
    inverse = np.empty(count)
    step = np.empty(count)
    least = math.inf
    last_x = 0.0
    last_y = 0.0
    for i in range(count):
        dx = points[i, 0] - laser[0]
        dy = points[i, 1] - laser[1]
        inverse[i] = 1.0 / max(math.hypot(dx, dy), 1e-3)
        if i > 0:
            angle = math.atan2(last_x * dy - last_y * dx, last_x * dx + last_y * dy)
            step[i - 1] = max(abs(angle), 1e-3)
            least = min(least, step[i - 1])
        last_x = dx
        last_y = dy
    for i in range(count):
        joined[i] = 0
        if i == count - 1 or step[i] > SURFACE.missed * least:
            continue
        away = math.hypot(points[i + 1, 0] - points[i, 0], points[i + 1, 1] - points[i, 1])
        if away > SURFACE.reach_m or away < 1e-6:
            continue
        rise = (inverse[i + 1] - inverse[i]) / step[i]
        noise = SURFACE.noise_m * inverse[i] * inverse[i] + SURFACE.noise_share * inverse[i]
        for j in (i - 1, i + 1):
            if 0 <= j < count - 1 and step[j] <= SURFACE.missed * least:
                before = (inverse[j + 1] - inverse[j]) / step[j]
                differs = abs(rise - before) * step[i]
                if differs <= 2.0 * noise + SURFACE.bend * abs(before) * step[i]:
                    joined[i] = 1


@kernel
def raise_along(
    cells: Cells,
    line: tuple[float, float, float, float, float],
    normal: NDArray[np.float64],
    change: tuple[int, int, int],
) -> None:
    """Raise the log-odds of the cells of a surface, those marked already left out.

    Args:
        cells: of the grid, in place.
        line: start x, y, unit direction x, y, and length [cells]; zero for a point.
        normal: (2,) of the surface, zero where unclear.
        change: mark of the keyframe, rise, and the largest log-odds.
    """
    x, y, dx, dy, length = line
    mark, rise, limit = change
    rows, cols = cells.log_odds.shape
    at = begin_march((x, y), (dx, dy), (math.floor(y), math.floor(x)), 0.0)
    while at.travelled <= length and 0 <= at.row < rows and 0 <= at.col < cols:
        if cells.marks[at.row, at.col] != mark:
            cells.marks[at.row, at.col] = mark
            cells.log_odds[at.row, at.col] = min(cells.log_odds[at.row, at.col] + rise, limit)
            if normal[0] != 0.0 or normal[1] != 0.0:
                cells.normals[at.row, at.col, 0] = round(FULL * normal[0])
                cells.normals[at.row, at.col, 1] = round(FULL * normal[1])
        at = next_cell(at)


@kernel
def lower_along(
    cells: Cells,
    beam: tuple[float, float, float, float, float],
    mark: int,
    fall: int,
) -> None:
    """Lower the log-odds of the cells that a beam passes, those marked already left out.

    Args:
        cells: of the grid, in place.
        beam: start x, y, unit direction x, y, and length [cells].
        mark: of the keyframe.
        fall: how much where the beam would cross a surface squarely, positive.
    """
    x, y, dx, dy, length = beam
    rows, cols = cells.log_odds.shape
    at = begin_march((x, y), (dx, dy), (math.floor(y), math.floor(x)), 0.0)
    while at.travelled < length and 0 <= at.row < rows and 0 <= at.col < cols:
        if cells.marks[at.row, at.col] != mark:
            cells.marks[at.row, at.col] = mark
            nx = cells.normals[at.row, at.col, 0]
            ny = cells.normals[at.row, at.col, 1]
            crossing = 1.0
            if nx != 0 or ny != 0:
                crossing = min(abs(nx * dx + ny * dy) / (FULL * SURFACE.squarely), 1.0)
            lowered = cells.log_odds[at.row, at.col] - round(fall * crossing)
            cells.log_odds[at.row, at.col] = max(lowered, -1000)
        at = next_cell(at)
