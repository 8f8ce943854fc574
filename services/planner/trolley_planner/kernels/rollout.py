"""Compiled motion of the robot over the window: clearance of its footprint, and rollouts.

Everything is in frame `grid` [m], times in seconds. A state is x, y, yaw, v, w.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel


class Field(NamedTuple):
    """What the window holds, for look-ups at any point."""

    distance_m: NDArray[np.float32]
    """(rows, cols) fine cells: distance to the nearest obstacle."""
    cost_m: NDArray[np.float32]
    """(rows, cols) coarse cells: cost-to-go in metres of free floor."""
    speed_mps: NDArray[np.float32]
    """(rows, cols) of the whole costmap: limits of the speed zones; (1, 1) if there are none."""
    x: float
    """Corner of the window [m]."""
    y: float
    fine_m: float
    """Edge of a fine cell."""
    coarse_m: float
    """Edge of a coarse cell."""
    cell_m: float
    """Edge of a cell of the costmap."""


class Body(NamedTuple):
    """The robot's outline."""

    edge_points: NDArray[np.float64]
    """(n, 2) in `base_link`."""
    inscribed_m: float
    circumscribed_m: float


class Limits(NamedTuple):
    """What the robot may do."""

    max_speed: float
    max_reverse: float
    max_turn: float
    acceleration: float
    deceleration: float
    turn_acceleration: float
    slow_speed: float
    caution_m: float
    clearance_m: float
    """The footprint keeps at least this far from everything."""
    dt: float


class Target(NamedTuple):
    """Where the drive leads next."""

    x: float
    y: float
    radius: float
    """Near enough [m]: what a rollout does after it was here costs nothing."""
    goes_on: bool
    """Whether the drive goes on from there, so that there is no need to slow down."""


class Prices(NamedTuple):
    """What counts how much, in metres of free floor."""

    near: float
    """A metre right at an obstacle."""
    near_m: float
    """Clearance from which on nothing is paid."""
    reverse: float
    """A metre backwards, besides its length."""
    turn: float
    """A second at 1 rad/s."""
    change_v: float
    """Squared changes of the speed."""
    change_w: float
    """Squared changes of the turn rate."""
    heading: float
    """Ending turned away from the way on."""


TURN_RADIUS_M = 0.2
"""A turn by a radian counts as so many metres where things are near."""
COLLISION = 1000.0
"""Price of touching something."""
GIVE_M = 1e-3
"""Distances this near to each other count as the same."""


@kernel
def bilinear(values: NDArray[np.float32], x_cells: float, y_cells: float) -> float:
    """Return a grid's value between cell centres; outside, that of the nearest cell."""
    rows, cols = values.shape
    u = min(max(x_cells - 0.5, 0.0), cols - 1.001)
    v = min(max(y_cells - 0.5, 0.0), rows - 1.001)
    col, row = math.floor(u), math.floor(v)
    a, b = u - col, v - row
    low = values[row, col] + a * (values[row, col + 1] - values[row, col])
    high = values[row + 1, col] + a * (values[row + 1, col + 1] - values[row + 1, col])
    return low + b * (high - low)


@kernel
def clearance_at(
    field: Field, body: Body, x: float, y: float, yaw: float, enough_m: float
) -> float:
    """Return the distance from the footprint to the nearest obstacle [m], at most `enough_m`.

    It is negative where an obstacle lies well inside.
    """
    scale = 1.0 / field.fine_m
    u, v = (x - field.x) * scale, (y - field.y) * scale
    half = 0.5 * field.fine_m
    centre = bilinear(field.distance_m, u, v) - half
    if centre >= body.circumscribed_m + enough_m:
        return enough_m
    if centre < body.inscribed_m:
        # Less than what edge points in an obstacle give, so that the way out only leads upwards.
        return centre - body.inscribed_m - half
    cos, sin = math.cos(yaw) * scale, math.sin(yaw) * scale
    nearest = enough_m + half
    for index in range(body.edge_points.shape[0]):
        px, py = body.edge_points[index, 0], body.edge_points[index, 1]
        distance = bilinear(field.distance_m, u + cos * px - sin * py, v + sin * px + cos * py)
        nearest = min(nearest, distance)
    return nearest - half


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
def allowed_speed(field: Field, limits: Limits, x: float, y: float, clearance_m: float) -> float:
    """Return the least speed limit at a point: own, zone, caution beside obstacles [m/s]."""
    share = (clearance_m - limits.clearance_m) / (limits.caution_m - limits.clearance_m)
    share = min(max(share, 0.0), 1.0)
    slow = min(limits.slow_speed, limits.max_speed)
    speed = slow + share * (limits.max_speed - slow)
    return min(speed, zone_speed(field, x, y))


@kernel
def follow_control(
    state: NDArray[np.float64], wanted_v: float, wanted_w: float, limits: Limits, allowed: float
) -> None:
    """Change the state's v and w towards what is wanted, as fast as the robot may.

    Slowing down for `allowed` has the same limit as any other braking.
    """
    v = state[3]
    faster, slower = limits.acceleration * limits.dt, limits.deceleration * limits.dt
    wanted = min(max(wanted_v, -min(limits.max_reverse, allowed)), allowed)
    up = faster if v >= 0.0 else slower
    down = slower if v > 0.0 else faster
    state[3] = min(max(wanted, v - down), v + up)
    change = limits.turn_acceleration * limits.dt
    wanted_turn = min(max(wanted_w, -limits.max_turn), limits.max_turn)
    state[4] = min(max(wanted_turn, state[4] - change), state[4] + change)


@kernel
def advance(state: NDArray[np.float64], dt: float) -> None:
    """Move the state along its arc, by the heading in the middle of the step."""
    middle = state[2] + 0.5 * dt * state[4]
    state[0] += state[3] * dt * math.cos(middle)
    state[1] += state[3] * dt * math.sin(middle)
    state[2] += state[4] * dt


@kernel
def downhill_point(field: Field, x: float, y: float, length_m: float) -> tuple[float, float]:
    """Return the point that lies `length_m` down the cost-to-go from here, or where it ends."""
    rows, cols = field.cost_m.shape
    col = min(max(math.floor((x - field.x) / field.coarse_m), 1), cols - 2)
    row = min(max(math.floor((y - field.y) / field.coarse_m), 1), rows - 2)
    travelled = 0.0
    while travelled < length_m:
        best_row, best_col, best = row, col, 0.0
        for row_step in (-1, 0, 1):
            for col_step in (-1, 0, 1):
                length = math.hypot(row_step, col_step)
                if length == 0.0:
                    continue
                fall = field.cost_m[row, col] - field.cost_m[row + row_step, col + col_step]
                if fall / length > best:
                    best_row, best_col, best = row + row_step, col + col_step, fall / length
        if best <= 0.0:
            break
        travelled += field.coarse_m * math.hypot(best_row - row, best_col - col)
        row, col = best_row, best_col
        if row == 0 or col == 0 or row == rows - 1 or col == cols - 1:
            break
    return field.x + (col + 0.5) * field.coarse_m, field.y + (row + 0.5) * field.coarse_m


@kernel
def cost_at(field: Field, x: float, y: float) -> float:
    """Return the cost-to-go at a point [m of free floor]."""
    return bilinear(field.cost_m, (x - field.x) / field.coarse_m, (y - field.y) / field.coarse_m)


@kernel
def price_of_step(
    state: NDArray[np.float64],
    previous: tuple[float, float],
    clearance: float,
    prices: Prices,
    dt: float,
) -> float:
    """Return what one step costs besides the way that is left."""
    near = max(0.0, 1.0 - clearance / prices.near_m)
    # By the way and not by the time: else it would put off going into a narrow place for ever.
    moved = abs(state[3]) + TURN_RADIUS_M * abs(state[4])
    price = dt * (prices.near * near * near * moved + prices.turn * state[4] * state[4])
    price += prices.change_v * (state[3] - previous[0]) ** 2
    price += prices.change_w * (state[4] - previous[1]) ** 2
    if state[3] < 0.0:
        price -= prices.reverse * state[3] * dt
    return price


@kernel
def price_of_end(field: Field, state: NDArray[np.float64], target: Target, prices: Prices) -> float:
    """Return what the way from a rollout's end costs."""
    price = cost_at(field, state[0], state[1])
    # Beside the target the heading is the final approach's business.
    if math.hypot(target.x - state[0], target.y - state[1]) > 0.25:
        ahead_x, ahead_y = downhill_point(field, state[0], state[1], 0.3)
        wanted = math.atan2(ahead_y - state[1], ahead_x - state[0])
        price += prices.heading * (1.0 - math.cos(wanted - state[2]))
    return price


@kernel
def rollout(
    controls: NDArray[np.float64],
    start: NDArray[np.float64],
    field: Field,
    body: Body,
    limits: Limits,
    target: Target,
    prices: Prices,
) -> float:
    """Drive a sequence of commands in thought; return its price.

    Args:
        controls: (steps, 2) v, w; replaced by what the limits leave of them.
        start: (5,).
        field: the window.
        body: the outline.
        limits: of the robot.
        target: where the drive leads next.
        prices: what counts how much.
    """
    state = start.copy()
    enough = max(limits.caution_m, prices.near_m)
    clearance = clearance_at(field, body, state[0], state[1], state[2], enough)
    # Who stands too close already must not come closer.
    floor = min(limits.clearance_m, clearance - GIVE_M)
    price = 0.0
    for step in range(controls.shape[0]):
        allowed = allowed_speed(field, limits, state[0], state[1], clearance)
        before = (state[3], state[4])
        follow_control(state, controls[step, 0], controls[step, 1], limits, allowed)
        controls[step, 0], controls[step, 1] = state[3], state[4]
        advance(state, limits.dt)
        clearance = clearance_at(field, body, state[0], state[1], state[2], enough)
        if clearance < floor:
            left = controls.shape[0] - step
            return price + COLLISION + left + cost_at(field, state[0], state[1])
        price += price_of_step(state, before, clearance, prices, limits.dt)
        if math.hypot(target.x - state[0], target.y - state[1]) < target.radius:
            left = (controls.shape[0] - 1 - step) * limits.dt
            return price - (left * limits.max_speed if target.goes_on else 0.0)
    return price + price_of_end(field, state, target, prices)


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
    delay_s: float,
) -> tuple[float, float]:
    """Return the smallest clearance until the robot stands, if it brakes after a delay.

    Args:
        start: (5,) with the velocity that is about to be commanded.
        field: the window.
        body: the outline.
        limits: braking.
        delay_s: how long the velocity goes on before the brakes act.

    Returns:
        The clearance now and the smallest on the way [m].
    """
    state = start.copy()
    enough = limits.clearance_m + 0.05
    now = clearance_at(field, body, state[0], state[1], state[2], enough)
    smallest = now
    dt = 0.04
    elapsed = 0.0
    while elapsed < 10.0:
        if elapsed >= delay_s:
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
