"""Beams of keyframes through the occupancy grid."""

import math

import numpy as np
from numpy.typing import NDArray

from trolley.gridmap.kernels import begin_march, next_cell
from trolley.jit import kernel


@kernel
def trace_keyframe(
    log_odds: NDArray[np.int16],
    marks: NDArray[np.int32],
    frame: NDArray[np.float64],
    points: NDArray[np.float32],
    normals: NDArray[np.float32],
    poses: tuple[NDArray[np.float64], NDArray[np.float32]],
    change: tuple[int, int, int, int],
) -> None:
    """Raise the log-odds where beams of a keyframe end and lower them where they pass.

    Each cell changes once for a keyframe, however many beams meet it; ends win.

    Args:
        log_odds: (rows, cols), in place; stays unknown where nothing passes.
        marks: (rows, cols), in place: the last keyframe that met the cell.
        frame: (3,) x, y [m] of the outer corner of cell (0, 0), and cells per metre.
        points: (n, 2) of the keyframe in `base_link` [m].
        normals: (n, 2), zero where unclear.
        poses: (3,) map_T_base, and (2,) the laser in `base_link` [m].
        change: mark of this keyframe, rise, fall, and the largest size of the log-odds.

    Source:
        Thrun, Burgard, Fox, Probabilistic Robotics (2005), table 9.1; Amanatides, Woo, A Fast
        Voxel Traversal Algorithm for Ray Tracing (1987).
    """
    pose, laser = poses
    mark, rise, fall, limit = change
    cos = math.cos(pose[2])
    sin = math.sin(pose[2])
    rows, cols = log_odds.shape
    from_x = (pose[0] + cos * laser[0] - sin * laser[1] - frame[0]) * frame[2]
    from_y = (pose[1] + sin * laser[0] + cos * laser[1] - frame[1]) * frame[2]
    ends = np.empty((points.shape[0], 2))
    for i in range(points.shape[0]):
        ends[i, 0] = (pose[0] + cos * points[i, 0] - sin * points[i, 1] - frame[0]) * frame[2]
        ends[i, 1] = (pose[1] + sin * points[i, 0] + cos * points[i, 1] - frame[1]) * frame[2]
        col = math.floor(ends[i, 0])
        row = math.floor(ends[i, 1])
        if 0 <= row < rows and 0 <= col < cols and marks[row, col] != mark:
            marks[row, col] = mark
            raised = log_odds[row, col] + rise
            log_odds[row, col] = min(raised, limit)
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
        if normals[i, 0] != 0.0 or normals[i, 1] != 0.0:
            nx = cos * normals[i, 0] - sin * normals[i, 1]
            ny = sin * normals[i, 0] + cos * normals[i, 1]
            facing = max(abs(nx * dx + ny * dy), 0.05)
        lower_along(log_odds, marks, (from_x, from_y, dx, dy, length - 1.0 / facing), mark, fall)


@kernel
def lower_along(
    log_odds: NDArray[np.int16],
    marks: NDArray[np.int32],
    beam: tuple[float, float, float, float, float],
    mark: int,
    fall: int,
) -> None:
    """Lower the log-odds of the cells that a beam passes, those marked already left out.

    Args:
        log_odds: (rows, cols), in place.
        marks: (rows, cols), in place.
        beam: start x, y, unit direction x, y, and length [cells].
        mark: of the keyframe.
        fall: how much, positive.
    """
    x, y, dx, dy, length = beam
    rows, cols = log_odds.shape
    at = begin_march((x, y), (dx, dy), (math.floor(y), math.floor(x)), 0.0)
    while at.travelled < length and 0 <= at.row < rows and 0 <= at.col < cols:
        if marks[at.row, at.col] != mark:
            marks[at.row, at.col] = mark
            lowered = log_odds[at.row, at.col] - fall
            log_odds[at.row, at.col] = max(lowered, -1000)
        at = next_cell(at)
