"""Direct drives to the goal, tried from states near it.

Turn, straight line, turn; or one curve; or a curve onto the goal's place and a turn there. They
take the place of Reeds and Shepp's curves, since this robot turns on the spot.
"""

import math
from typing import NamedTuple

import numpy as np

from trolley.jit import kernel, lean_kernel
from trolley_planner.paths.hybrid_astar.curves import curve_cost, curve_count, curve_into
from trolley_planner.paths.hybrid_astar.footprint_spans import TURN_RAD, nearest_angle
from trolley_planner.paths.hybrid_astar.heuristic import Query
from trolley_planner.paths.hybrid_astar.motion_primitives import (
    BACKWARDS,
    CELL_M,
    COSTS,
    FORWARDS,
    TURNING,
    Motions,
    PoseXYYaw,
    change_cost,
)
from trolley_planner.paths.hybrid_astar.search_space import SearchSpace, can_turn, cost_per_metre
from trolley_planner.sensing.beams import wrapped


class ExpansionParams(NamedTuple):
    """How direct drives are tried; by hand."""

    step_m: float = 0.0375
    """A straight line is checked in steps no longer than this."""
    swings: int = 6
    """Number of headings to either side of the straight line in which curves to a place with room
    to turn end."""
    swing_rad: float = 0.2
    """Angle between two of these headings."""


EXPANSION = ExpansionParams()


class Drive(NamedTuple):
    """Turn, straight line, turn."""

    cost: float
    """+inf where there is none."""
    first_turn: float
    """[rad]."""
    length: float
    """[m], negative backwards."""
    last_turn: float
    """[rad]."""


class Curve(NamedTuple):
    """A curve, followed by a turn on the spot where it does not end in the goal's heading."""

    cost: float
    """+inf where there is none."""
    sense: int
    """FORWARDS or BACKWARDS; 0 where there is none."""
    yaw: float
    """Heading at the end of the curve [rad]."""


class Expansion(NamedTuple):
    """The cheapest of each kind; those found later are there only if they are cheaper."""

    drive: Drive
    curve: Curve
    """Ends in the goal's heading."""
    swing: Curve
    """Ends in another heading."""


NO_CURVE = Curve(math.inf, 0, 0.0)


@kernel
def expand_to_goal(
    space: SearchSpace, query: Query, start: PoseXYYaw, before: int, most: float
) -> Expansion:
    """Return the cheapest direct drives from a pose to the goal.

    Args:
        space: where it is.
        query: has the goal.
        start: pose.
        before: how the robot came there.
        most: they must cost less than this [m].
    """
    drive = straight_drive(space, query, start, before, most)
    most = min(most, drive.cost)
    curve = direct_curve(space, query, start, before, most)
    swing = NO_CURVE
    if can_turn(space, query.goal[:2], 0.0):
        swing = curve_and_turn(space, query, start, before, min(most, curve.cost))
    return Expansion(drive, curve, swing)


@lean_kernel
def turn_cost(space: SearchSpace, pose: PoseXYYaw, turn: float) -> float:
    """Return what a turn on the spot by an angle costs [m], +inf if something is in the way."""
    count = math.ceil(abs(turn) / TURN_RAD)
    total = 0.0
    for index in range(1, count + 1):
        angle = nearest_angle(pose[2] + turn * index / count)
        price = cost_per_metre(space, pose[:2], angle, TURNING)
        if price == math.inf:
            return math.inf
        total += price * COSTS.turn_m * abs(turn) / count
    return total


@lean_kernel
def cheaper_turn(space: SearchSpace, pose: PoseXYYaw, turn: float) -> tuple[float, float]:
    """Return cost and angle of a turn to a heading: the shorter way around if that is free."""
    cost = turn_cost(space, pose, turn)
    if cost < math.inf:
        return cost, turn
    longer = turn - math.copysign(2.0 * math.pi, turn)
    return turn_cost(space, pose, longer), longer


@lean_kernel
def last_turn(query: Query, turn: float) -> float:
    """Return by how much to turn at the goal, to half of what may be missed [rad]."""
    turn = wrapped(turn)
    if query.any_heading or abs(turn) <= query.yaw_rad:
        return 0.0
    return turn - math.copysign(0.5 * query.yaw_rad, turn)


@lean_kernel
def straight_drive(
    space: SearchSpace, query: Query, start: PoseXYYaw, before: int, most: float
) -> Drive:
    """Return the cheapest drive of turn, straight line, turn; see `expand_to_goal`."""
    (x, y, yaw), (goal_x, goal_y, goal_yaw) = start, query.goal
    length = math.hypot(goal_x - x, goal_y - y)
    best = Drive(most, 0.0, 0.0, 0.0)
    if length <= query.xy_m:
        cost, turn = cheaper_turn(space, start, last_turn(query, goal_yaw - yaw))
        cost += change_cost(before, TURNING)
        return Drive(cost if cost < most else math.inf, 0.0, 0.0, turn)
    bearing = math.atan2(goal_y - y, goal_x - x)
    count = math.ceil(length / EXPANSION.step_m)
    for motion in (FORWARDS, BACKWARDS):
        facing = bearing if motion == FORWARDS else bearing + math.pi
        angle = nearest_angle(facing)
        turns = abs(wrapped(facing - yaw))
        turns += abs(last_turn(query, goal_yaw - facing))
        if length + COSTS.turn_m * turns >= best.cost:
            continue
        cost = 0.0
        for index in range(1, count + 1):
            share = index / count
            place = x + share * (goal_x - x), y + share * (goal_y - y)
            cost += cost_per_metre(space, place, angle, query.sense * motion) * length / count
            if cost >= best.cost:
                break
        if cost >= best.cost:
            continue
        price, first = cheaper_turn(space, start, wrapped(facing - yaw))
        cost += price + change_cost(before, motion if abs(first) < 0.01 else TURNING)
        cost += COSTS.halt_m if abs(first) >= 0.01 else 0.0
        last = last_turn(query, goal_yaw - facing)
        if last != 0.0:
            price, last = cheaper_turn(space, (goal_x, goal_y, facing), last)
            cost += price + COSTS.halt_m
        if cost < best.cost:
            best = Drive(cost, first, length * motion, last)
    return best if best.length != 0.0 else Drive(math.inf, 0.0, 0.0, 0.0)


@kernel
def direct_curve(
    space: SearchSpace, query: Query, start: PoseXYYaw, before: int, most: float
) -> Curve:
    """Return one curve to the goal; see `expand_to_goal`."""
    first, last = np.array(start), np.array(query.goal)
    last[2] = first[2] + wrapped(last[2] - first[2])
    ahead = (last[0] - first[0]) * math.cos(first[2]) + (last[1] - first[1]) * math.sin(first[2])
    sense = FORWARDS if ahead > 0.0 else BACKWARDS
    count = curve_count(first, last)
    most -= change_cost(before, sense)
    if query.any_heading or count < 2 or count * CELL_M > most + CELL_M:
        return NO_CURVE
    curve = np.empty((count, 3))
    if not curve_into(curve, first, last, sense):
        return NO_CURVE
    cost = curve_cost(curve, first, space, query.sense * sense, most)
    return Curve(cost + change_cost(before, sense), sense, query.goal[2])


@kernel
def curve_and_turn(
    space: SearchSpace, query: Query, start: PoseXYYaw, before: int, most: float
) -> Curve:
    """Return the cheapest curve to a place with a turn on the spot at its end.

    See `expand_to_goal`; at the goal there is room to turn.
    """
    first, last = np.array(start), np.array(query.goal)
    best = Curve(most, 0, 0.0)
    count = curve_count(first, last)
    if count < 2:
        return NO_CURVE
    bearing = math.atan2(last[1] - first[1], last[0] - first[0])
    curve = np.empty((count, 3))
    for sense in (FORWARDS, BACKWARDS):
        facing = bearing if sense == FORWARDS else bearing + math.pi
        for which in range(-EXPANSION.swings, EXPANSION.swings + 1):
            last[2] = first[2] + wrapped(facing + which * EXPANSION.swing_rad - first[2])
            turn = abs(last_turn(query, query.goal[2] - last[2]))
            least = change_cost(before, sense)
            least += COSTS.halt_m + COSTS.turn_m * turn if turn > 0.0 else 0.0
            if least + count * CELL_M >= best.cost + CELL_M:
                continue
            if not curve_into(curve, first, last, sense):
                continue
            cost = least + curve_cost(curve, first, space, query.sense * sense, best.cost - least)
            if cost < best.cost:
                best = Curve(cost, sense, last[2])
    return best if best.sense != 0 else NO_CURVE


def expansion_poses(expansion: Expansion, query: Query, start: PoseXYYaw) -> Motions:
    """Return the poses of the cheapest direct drive, without its first, and how each is reached."""
    goal, swing, curve = query.goal, expansion.swing, expansion.curve
    if swing.sense != 0:
        poses, motions = _along_curve(start, (goal[0], goal[1], swing.yaw), swing.sense)
        end = float(poses[-1, 0]), float(poses[-1, 1]), float(poses[-1, 2])
        turn = Drive(0.0, last_turn(query, goal[2] - swing.yaw), 0.0, 0.0)
        more, turning = _along_drive(end, goal, turn)
        return np.concatenate([poses, more]), np.concatenate([motions, turning])
    if curve.cost < math.inf:
        return _along_curve(start, goal, curve.sense)
    return _along_drive(start, goal, expansion.drive)


def _along_curve(start: PoseXYYaw, goal: PoseXYYaw, sense: int) -> Motions:
    first, last = np.array(start), np.array(goal)
    last[2] = first[2] + wrapped(last[2] - first[2])
    curve = np.empty((curve_count(first, last), 3))
    curve_into(curve, first, last, sense)
    return curve, np.full(len(curve), sense, dtype=np.int8)


def _along_drive(start: PoseXYYaw, goal: PoseXYYaw, drive: Drive) -> Motions:
    x, y, yaw = start
    end_x, end_y = (goal[0], goal[1]) if drive.length != 0.0 else (x, y)
    counts = [
        math.ceil(abs(drive.first_turn) / TURN_RAD),
        math.ceil(abs(drive.length) / EXPANSION.step_m),
        math.ceil(abs(drive.last_turn) / TURN_RAD),
    ]
    first, along, last = (np.linspace(0.0, 1.0, count + 1)[1:] for count in counts)
    facing = yaw + drive.first_turn
    xs = [np.full(counts[0], x), x + along * (end_x - x), np.full(counts[2], end_x)]
    ys = [np.full(counts[0], y), y + along * (end_y - y), np.full(counts[2], end_y)]
    yaws = [
        yaw + first * drive.first_turn,
        np.full(counts[1], facing),
        facing + last * drive.last_turn,
    ]
    sense = FORWARDS if drive.length > 0.0 else BACKWARDS
    motions = np.repeat(np.array([TURNING, sense, TURNING], dtype=np.int8), counts)
    return np.column_stack([np.concatenate(part) for part in (xs, ys, yaws)]), motions
