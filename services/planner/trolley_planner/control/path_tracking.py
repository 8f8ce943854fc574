"""Pure pursuit of the path itself, in the open, where nothing else is to be decided.

The cost-to-go of a cell does not tell a path from what lies a centimetre beside it: a controller
that goes by it weaves.

Source:
    Coulter, Implementation of the Pure Pursuit Path Tracking Algorithm (1992).
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel
from trolley_planner.control.critics import CRITICS
from trolley_planner.control.robot_motion import advance, allowed_speed, followed
from trolley_planner.control.rollout import Scene
from trolley_planner.costmap.footprint import clearance_at
from trolley_planner.sensing.beams import wrapped


class PathTrackingParams(NamedTuple):
    """When and how a path is followed; by hand."""

    lookahead_s: float = 0.7
    """Time that the carrot lies ahead of the robot at its present speed."""
    least_lookahead_m: float = 0.3
    """Least distance along the path from the robot to the carrot."""
    most_bearing_rad: float = 0.35
    """Angle to the carrot up to which the path is followed at full speed."""


PATH_TRACKING = PathTrackingParams()


@kernel
def track_into(
    out_controls: NDArray[np.float64],
    start: NDArray[np.float64],
    scene: Scene,
    path: NDArray[np.float64],
) -> bool:
    """Write the commands (steps, 2) that follow a path; say whether it is all in the open.

    That is where nobody moves, nothing is near enough to slow down for, and the path bends gently
    and does not end.

    Args:
        out_controls: (steps, 2), overwritten as far as it is in the open.
        start: (5,) state.
        scene: what is around the robot, and its limits.
        path: (n, 2) ahead of the robot, in `grid` [m].
    """
    field, body, limits = scene.field, scene.body, scene.limits
    if field.walkers.shape[0] + field.robots.shape[0] > 0 or path.shape[0] < 2:
        return False
    enough = max(limits.caution_m, CRITICS.near_m)
    state, index = start.copy(), 0
    for step in range(out_controls.shape[0]):
        if clearance_at(field, body, state[0], state[1], state[2], enough) < enough:
            return False
        ahead = max(PATH_TRACKING.lookahead_s * state[3], PATH_TRACKING.least_lookahead_m)
        index, x, y = carrot_of(path, index, state[0], state[1], ahead)
        if index < 0:
            return False
        bearing = wrapped(math.atan2(y - state[1], x - state[0]) - state[2])
        if abs(bearing) > PATH_TRACKING.most_bearing_rad:
            return False
        curvature = 2.0 * math.sin(bearing) / math.hypot(x - state[0], y - state[1])
        allowed = allowed_speed(field, limits, state[0], state[1], enough)
        wanted = allowed, max(state[3], 0.0) * curvature
        state[3], state[4] = followed(state[3], state[4], wanted, limits, allowed)
        out_controls[step, 0], out_controls[step, 1] = state[3], state[4]
        advance(state, limits.dt)
    return True


@kernel
def carrot_of(
    path: NDArray[np.float64], index: int, x: float, y: float, ahead_m: float
) -> tuple[int, float, float]:
    """Return the piece of a path (n, 2) nearest to a place, and the point so far ahead on it.

    Args:
        path: (n, 2) [m].
        index: of the piece from which on to look.
        x: of the place.
        y: of the place.
        ahead_m: along the path.

    Returns:
        Index, x, y [m]; the index is -1 where the path ends before.
    """
    while True:
        dx, dy = path[index + 1, 0] - path[index, 0], path[index + 1, 1] - path[index, 1]
        length = math.hypot(dx, dy)
        along = (x - path[index, 0]) * dx + (y - path[index, 1]) * dy
        if along < length * length or index + 2 >= path.shape[0]:
            break
        index += 1
    left = ahead_m + (max(along / length, 0.0) if length > 0.0 else 0.0)
    piece = index
    while piece + 1 < path.shape[0]:
        dx, dy = path[piece + 1, 0] - path[piece, 0], path[piece + 1, 1] - path[piece, 1]
        length = math.hypot(dx, dy)
        if left <= length and length > 0.0:
            part = left / length
            return index, path[piece, 0] + part * dx, path[piece, 1] + part * dy
        left -= length
        piece += 1
    return -1, x, y
