"""What the map makes of each beam."""

import math

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel
from trolley.scanning.deskew import Points
from trolley_localizer.kernels.layout import Lines
from trolley_localizer.kernels.weights import sample_field

# From BEHIND_MIRROR on a beam says nothing of the map.
EXPLAINED = 0
NOT_ON_MAP = 1
BEHIND_MIRROR = 2
SUSPECTED = 3
UNUSED = 4


@kernel
def mark_crossing(
    out_class: NDArray[np.uint8],
    pose: NDArray[np.float64],
    end: Points,
    start: Points,
    lines: Lines,
    depth: float,
    mark: int,
) -> int:
    """Mark the beams that meet a line and go on behind it, seen from a pose.

    Args:
        out_class: (n,) `mark` is written where a used beam meets a line.
        pose: (3,) x, y [cells], yaw [rad] in `grid`.
        end: (n,) end points in `base_link` [cells].
        start: (n,) where the laser was in `base_link` [cells].
        lines: mirrors and glass in `grid` [cells].
        depth: how far behind the line the end must lie [cells].
        mark: BEHIND_MIRROR or SUSPECTED.

    Returns:
        How many beams were marked.
    """
    cos = math.cos(pose[2])
    sin = math.sin(pose[2])
    marked = 0
    for i in range(end.x.size):
        if out_class[i] >= BEHIND_MIRROR:
            continue
        sx = pose[0] + cos * start.x[i] - sin * start.y[i]
        sy = pose[1] + sin * start.x[i] + cos * start.y[i]
        dx = pose[0] + cos * end.x[i] - sin * end.y[i] - sx
        dy = pose[1] + sin * end.x[i] + cos * end.y[i] - sy
        length = math.hypot(dx, dy)
        for k in range(lines.ax.size):
            ex = lines.bx[k] - lines.ax[k]
            ey = lines.by[k] - lines.ay[k]
            cross = dx * ey - dy * ex
            if abs(cross) < 1e-9:
                continue
            wx = lines.ax[k] - sx
            wy = lines.ay[k] - sy
            along_beam = (wx * ey - wy * ex) / cross
            along_line = (wx * dy - wy * dx) / cross
            if (
                along_beam > 0.0
                and 0.0 <= along_line <= 1.0
                and (1.0 - along_beam) * length >= depth
            ):
                out_class[i] = mark
                marked += 1
                break
    return marked


@kernel
def explain_beams(
    out_class: NDArray[np.uint8],
    pose: NDArray[np.float64],
    end: Points,
    field: NDArray[np.float32],
    near: float,
) -> tuple[int, int]:
    """Tell the beams that end at a wall of the map from those that do not.

    Args:
        out_class: (n,) EXPLAINED or NOT_ON_MAP is written where a beam is neither unused nor
            behind a mirror.
        pose: (3,) x, y [cells], yaw [rad] in `grid`.
        end: (n,) end points in `base_link` [cells].
        field: (rows + 2, cols + 2) distance to the nearest wall [cells].
        near: an end point within this distance of a wall is explained [cells].

    Returns:
        How many beams were explained, and how many were looked at.
    """
    cos = math.cos(pose[2])
    sin = math.sin(pose[2])
    explained = 0
    looked_at = 0
    for i in range(end.x.size):
        if out_class[i] >= BEHIND_MIRROR:
            continue
        x = pose[0] + cos * end.x[i] - sin * end.y[i]
        y = pose[1] + sin * end.x[i] + cos * end.y[i]
        looked_at += 1
        if sample_field(field, x, y) <= near:
            out_class[i] = EXPLAINED
            explained += 1
        else:
            out_class[i] = NOT_ON_MAP
    return explained, looked_at


@kernel
def passes_wall(
    field: NDArray[np.float32],
    x: float,
    y: float,
    direction: float,
    length: float,
    margin: float,
) -> bool:
    """Say whether a ray meets a wall of the map well before its end.

    Args:
        field: (rows + 2, cols + 2) distance to the nearest wall [cells].
        x: where the ray begins [cells], `y` alike.
        y: see `x`.
        direction: [rad] in `grid`.
        length: [cells].
        margin: a wall within this distance of the end does not count [cells].
    """
    cos = math.cos(direction)
    sin = math.sin(direction)
    travelled = 0.5
    last_row = field.shape[0] - 1
    last_col = field.shape[1] - 1
    while travelled < length - margin:
        col = x + travelled * cos + 1.0
        row = y + travelled * sin + 1.0
        if not (0.0 <= col < last_col and 0.0 <= row < last_row):
            return False
        free = np.float64(field[int(row), int(col)])
        if free < 0.5:
            return True
        # Cell centres lie within 0.71 of any point of the cell: a shorter step cannot miss.
        travelled += max(free - 1.42, 0.5)
    return False


@kernel
def count_through(
    pose: NDArray[np.float64],
    end: Points,
    start: Points,
    classes: NDArray[np.uint8],
    field: NDArray[np.float32],
    margin: float,
    every: int,
) -> tuple[int, int, int]:
    """Count the beams that ought to have ended at a nearer wall of the map.

    Args:
        pose: (3,) x, y [cells], yaw [rad] in `grid`.
        end: (n,) end points in `base_link` [cells].
        start: (n,) where the laser was in `base_link` [cells].
        classes: (n,) EXPLAINED or NOT_ON_MAP; other beams are left out.
        field: (rows + 2, cols + 2) distance to the nearest wall [cells].
        margin: a wall within this distance of the end does not count [cells].
        every: look at one beam in so many.

    Returns:
        How many went through a wall and end at one, how many went through a wall and end at none,
        and how many were looked at.
    """
    cos = math.cos(pose[2])
    sin = math.sin(pose[2])
    through = 0
    astray = 0
    looked_at = 0
    for i in range(0, end.x.size, every):
        if classes[i] >= BEHIND_MIRROR:
            continue
        dx = end.x[i] - start.x[i]
        dy = end.y[i] - start.y[i]
        looked_at += 1
        if passes_wall(
            field,
            pose[0] + cos * start.x[i] - sin * start.y[i],
            pose[1] + sin * start.x[i] + cos * start.y[i],
            pose[2] + math.atan2(dy, dx),
            math.hypot(dx, dy),
            margin,
        ):
            if classes[i] == EXPLAINED:
                through += 1
            else:
                astray += 1
    return through, astray, looked_at
