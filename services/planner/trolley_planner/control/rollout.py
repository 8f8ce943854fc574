"""Rollouts: control sequences, simulated side by side over the local costmap, and their costs.

Everything is in frame `grid` [m], times in seconds. A state is x, y, yaw, v, w.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel
from trolley_planner.control.critics import (
    CRITICS,
    Target,
    Velocity,
    cost_at,
    step_cost,
    terminal_cost,
)
from trolley_planner.control.look_ups import LookUps, look_up, make_look_ups
from trolley_planner.control.proximity import (
    PROXIMITY,
    fading,
    gap_cost,
    is_to_blame,
    standing_cost,
)
from trolley_planner.control.robot_motion import Limits, caution_speed, followed, moved, zone_speed
from trolley_planner.costmap.footprint import FEW_DO_M, Body, Field, clearance_turned
from trolley_planner.people.moving_obstacles import ROBOT_DT_S


class Scene(NamedTuple):
    """What rollouts need besides the robot's state."""

    field: Field
    """The local costmap's grids."""
    body: Body
    """The footprint."""
    limits: Limits
    target: Target


class RolloutParams(NamedTuple):
    """When a rollout ends; by hand."""

    collision_cost: float = 1000.0
    """Cost of touching something [m of free floor]."""
    middle: float = 1.0
    """Weight of the cost-to-go in the middle of a rollout in the open, which is 1 at its end. With
    the end alone, turns back to the path are put off from command to command."""
    same_clearance_m: float = 1e-3
    """Clearances that differ by less than this count as the same."""


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
    """(lanes,) cost of being near people and other robots."""
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


MOST_LANES, MOST_LOOK_UPS = 1024, 1024
"""Most lanes of a batch and most look-ups at once that stay in the cache; found by
bench/planner/rollouts."""
NUM_VALUES = 11
ROLLOUT = RolloutParams()


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
    # Near things, as where it has to back out first, the middle would have it turn too early.
    is_in_the_open = clearance >= enough and field.walkers.shape[0] == 0
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
            is_middle = step + 1 == steps // 2
            if is_middle and is_in_the_open:
                add_middle_costs(lanes, count, field)
            # In the middle, too: with the end alone, getting out of the way would be put off from
            # command to command.
            if field.walkers.shape[0] > 0 and (is_middle or step + 1 == steps):
                add_standing_costs(lanes, count, (step + 1) * limits.dt, scene)
            count = end_lanes(out_costs, lanes, count, (step, steps), floor, scene)
        for lane in range(count):
            place, turned = (lanes.x[lane], lanes.y[lane]), (lanes.cos[lane], lanes.sin[lane])
            end = terminal_cost(field, place, turned, scene.target, limits)
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
    walkers, robots, near = scene.field.walkers, scene.field.robots, lanes.near
    if walkers.shape[0] + robots.shape[0] == 0:
        return
    near[:count] = 0.0
    is_sure, least = time_s <= PROXIMITY.sure_s, lanes.least
    for number in range(walkers.shape[0]):
        x = walkers[number, 0] + time_s * walkers[number, 2]
        y = walkers[number, 1] + time_s * walkers[number, 3]
        spread = min(walkers[number, 5] * time_s, PROXIMITY.most_spread_m)
        left = math.exp(-fading(time_s, walkers[number, 6]))
        num_close = find_gaps(lanes, count, (x, y, walkers[number, 4] + spread), scene.body)
        for index in range(num_close):
            lane, gap = int(lanes.close[index]), float(least[index])
            if is_sure and gap < PROXIMITY.meet_m and meets(lanes, lane, (x, y)):
                near[lane] = math.inf
            near[lane] += left * gap_cost(gap, lanes.v[lane])
    if robots.shape[0] == 0:
        return
    nearest = lanes.scratch
    nearest[:count] = PROXIMITY.near_m
    step = min(round(time_s / ROBOT_DT_S), robots.shape[1] - 1)
    spread = min(PROXIMITY.robot_spread_mps * time_s, PROXIMITY.robot_most_spread_m)
    for number in range(robots.shape[0]):
        x, y, radius = robots[number, step, 0], robots[number, step, 1], robots[number, step, 2]
        num_close = find_gaps(lanes, count, (x, y, radius + spread), scene.body)
        for index in range(num_close):
            lane, gap = int(lanes.close[index]), float(least[index])
            if is_sure and gap < PROXIMITY.meet_m and meets(lanes, lane, (x, y)):
                near[lane] = math.inf
            nearest[lane] = min(nearest[lane], gap)
    for lane in range(count):
        share = min(1.0 - nearest[lane] / PROXIMITY.near_m, PROXIMITY.most_cost)
        near[lane] += share * share


@kernel
def find_gaps(lanes: Lanes, count: int, disc: tuple[float, float, float], body: Body) -> int:
    """Write which lanes are near a disc x, y, radius, and the gaps to it; as `disc_gap`.

    Returns:
        How many they are.
    """
    x, y, radius = disc
    lane_x, lane_y, close, points = lanes.x, lanes.y, lanes.close, body.few_points
    u, v, squared, least = lanes.col, lanes.row, lanes.cos_by_cell, lanes.least
    reach = radius + PROXIMITY.near_m + body.circumscribed_m
    num_close = 0
    for lane in range(count):
        away_x, away_y = x - lane_x[lane], y - lane_y[lane]
        close[num_close] = lane
        num_close += 1 if away_x * away_x + away_y * away_y < reach * reach else 0
    for index in range(num_close):
        lane = close[index]
        away_x, away_y = x - lane_x[lane], y - lane_y[lane]
        cos, sin = lanes.cos[lane], lanes.sin[lane]
        u[index], v[index] = cos * away_x + sin * away_y, cos * away_y - sin * away_x
        squared[index] = away_x * away_x + away_y * away_y
        least[index] = math.inf
    for point in range(points.shape[0]):
        point_x, point_y = points[point, 0], points[point, 1]
        for index in range(num_close):
            dx, dy = point_x - u[index], point_y - v[index]
            least[index] = min(least[index], dx * dx + dy * dy)
    inside = body.inscribed_m * body.inscribed_m
    for index in range(num_close):
        least[index] = math.sqrt(least[index]) - radius
        if squared[index] < inside:
            least[index] = math.sqrt(squared[index]) - body.inscribed_m - radius
    return num_close


@kernel
def meets(lanes: Lanes, lane: int, place: tuple[float, float]) -> bool:
    """Say whether the robot would be to blame for meeting what is at a place."""
    away = place[0] - lanes.x[lane], place[1] - lanes.y[lane]
    return is_to_blame(lanes.v[lane], away, (lanes.cos[lane], lanes.sin[lane]))


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
        now, then = Velocity(v[lane], w[lane]), Velocity(old_v[lane], old_w[lane])
        cost[lane] += step_cost(now, then, clearance[lane], dt)


@kernel
def add_middle_costs(lanes: Lanes, count: int, field: Field) -> None:
    """Add what it costs to have come no further than this by the middle of the time."""
    for lane in range(count):
        lanes.cost[lane] += ROLLOUT.middle * cost_at(field, lanes.x[lane], lanes.y[lane])


@kernel
def add_standing_costs(lanes: Lanes, count: int, time_s: float, scene: Scene) -> None:
    """Add half of what it costs to stand where each lane is while people come along."""
    body = scene.body.few_points, scene.body.inscribed_m, scene.body.circumscribed_m
    for lane in range(count):
        place, turned = (lanes.x[lane], lanes.y[lane]), (lanes.cos[lane], lanes.sin[lane])
        near = standing_cost(scene.field.walkers, body, place, turned, time_s)
        lanes.cost[lane] += 0.5 * CRITICS.proximity * near


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
