"""The search: take the most promising state, try a direct drive, reach for its neighbours."""

import math
from typing import NamedTuple

from trolley.jit import kernel, lean_kernel
from trolley_planner.paths.heap import take_first
from trolley_planner.paths.hybrid_astar.analytic_expansion import expand_to_goal
from trolley_planner.paths.hybrid_astar.footprint_spans import (
    ANGLE_RAD,
    ANGLES,
    HEADINGS,
    PHASES,
    SWING_M,
    TURN_RAD,
    angle_of,
    heading_of,
    yaw_of,
)
from trolley_planner.paths.hybrid_astar.heuristic import Heuristic, Query, place_to_go, to_go
from trolley_planner.paths.hybrid_astar.motion_primitives import (
    AT_START,
    BACKWARDS,
    COSTS,
    FORWARDS,
    TURNING,
    PoseXYYaw,
    change_cost,
)
from trolley_planner.paths.hybrid_astar.open_list import (
    CAME_THERE,
    GOAL_KEY,
    NONE,
    NUM_QUEUED,
    NUM_STATES,
    Memory,
    Reached,
    begin_anew,
    is_reached,
    key_of,
    remember,
    slot_of,
)
from trolley_planner.paths.hybrid_astar.search_space import (
    TRAVERSAL,
    SearchSpace,
    can_turn,
    cost_per_metre,
    fits,
)
from trolley_planner.sensing.beams import wrapped


class SearchParams(NamedTuple):
    """Moves, and when a direct drive is tried; by hand."""

    move_m: float = 0.0375
    """Length of a move: more than the diagonal of a cell, so that each leads into another one."""
    direct_m: float = 1.5
    """Distance to the goal within which a direct drive is tried [m]."""
    direct_every: int = 16
    """Number of such states per one from which it is tried, at first."""
    direct_share: int = 32
    """The more states there were in vain, the rarer: per this share of them."""


SEARCH = SearchParams()
FOUND, NOT_FOUND, FULL = 0, 1, 2
"""How a search ends; a full memory proves nothing."""


@kernel
def search_poses(
    memory: Memory, space: SearchSpace, query: Query, heuristic: Heuristic, most: int
) -> tuple[int, int]:
    """Search from pose to pose; return how it ended, and the last state.

    Args:
        memory: scratch.
        space: where the footprint may be.
        query: from where to where.
        heuristic: what the rest costs.
        most: states that it may reach.
    """
    goal = query.goal
    begin_anew(memory)
    if query.sense == FORWARDS:
        begin(memory, space, query, heuristic)
    else:
        begin_around(memory, space, query, heuristic)
    num_near, next_try = 0, 1
    while memory.counts[NUM_QUEUED] > 0:
        state = take_first(memory.heap, memory.counts[NUM_QUEUED])
        memory.counts[NUM_QUEUED] -= 1
        if memory.closed[state] != 0:
            continue
        memory.closed[state] = 1
        if memory.keys[state] == GOAL_KEY:
            return FOUND, state
        yaw = yaw_of(space.footprint, memory.headings[state])
        away = math.hypot(goal[0] - memory.places[state, 0], goal[1] - memory.places[state, 1])
        is_there = away <= query.xy_m
        memory.counts[CAME_THERE] |= is_there
        is_turned = query.any_heading or abs(wrapped(goal[2] - yaw)) <= query.yaw_rad
        if is_there and is_turned:
            return FOUND, state
        if away < SEARCH.direct_m:
            num_near += 1
            is_due = num_near == next_try
            if is_due:
                next_try += max(SEARCH.direct_every, num_near // SEARCH.direct_share)
            is_due |= away < 2.0 * SEARCH.move_m
            if is_due and not offer_direct_drive(memory, space, query, state):
                return FULL, NONE
        is_full = memory.counts[NUM_STATES] >= most
        if is_full or not expand(memory, space, query, heuristic, state):
            return FULL, NONE
    return NOT_FOUND, NONE


@lean_kernel
def can_arrive(space: SearchSpace, query: Query) -> bool:
    """Say whether the footprint fits at the goal, or anywhere as far as that may be missed.

    Where the robot stands it need not fit.
    """
    (x, y, yaw), fine_m = query.goal, space.footprint.fine_m
    turn = abs(wrapped(query.start[2] - yaw))
    is_turned = query.any_heading or turn <= query.yaw_rad + TURN_RAD
    if is_turned and math.hypot(query.start[0] - x, query.start[1] - y) <= query.xy_m:
        return True
    middle_row, middle_col = math.floor(y / fine_m), math.floor(x / fine_m)
    reach = math.ceil(query.xy_m / fine_m)
    for angle in range(ANGLES):
        off = abs(wrapped(angle * ANGLE_RAD - yaw))
        if not query.any_heading and off > query.yaw_rad + ANGLE_RAD:
            continue
        for row in range(-reach, reach + 1):
            for col in range(-reach, reach + 1):
                place = (middle_col + col + 0.5) * fine_m, (middle_row + row + 0.5) * fine_m
                if cost_per_metre(space, place, angle, FORWARDS) < math.inf:
                    return True
    return False


@lean_kernel
def begin(memory: Memory, space: SearchSpace, query: Query, heuristic: Heuristic) -> None:
    """Begin at the start: it may take either of the headings beside its own.

    Where neither fits, the robot leaves by the nearer one: it stands there after all.
    """
    start, footprint = query.start, space.footprint
    nearest = heading_of(footprint, start[2])
    off = wrapped(start[2] - footprint.first_yaw - nearest * TURN_RAD)
    for which in range(2):
        heading = nearest
        if which == 1:
            heading = (nearest + (1 if off > 0.0 else -1)) % HEADINGS
            if not fits(space, start[:2], angle_of(footprint, heading), space.blocking):
                continue
        turn = abs(wrapped(start[2] - footprint.first_yaw - heading * TURN_RAD))
        cost = COSTS.turn_m * turn
        begin_at(memory, space, query, heuristic, (start[0], start[1], heading), cost)


@lean_kernel
def begin_around(memory: Memory, space: SearchSpace, query: Query, heuristic: Heuristic) -> None:
    """Begin at the end of the path, and around it as far as it may be missed.

    What is missed costs as much as driving beside something: it is worth it where that makes room.
    """
    end, missed_m = query.start, query.begin_m
    heading = heading_of(space.footprint, end[2])
    for which in range(9):
        place = end[:2]
        if which > 0:
            bearing = 0.25 * math.pi * which
            place = end[0] + missed_m * math.cos(bearing), end[1] + missed_m * math.sin(bearing)
        if fits(space, place, angle_of(space.footprint, heading), space.blocking):
            cost = 0.0 if which == 0 else TRAVERSAL.beside * missed_m
            begin_at(memory, space, query, heuristic, (place[0], place[1], heading), cost)


@lean_kernel
def begin_at(
    memory: Memory,
    space: SearchSpace,
    query: Query,
    heuristic: Heuristic,
    state: tuple[float, float, int],
    cost: float,
) -> None:
    """Put a first state into the memory, if its cell and heading are not there yet.

    Args:
        memory: changed in place.
        space: where the footprint may be.
        query: from where to where.
        heuristic: what the rest costs.
        state: x, y, and the index of its heading.
        cost: of it.
    """
    x, y, heading = state
    key = key_of(space, (x, y), heading)
    if memory.counts[NUM_STATES] > 0 and is_reached(memory, slot_of(memory, key)):
        return
    rest = to_go(heuristic, query, (x, y), yaw_of(space.footprint, heading))
    remember(memory, Reached(key, x, y, heading, cost, NONE, AT_START), cost + rest)


@kernel
def offer_direct_drive(memory: Memory, space: SearchSpace, query: Query, state: int) -> bool:
    """Keep the direct drive to the goal if it is cheaper; False if there is no room for it."""
    slot = slot_of(memory, GOAL_KEY)
    cost, motion = memory.costs[state], int(memory.motions[state])
    most = memory.costs[slot] - cost if is_reached(memory, slot) else math.inf
    yaw = yaw_of(space.footprint, memory.headings[state])
    here = float(memory.places[state, 0]), float(memory.places[state, 1]), yaw
    found = expand_to_goal(space, query, here, motion, most)
    least = min(found.drive.cost, min(found.curve.cost, found.swing.cost))
    if least == math.inf:
        return True
    through = cost + least
    reached = Reached(GOAL_KEY, query.goal[0], query.goal[1], 0, through, state, motion)
    return remember(memory, reached, through)


@lean_kernel
def move_from(
    pose: PoseXYYaw, which: int, heading: int, turns_freely: bool, sense: int
) -> tuple[int, int, tuple[float, float]]:
    """Return one move from a state: the motion, the headings it turns by, and where it leads.

    Args:
        pose: of the state.
        which: number of the move: with room to turn one line for each heading, forwards and
            then backwards, as the robot will drive; else turns, lines and arcs.
        heading: index of the state's heading.
        turns_freely: whether there is room to turn.
        sense: of the query.
    """
    if turns_freely:
        motion = sense if which < HEADINGS else -sense
        turn = (which - heading + HEADINGS // 2) % HEADINGS - HEADINGS // 2
        facing = pose[2] + turn * TURN_RAD
    elif which < 2:
        return TURNING, 2 * which - 1, pose[:2]
    else:
        motion = FORWARDS if which < 5 else BACKWARDS
        turn = (which - 2) % 3 - 1
        facing = pose[2] + 0.5 * turn * TURN_RAD
    by = motion * SEARCH.move_m
    return motion, turn, (pose[0] + by * math.cos(facing), pose[1] + by * math.sin(facing))


@lean_kernel
def move_cost(before: int, motion: int, turn: int, turns_freely: bool) -> float:
    """Return what a move of `move_from` costs at least [m]."""
    cost = change_cost(before, motion)
    if motion == TURNING:
        return cost + COSTS.turn_m * TURN_RAD
    if turns_freely:
        cost += COSTS.turn_m * TURN_RAD * abs(turn) + (COSTS.halt_m if turn != 0 else 0.0)
        return cost + SEARCH.move_m
    return cost + SEARCH.move_m + COSTS.arc_m * TURN_RAD * abs(turn)


@lean_kernel
def expand(
    memory: Memory, space: SearchSpace, query: Query, heuristic: Heuristic, state: int
) -> bool:
    """Reach for the neighbours of a state whose cheapest path is known; False if memory is full."""
    heading, before = int(memory.headings[state]), int(memory.motions[state])
    cost = float(memory.costs[state])
    here = float(memory.places[state, 0]), float(memory.places[state, 1])
    yaw = yaw_of(space.footprint, heading)
    turns_freely = can_turn(space, here, 0.0)
    # From room to room every fourth heading will do, and nobody needs to back.
    is_inside = turns_freely and can_turn(space, here, SEARCH.move_m)
    # Half way the corners of a long robot are elsewhere than at both ends.
    is_swung = not turns_freely and space.footprint.circumscribed_m * TURN_RAD > SWING_M
    num_moves = HEADINGS if is_inside else (2 * HEADINGS if turns_freely else 8)
    for which in range(0, num_moves, 4 if is_inside else 1):
        pose = here[0], here[1], yaw
        motion, turn, place = move_from(pose, which, heading, turns_freely, query.sense)
        next_heading = (heading + turn) % HEADINGS
        is_spare = motion * query.sense == BACKWARDS or next_heading % 4 != 0
        if place_to_go(heuristic, place) == math.inf or (
            turns_freely and is_spare and not is_inside and can_turn(space, place, 0.0)
        ):
            continue
        key = key_of(space, place, next_heading)
        slot = slot_of(memory, key)
        is_known = is_reached(memory, slot)
        through = cost + move_cost(before, motion, turn, turns_freely)
        if is_known and (memory.closed[slot] != 0 or memory.costs[slot] <= through):
            continue
        angle = angle_of(space.footprint, next_heading)
        price = cost_per_metre(space, place, angle, query.sense * motion)
        if is_swung and turn != 0 and price < math.inf:
            between = 0.5 * (here[0] + place[0]), 0.5 * (here[1] + place[1])
            angle = (angle - turn * (PHASES // 2)) % ANGLES
            price = max(price, cost_per_metre(space, between, angle, query.sense * motion))
        length = COSTS.turn_m * TURN_RAD
        if motion != TURNING:
            length = SEARCH.move_m + (0.0 if turns_freely else COSTS.arc_m * TURN_RAD * abs(turn))
        through += (price - 1.0) * length
        if price == math.inf or (is_known and memory.costs[slot] <= through):
            continue
        rest = to_go(heuristic, query, place, yaw_of(space.footprint, next_heading))
        reached = Reached(key, place[0], place[1], next_heading, through, state, motion)
        if not remember(memory, reached, through + heuristic.greed * rest):
            return False
    return True
