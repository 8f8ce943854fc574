"""What a rollout costs: the critics of single steps, and of its end.

Everything is in frame `grid` [m], costs in metres of free floor.
"""

import math
from typing import NamedTuple

from trolley.gridmap.kernels import interpolate
from trolley.jit import kernel
from trolley_planner.control.robot_motion import Limits
from trolley_planner.costmap.footprint import Field


class Target(NamedTuple):
    """Where the path leads next, in `grid`."""

    x: float
    """[m]."""
    y: float
    """[m]."""
    radius: float
    """Near enough [m]: what a rollout does after it was here costs nothing."""
    goes_on: bool
    """Whether the path goes on from there, so that there is no need to slow down."""


class Velocity(NamedTuple):
    """How the robot moves in a step."""

    v: float
    """Ahead [m/s]."""
    w: float
    """Turn rate, counter-clockwise [rad/s]."""


class CriticWeights(NamedTuple):
    """What a rollout costs, in metres of free floor; found by hand in simulated drives."""

    near: float = 0.8
    """A metre driven right at an obstacle."""
    near_m: float = 0.15
    """Clearance from which on obstacles cost nothing [m]."""
    reverse: float = 0.4
    """A metre backwards, besides its length."""
    turn: float = 0.02
    """A second of turning at 1 rad/s, growing with the square."""
    change_v: float = 0.3
    """A change of the speed by 1 m/s, growing with the square."""
    change_w: float = 0.1
    """A change of the turn rate by 1 rad/s, growing with the square."""
    heading: float = 0.15
    """Ending at a right angle to the path ahead."""
    proximity: float = 0.4
    """A second right beside a person or another robot."""


class CriticParams(NamedTuple):
    """Where and over which distance critics apply; by hand."""

    turn_radius_m: float = 0.2
    """Distance that a turn by one radian counts as where obstacles are near."""
    heading_matters_m: float = 0.25
    """Nearer to the target than this the final heading is left to the goal approach."""
    heading_ahead_m: float = 0.3
    """The direction of the path is taken over this distance."""


CRITICS = CriticWeights()
CRITIC_PARAMS = CriticParams()
DIAGONAL = math.hypot(1.0, 1.0)
"""From a cell to its diagonal neighbour [cells]."""


@kernel
def downhill_point(field: Field, x: float, y: float, length_m: float) -> tuple[float, float]:
    """Return the point that lies `length_m` down the cost-to-go from here, or where it ends."""
    rows, cols = field.cost_m.shape
    col = min(max(math.floor((x - field.x) / field.coarse_m), 1), cols - 2)
    row = min(max(math.floor((y - field.y) / field.coarse_m), 1), rows - 2)
    travelled = 0.0
    while travelled < length_m:
        best_row, best_col, best = row, col, 0.0
        here = field.cost_m[row, col]
        for row_step in range(-1, 2):
            for col_step in range(-1, 2):
                fall = float(here - field.cost_m[row + row_step, col + col_step])
                if row_step != 0 and col_step != 0 and fall > best:
                    fall /= DIAGONAL
                if fall > best:
                    best_row, best_col, best = row + row_step, col + col_step, fall
        if best <= 0.0:
            break
        is_diagonal = best_row != row and best_col != col
        travelled += field.coarse_m * (DIAGONAL if is_diagonal else 1.0)
        row, col = best_row, best_col
        if row == 0 or col == 0 or row == rows - 1 or col == cols - 1:
            break
    return field.x + (col + 0.5) * field.coarse_m, field.y + (row + 0.5) * field.coarse_m


@kernel
def cost_at(field: Field, x: float, y: float) -> float:
    """Return the cost-to-go at a point [m of free floor]."""
    col, row = (x - field.x) / field.coarse_m, (y - field.y) / field.coarse_m
    return interpolate(field.cost_m, col - 0.5, row - 0.5)


@kernel
def step_cost(
    now: Velocity,
    before: Velocity,
    clearance: float,
    dt: float,
) -> float:
    """Return what one step costs besides the remaining path.

    Args:
        now: in this step.
        before: in the one before it.
        clearance: at its end [m].
        dt: its length [s].
    """
    v, w = now.v, now.w
    near = max(0.0, 1.0 - clearance / CRITICS.near_m)
    # By distance and not by time: else it would put off entering a narrow place forever.
    moved = abs(v) + CRITIC_PARAMS.turn_radius_m * abs(w)
    cost = dt * (CRITICS.near * near * near * moved + CRITICS.turn * w * w)
    cost += CRITICS.change_v * (v - before.v) ** 2 + CRITICS.change_w * (w - before.w) ** 2
    return cost - CRITICS.reverse * min(v, 0.0) * dt


@kernel
def terminal_cost(
    field: Field,
    place: tuple[float, float],
    turned: tuple[float, float],
    target: Target,
    limits: Limits,
) -> float:
    """Return the cost from a rollout's end on; `turned`: cosine and sine of its heading."""
    x, y = place
    cost = left_m = cost_at(field, x, y)
    # Beside the target the heading is the final approach's business.
    if math.hypot(target.x - x, target.y - y) > CRITIC_PARAMS.heading_matters_m:
        ahead_x, ahead_y = downhill_point(field, x, y, CRITIC_PARAMS.heading_ahead_m)
        length = math.hypot(ahead_x - x, ahead_y - y)
        along = turned[0] * (ahead_x - x) + turned[1] * (ahead_y - y)
        ahead = along / length if length > 0.0 else 1.0
        cost += CRITICS.heading * (1.0 - ahead)
        # Among people it is more important to get out of their way.
        if ahead < 0.0 and field.walkers.shape[0] == 0:
            cost -= ahead * cost_of_turning_round(math.inf if target.goes_on else left_m, limits)
    return cost


@kernel
def cost_of_turning_round(left_m: float, limits: Limits) -> float:
    """Return what it costs to look away from a path: to turn round, or to back all the way.

    Args:
        left_m: length of the path.
        limits: of the robot.
    """
    turn = math.pi * limits.max_speed / limits.max_turn
    if limits.max_reverse <= 0.0:
        return turn
    slower = limits.max_speed / limits.max_reverse - 1.0
    # Nothing where it backs as fast, as out of people's way.
    return min(turn, slower * left_m) if slower > 0.0 else 0.0
