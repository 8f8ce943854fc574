"""The robot's motion, simulated over the local costmap: limits, rollouts and what they cost.

Everything is in frame `grid` [m], times in seconds. A state is x, y, yaw, v, w.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.gridmap.kernels import interpolate
from trolley.jit import kernel
from trolley_planner.control.look_ups import LookUps, look_up, make_look_ups
from trolley_planner.control.proximity import discs_in_reach, proximity_cost, standing_cost
from trolley_planner.costmap.footprint import (
    FEW_DO_M,
    Body,
    Field,
    clearance_at,
    clearance_turned,
)

DT_S = 0.1
"""Time step of rollouts [s]."""


class Limits(NamedTuple):
    """The robot's present limits."""

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


class Lanes(NamedTuple):
    """Rollouts that are simulated side by side."""

    sequence: NDArray[np.int64]
    """(lanes,) which control sequence each follows."""
    values: NDArray[np.float64]
    """(11, lanes) storage of the eleven arrays `x` to `cost`, which are its rows."""
    x: NDArray[np.float64]
    """(lanes,) position in `grid` [m]."""
    y: NDArray[np.float64]
    """(lanes,) [m]."""
    cos: NDArray[np.float64]
    """(lanes,) cosine of the heading."""
    sin: NDArray[np.float64]
    """(lanes,) sine of the heading."""
    v: NDArray[np.float64]
    """(lanes,) speed [m/s]."""
    w: NDArray[np.float64]
    """(lanes,) turn rate [rad/s]."""
    old_v: NDArray[np.float64]
    """(lanes,) speed one step before [m/s]."""
    old_w: NDArray[np.float64]
    """(lanes,) turn rate one step before [rad/s]."""
    clearance: NDArray[np.float64]
    """(lanes,) distance from the footprint to the nearest obstacle [m]."""
    near: NDArray[np.float64]
    """(lanes,) result of `proximity_cost`."""
    cost: NDArray[np.float64]
    """(lanes,) cost so far, in metres of free floor."""
    is_marked: NDArray[np.bool_]
    """(lanes,) scratch: which lanes are selected."""
    scratch: NDArray[np.float64]
    """(lanes,) scratch: the speed allowed, then the cost before this step."""
    close: NDArray[np.int64]
    """(lanes,) indices of the lanes that are close to an obstacle."""
    col: NDArray[np.float64]
    """(lanes,) column of each close lane [cells]."""
    row: NDArray[np.float64]
    """(lanes,) row of each close lane [cells]."""
    cos_by_cell: NDArray[np.float64]
    """(lanes,) cosine of each close lane's heading, per edge of a cell."""
    sin_by_cell: NDArray[np.float64]
    """(lanes,) sine of each close lane's heading, per edge of a cell."""
    least: NDArray[np.float64]
    """(lanes,) least distance found so far for each close lane [m]."""
    look_ups: LookUps


MOST_LANES, MOST_LOOK_UPS = 256, 512
"""Most lanes of a batch and most look-ups at once that stay in the cache; found by
bench/planner/rollouts."""
NUM_VALUES = 11
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
    """Simulate one control sequence (steps, 2); return what it costs, as `rollouts_into`."""
    cost = np.empty(1)
    rollouts_into(cost, controls.reshape((1, controls.shape[0], 2)), start, scene)
    return cost[0]


@kernel
def rollouts_into(
    out_costs: NDArray[np.float64],
    controls: NDArray[np.float64],
    start: NDArray[np.float64],
    scene: Scene,
) -> None:
    """Simulate control sequences and write what each costs [m of free floor].

    Many are simulated side by side, each in a lane of its own, so that the processor can do the
    same to several of them at once.

    Args:
        out_costs: (n,), overwritten.
        controls: (n, steps, 2) v, w; replaced by what the limits leave of them.
        start: (5,) state.
        scene: what is around the robot, its limits, and where the path leads.
    """
    field, limits, steps = scene.field, scene.limits, controls.shape[1]
    enough = max(limits.caution_m, CRITICS.near_m)
    turned = math.cos(start[2]), math.sin(start[2])
    clearance = clearance_turned(field, scene.body, (start[0], start[1]), turned, enough)
    # A robot that stands too close already must not come closer.
    floor = min(limits.clearance_m, clearance - ROLLOUT.same_clearance_m)
    lanes = make_lanes(min(MOST_LANES, controls.shape[0]))
    for first in range(0, controls.shape[0], MOST_LANES):
        last = min(first + MOST_LANES, controls.shape[0])
        begin_lanes(lanes, first, last, start, clearance)
        count = last - first
        for step in range(steps):
            drive_on(lanes, count, controls, step, scene)
            look_around(lanes, count, scene, enough)
            look_for_others(lanes, count, (step + 1) * limits.dt, scene)
            add_step_costs(lanes, count, limits.dt)
            count = end_lanes(out_costs, lanes, count, (step, steps), floor, scene)
        if field.walkers.shape[0] > 0:
            add_standing_costs(lanes, count, steps * limits.dt, scene)
        for lane in range(count):
            place, turned = (lanes.x[lane], lanes.y[lane]), (lanes.cos[lane], lanes.sin[lane])
            end = terminal_cost(field, place, turned, scene.target)
            out_costs[lanes.sequence[lane]] = lanes.cost[lane] + end


@kernel
def make_lanes(count: int) -> Lanes:
    """Return scratch for this many rollouts."""
    values, close = np.empty((NUM_VALUES, count)), np.zeros((5, count + 8))
    return Lanes(
        np.empty(count, np.int64),
        values,
        values[0],
        values[1],
        values[2],
        values[3],
        values[4],
        values[5],
        values[6],
        values[7],
        values[8],
        values[9],
        values[10],
        np.empty(count, np.bool_),
        np.empty(count),
        np.empty(count, np.int64),
        close[0],
        close[1],
        close[2],
        close[3],
        close[4],
        make_look_ups(MOST_LOOK_UPS),
    )


@kernel
def begin_lanes(
    lanes: Lanes, first: int, last: int, start: NDArray[np.float64], clearance: float
) -> None:
    """Put control sequences into the first lanes, at the start."""
    for lane in range(last - first):
        lanes.sequence[lane] = first + lane
        lanes.x[lane], lanes.y[lane] = start[0], start[1]
        lanes.cos[lane], lanes.sin[lane] = math.cos(start[2]), math.sin(start[2])
        lanes.v[lane], lanes.w[lane] = start[3], start[4]
        lanes.clearance[lane] = clearance
        lanes.near[lane] = lanes.cost[lane] = 0.0


@kernel
def drive_on(
    lanes: Lanes, count: int, controls: NDArray[np.float64], step: int, scene: Scene
) -> None:
    """Move each lane on by one step of its sequence, as fast as the limits allow."""
    field, limits = scene.field, scene.limits
    sequence, allowed, v, w = lanes.sequence, lanes.scratch, lanes.v, lanes.w
    x, y, cos, sin = lanes.x, lanes.y, lanes.cos, lanes.sin
    old_v, old_w, clearance = lanes.old_v, lanes.old_w, lanes.clearance
    for lane in range(count):
        allowed[lane] = caution_speed(limits, clearance[lane])
    if field.speed_mps.shape[0] > 1:
        for lane in range(count):
            allowed[lane] = min(allowed[lane], zone_speed(field, x[lane], y[lane]))
    for lane in range(count):
        old_v[lane], old_w[lane] = v[lane], w[lane]
    for lane in range(count):
        v[lane] = controls[sequence[lane], step, 0]
        w[lane] = controls[sequence[lane], step, 1]
    for lane in range(count):
        now = old_v[lane], old_w[lane]
        v[lane], w[lane] = followed(*now, (v[lane], w[lane]), limits, allowed[lane])
    for lane in range(count):
        controls[sequence[lane], step, 0] = v[lane]
        controls[sequence[lane], step, 1] = w[lane]
    for lane in range(count):
        place = x[lane], y[lane], (cos[lane], sin[lane])
        x[lane], y[lane], cos[lane], sin[lane] = moved(*place, (v[lane], w[lane]), limits.dt)


@kernel
def look_around(lanes: Lanes, count: int, scene: Scene, enough_m: float) -> None:
    """Look up the clearance of each lane, at most `enough_m`; as `clearance_turned`."""
    field, body, look_ups, clearance = scene.field, scene.body, lanes.look_ups, lanes.clearance
    scale, half, far = 1.0 / field.fine_m, 0.5 * field.fine_m, body.circumscribed_m + enough_m
    for lane in range(count):
        look_ups.x[lane] = (lanes.x[lane] - field.x) * scale - 0.5
        look_ups.y[lane] = (lanes.y[lane] - field.y) * scale - 0.5
    look_up(look_ups, field.distance_m, count)
    num_close = 0
    for lane in range(count):
        clearance[lane] = look_ups.x[lane] - half
        lanes.close[num_close] = lane
        num_close += 1 if body.inscribed_m <= clearance[lane] < far else 0
        if clearance[lane] < body.inscribed_m:
            clearance[lane] -= body.inscribed_m + half
        clearance[lane] = min(clearance[lane], enough_m)
    look_at_outline(lanes, num_close, scene, body.few_points)
    num_touching = 0
    for index in range(num_close):
        lane = lanes.close[index]
        clearance[lane] = min(lanes.least[index] - half, enough_m)
        lanes.close[num_touching] = lane
        num_touching += 1 if clearance[lane] < FEW_DO_M else 0
    look_at_outline(lanes, num_touching, scene, body.edge_points)
    for index in range(num_touching):
        clearance[lanes.close[index]] = min(lanes.least[index] - half, enough_m)


@kernel
def look_at_outline(lanes: Lanes, count: int, scene: Scene, points: NDArray[np.float64]) -> None:
    """Write the least distance of points (n, 2) of the body, for the lanes that are close."""
    field, look_ups, close, least = scene.field, lanes.look_ups, lanes.close, lanes.least
    scale, at_x, at_y = 1.0 / field.fine_m, look_ups.x, look_ups.y
    u, v, cos, sin = lanes.col, lanes.row, lanes.cos_by_cell, lanes.sin_by_cell
    for index in range(count):
        lane = close[index]
        u[index], v[index] = (lanes.x[lane] - field.x) * scale, (lanes.y[lane] - field.y) * scale
        cos[index], sin[index] = lanes.cos[lane] * scale, lanes.sin[lane] * scale
        least[index] = math.inf
    # Whole vectors only: what is behind the last lane is not looked at.
    wide = count + (-count) % 8
    at_once = MOST_LOOK_UPS // max(wide, 1)
    for first in range(0, points.shape[0], at_once):
        some = min(at_once, points.shape[0] - first)
        for part in range(some):
            px, py = points[first + part, 0], points[first + part, 1]
            for index in range(wide):
                at_x[part * wide + index] = u[index] + cos[index] * px - sin[index] * py - 0.5
            for index in range(wide):
                at_y[part * wide + index] = v[index] + sin[index] * px + cos[index] * py - 0.5
        look_up(look_ups, field.distance_m, some * wide)
        for part in range(some):
            for index in range(wide):
                least[index] = min(least[index], at_x[part * wide + index])


@kernel
def look_for_others(lanes: Lanes, count: int, time_s: float, scene: Scene) -> None:
    """Find how near each lane comes to people and other robots."""
    walkers, robots, body = scene.field.walkers, scene.field.robots, scene.body
    if walkers.shape[0] + robots.shape[0] == 0:
        return
    x, y, cos, sin, v, near = lanes.x, lanes.y, lanes.cos, lanes.sin, lanes.v, lanes.near
    walked = body.few_points, body.inscribed_m, body.circumscribed_m
    discs, is_close = discs_in_reach(walkers, robots, body.circumscribed_m, time_s), lanes.is_marked
    is_close[:count] = False
    for disc in range(discs.shape[0]):
        disc_x, disc_y, reach = discs[disc, 0], discs[disc, 1], discs[disc, 2] * discs[disc, 2]
        for lane in range(count):
            away_x, away_y = disc_x - x[lane], disc_y - y[lane]
            is_close[lane] |= away_x * away_x + away_y * away_y < reach
    for lane in range(count):
        near[lane] = 0.0
        if is_close[lane]:
            then = (x[lane], y[lane]), (cos[lane], sin[lane]), time_s
            near[lane] = proximity_cost(walkers, robots, walked, then, v[lane])


@kernel
def add_step_costs(lanes: Lanes, count: int, dt: float) -> None:
    """Add what this step costs."""
    v, w, old_v, old_w, cost = lanes.v, lanes.w, lanes.old_v, lanes.old_w, lanes.cost
    clearance, near, before = lanes.clearance, lanes.near, lanes.scratch
    for lane in range(count):
        before[lane] = cost[lane]
    for lane in range(count):
        cost[lane] += CRITICS.proximity * near[lane] * dt
    for lane in range(count):
        now, then = (v[lane], w[lane]), (old_v[lane], old_w[lane])
        cost[lane] += step_cost(now, then, clearance[lane], dt)


@kernel
def add_standing_costs(lanes: Lanes, count: int, time_s: float, scene: Scene) -> None:
    """Add what it costs to stand where each lane ends while people come along."""
    body = scene.body.few_points, scene.body.inscribed_m, scene.body.circumscribed_m
    for lane in range(count):
        place, turned = (lanes.x[lane], lanes.y[lane]), (lanes.cos[lane], lanes.sin[lane])
        near = standing_cost(scene.field.walkers, body, place, turned, time_s)
        lanes.cost[lane] += CRITICS.proximity * near


@kernel
def end_lanes(
    out_costs: NDArray[np.float64],
    lanes: Lanes,
    count: int,
    step_of: tuple[int, int],
    floor_m: float,
    scene: Scene,
) -> int:
    """End the lanes that touch something or have arrived; return how many go on.

    Args:
        out_costs: of all sequences; written for those that end.
        lanes: changed: the last one takes the place of one that ends.
        count: of lanes.
        step_of: the step, and how many there are.
        floor_m: less clearance than this is a collision.
        scene: as in `rollouts_into`.
    """
    field, limits, target = scene.field, scene.limits, scene.target
    step, steps = step_of
    all_x, all_y, clearance, near = lanes.x, lanes.y, lanes.clearance, lanes.near
    is_over, radius = lanes.is_marked, target.radius * target.radius
    for lane in range(count):
        is_there = (target.x - all_x[lane]) ** 2 + (target.y - all_y[lane]) ** 2 < radius
        is_over[lane] = is_there | (clearance[lane] < floor_m) | (near[lane] == math.inf)
    for lane in range(count - 1, -1, -1):
        if not is_over[lane]:
            continue
        x, y = all_x[lane], all_y[lane]
        if clearance[lane] < floor_m or near[lane] == math.inf:
            before = lanes.scratch[lane]
            cost = before + ROLLOUT.collision_cost + steps - step + cost_at(field, x, y)
        else:
            left = (steps - 1 - step) * limits.dt
            cost = lanes.cost[lane] - (left * limits.max_speed if target.goes_on else 0.0)
        out_costs[lanes.sequence[lane]] = cost
        count -= 1
        lanes.sequence[lane] = lanes.sequence[count]
        for value in range(NUM_VALUES):
            lanes.values[value, lane] = lanes.values[value, count]
    return count


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
