"""The robot's motion, simulated over the local costmap: limits, rollouts and what they cost.

Everything is in frame `grid` [m], times in seconds. A state is x, y, yaw, v, w.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.gridmap.kernels import interpolate
from trolley.jit import kernel
from trolley_planner.control.proximity import proximity_cost
from trolley_planner.costmap.footprint import (
    Body,
    Field,
    clearance_at,
    clearance_turned,
    outline_clearance,
)

DT_S = 0.1
"""Time step of rollouts [s]."""


class Limits(NamedTuple):
    """What the robot may do at the moment."""

    max_speed: float
    """[m/s]."""
    max_reverse: float
    """Highest speed backwards [m/s]."""
    max_turn: float
    """[rad/s]."""
    acceleration: float
    """[m/s^2]."""
    deceleration: float
    """[m/s^2]."""
    turn_acceleration: float
    """[rad/s^2]."""
    slow_speed: float
    """Speed right beside obstacles [m/s]."""
    caution_m: float
    """Clearance below which the robot slows down."""
    clearance_m: float
    """The footprint keeps at least this far from everything."""
    dt: float
    """Time step [s]."""


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


class Scene(NamedTuple):
    """What rollouts need besides the robot's state."""

    field: Field
    """The local costmap's grids."""
    body: Body
    """The footprint."""
    limits: Limits
    target: Target


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


class RolloutParams(NamedTuple):
    """How the robot's motion is simulated; by hand where no source is given."""

    turn_radius_m: float = 0.2
    """Distance that a turn by one radian counts as where obstacles are near."""
    delay_s: float = 0.15
    """Time from a command to what the wheels make of it, the age of the scan included."""
    collision_cost: float = 1000.0
    """Cost of touching something [m of free floor]."""
    same_clearance_m: float = 1e-3
    """Clearances that differ by less than this count as the same."""
    heading_matters_m: float = 0.25
    """Nearer to the target than this the final heading is left to the goal approach."""
    heading_ahead_m: float = 0.3
    """The direction of the path is taken over this distance."""
    braking_dt_s: float = 0.04
    """Time step of the braking check."""
    longest_braking_s: float = 10.0
    """The braking check ends after this time."""


CRITICS = CriticWeights()
ROLLOUT = RolloutParams()
DIAGONAL = math.hypot(1.0, 1.0)
"""From a cell to its diagonal neighbour [cells]."""


@kernel
def zone_speed(field: Field, x: float, y: float) -> float:
    """Return the limit of the speed zones at a point [m/s]."""
    rows, cols = field.speed_mps.shape
    if rows == 1 and cols == 1:
        return field.speed_mps[0, 0]
    row = min(max(math.floor(y / field.cell_m), 0), rows - 1)
    col = min(max(math.floor(x / field.cell_m), 0), cols - 1)
    return field.speed_mps[row, col]


@kernel
def caution_speed(limits: Limits, clearance_m: float) -> float:
    """Return the speed limit of caution beside obstacles [m/s].

    It rises evenly with the clearance, but is never less than what the robot can brake from in it.
    """
    room = max(0.0, clearance_m - limits.clearance_m)
    share = min(room / (limits.caution_m - limits.clearance_m), 1.0)
    slow = min(limits.slow_speed, limits.max_speed)
    late = limits.deceleration * ROLLOUT.delay_s
    stoppable = math.sqrt(late * late + 2.0 * limits.deceleration * room) - late
    return min(limits.max_speed, max(slow + share * (limits.max_speed - slow), stoppable))


@kernel
def allowed_speed(field: Field, limits: Limits, x: float, y: float, clearance_m: float) -> float:
    """Return the least speed limit at a point: own, zone, caution beside obstacles [m/s]."""
    return min(caution_speed(limits, clearance_m), zone_speed(field, x, y))


@kernel
def followed(
    v: float, w: float, wanted: tuple[float, float], limits: Limits, allowed: float
) -> tuple[float, float]:
    """Return v and w after a step towards what is wanted, as fast as the robot may change them.

    Slowing down for `allowed` has the same limit as any other braking.
    """
    faster, slower = limits.acceleration * limits.dt, limits.deceleration * limits.dt
    wanted_v = min(max(wanted[0], -min(limits.max_reverse, allowed)), allowed)
    up = faster if v >= 0.0 else slower
    down = slower if v > 0.0 else faster
    change = limits.turn_acceleration * limits.dt
    wanted_w = min(max(wanted[1], -limits.max_turn), limits.max_turn)
    return (
        min(max(wanted_v, v - down), v + up),
        min(max(wanted_w, w - change), w + change),
    )


@kernel
def advance(state: NDArray[np.float64], dt: float) -> None:
    """Move the state along its arc, by the heading in the middle of the step."""
    middle = state[2] + 0.5 * dt * state[4]
    state[0] += state[3] * dt * math.cos(middle)
    state[1] += state[3] * dt * math.sin(middle)
    state[2] += state[4] * dt


@kernel
def moved(
    x: float, y: float, turned: tuple[float, float], twist: tuple[float, float], dt: float
) -> tuple[float, float, float, float]:
    """Return x, y and the cosine and sine of the heading after a step along an arc, as `advance`.

    Args:
        x: [m].
        y: [m].
        turned: cosine and sine of the heading before.
        twist: v and w.
        dt: [s].
    """
    half = 0.5 * dt * twist[1]
    # Series do for half a step's turn: 1e-9 at 0.2 rad, and no sine is computed.
    square = half * half
    sin = half * (1.0 - square / 6.0 * (1.0 - square / 20.0))
    cos = 1.0 - 0.5 * square * (1.0 - square / 12.0 * (1.0 - square / 30.0))
    middle_cos, middle_sin = turned[0] * cos - turned[1] * sin, turned[1] * cos + turned[0] * sin
    distance = twist[0] * dt
    return (
        x + distance * middle_cos,
        y + distance * middle_sin,
        middle_cos * cos - middle_sin * sin,
        middle_sin * cos + middle_cos * sin,
    )


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
    now: tuple[float, float],
    before: tuple[float, float],
    clearance: float,
    dt: float,
) -> float:
    """Return what one step costs besides the remaining path, by v and w in it and before it."""
    v, w = now
    near = max(0.0, 1.0 - clearance / CRITICS.near_m)
    # By distance and not by time: else it would put off entering a narrow place forever.
    moved = abs(v) + ROLLOUT.turn_radius_m * abs(w)
    cost = dt * (CRITICS.near * near * near * moved + CRITICS.turn * w * w)
    cost += CRITICS.change_v * (v - before[0]) ** 2 + CRITICS.change_w * (w - before[1]) ** 2
    return cost - CRITICS.reverse * min(v, 0.0) * dt


@kernel
def terminal_cost(
    field: Field,
    place: tuple[float, float],
    turned: tuple[float, float],
    target: Target,
) -> float:
    """Return the cost from a rollout's end on; `turned`: cosine and sine of its heading."""
    x, y = place
    cost = cost_at(field, x, y)
    # Beside the target the heading is the final approach's business.
    if math.hypot(target.x - x, target.y - y) > ROLLOUT.heading_matters_m:
        ahead_x, ahead_y = downhill_point(field, x, y, ROLLOUT.heading_ahead_m)
        length = math.hypot(ahead_x - x, ahead_y - y)
        along = turned[0] * (ahead_x - x) + turned[1] * (ahead_y - y)
        cost += CRITICS.heading * (1.0 - along / length) if length > 0.0 else 0.0
    return cost


@kernel
def rollout(controls: NDArray[np.float64], start: NDArray[np.float64], scene: Scene) -> float:
    """Simulate a control sequence; return its cost [m of free floor].

    Args:
        controls: (steps, 2) v, w; replaced by what the limits leave of them.
        start: (5,) state.
        scene: what is around the robot, its limits, and where the path leads.
    """
    field, body, limits, target = scene.field, scene.body, scene.limits, scene.target
    x, y, v, w = start[0], start[1], start[3], start[4]
    cos, sin = math.cos(start[2]), math.sin(start[2])
    enough = max(limits.caution_m, CRITICS.near_m)
    clearance = clearance_turned(field, body, (x, y), (cos, sin), enough)
    # A robot that stands too close already must not come closer.
    floor = min(limits.clearance_m, clearance - ROLLOUT.same_clearance_m)
    has_zones, cost = field.speed_mps.shape[0] > 1, 0.0
    distance_m, outline = field.distance_m, (body.few_points, body.edge_points)
    scale, half = 1.0 / field.fine_m, 0.5 * field.fine_m
    inscribed, far = body.inscribed_m, body.circumscribed_m + enough
    walkers, robots = field.walkers, field.robots
    walked = body.few_points, inscribed, body.circumscribed_m
    open_speed = caution_speed(limits, enough)
    for step in range(controls.shape[0]):
        allowed = open_speed if clearance == enough else caution_speed(limits, clearance)
        if has_zones:
            allowed = min(allowed, zone_speed(field, x, y))
        before = (v, w)
        v, w = followed(v, w, (controls[step, 0], controls[step, 1]), limits, allowed)
        controls[step, 0], controls[step, 1] = v, w
        x, y, cos, sin = moved(x, y, (cos, sin), (v, w), limits.dt)
        # `clearance_turned` by hand: passing `field` and `body` on takes as long as the look-up.
        cells = (x - field.x) * scale, (y - field.y) * scale
        clearance = interpolate(distance_m, cells[0] - 0.5, cells[1] - 0.5) - half
        if clearance < inscribed:
            clearance -= inscribed + half
        elif clearance < far:
            face = (cos * scale, sin * scale)
            clearance = outline_clearance(distance_m, outline, cells, face, half)
        clearance, near = min(clearance, enough), 0.0
        if walkers.shape[0] + robots.shape[0] > 0:
            then = (x, y), (cos, sin), (step + 1) * limits.dt
            near = proximity_cost(walkers, robots, walked, then, v)
        if clearance < floor or near == math.inf:
            return cost + ROLLOUT.collision_cost + controls.shape[0] - step + cost_at(field, x, y)
        cost += CRITICS.proximity * near * limits.dt
        cost += step_cost((v, w), before, clearance, limits.dt)
        if (target.x - x) ** 2 + (target.y - y) ** 2 < target.radius * target.radius:
            left = (controls.shape[0] - 1 - step) * limits.dt
            return cost - (left * limits.max_speed if target.goes_on else 0.0)
    return cost + terminal_cost(field, (x, y), (cos, sin), target)


@kernel
def trace_into(
    out_poses: NDArray[np.float32],
    controls: NDArray[np.float64],
    start: NDArray[np.float64],
    dt: float,
) -> None:
    """Write the poses (steps + 1, 3) that a sequence of commands leads through."""
    state = start.copy()
    for step in range(controls.shape[0] + 1):
        for axis in range(3):
            out_poses[step, axis] = state[axis]
        if step < controls.shape[0]:
            state[3], state[4] = controls[step, 0], controls[step, 1]
            advance(state, dt)


@kernel
def stopping_clearance(
    start: NDArray[np.float64],
    field: Field,
    body: Body,
    limits: Limits,
) -> tuple[float, float]:
    """Return the smallest clearance until the robot stands, if it brakes after `ROLLOUT.delay_s`.

    Args:
        start: (5,) with the velocity that is about to be commanded.
        field: the local costmap.
        body: the outline.
        limits: braking.

    Returns:
        The clearance now and the smallest until it stands [m].
    """
    state = start.copy()
    enough = limits.clearance_m + 0.05
    now = clearance_at(field, body, state[0], state[1], state[2], enough)
    smallest = now
    dt = ROLLOUT.braking_dt_s
    elapsed = 0.0
    while elapsed < ROLLOUT.longest_braking_s:
        if elapsed >= ROLLOUT.delay_s:
            v, w = abs(state[3]), abs(state[4])
            slower = max(0.0, v - limits.deceleration * dt)
            # On its arc as long as it moves; a turn in place has its own brake.
            share = slower / v if v > 1e-6 else 0.0
            turn = w * share if v > 1e-6 else max(0.0, w - limits.turn_acceleration * dt)
            state[3] = math.copysign(slower, state[3])
            state[4] = math.copysign(turn, state[4])
        if state[3] == 0.0 and state[4] == 0.0:
            break
        advance(state, dt)
        elapsed += dt
        clearance = clearance_at(field, body, state[0], state[1], state[2], enough)
        smallest = min(smallest, clearance)
    return now, smallest
