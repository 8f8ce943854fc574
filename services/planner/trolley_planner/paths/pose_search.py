"""A search over poses with the true footprint: forwards, backwards and on the spot.

Where the footprint matters a path of points will not do: which way the robot looks, and when it
backs, decide whether it gets through. States are a cell, one of 64 headings and, as in hybrid A*,
the exact point at which the cell was reached first, so that straight lines stay straight. Moves are
short lines and arcs, both ways, and turns on the spot. Where there is room for a full turn one
state stands for all headings: in open floor that leaves a search of the place alone. From states
near the goal a direct drive is tried as well: turn, straight line, turn, or one curve.

What the rest of a way costs at least is known well where it is narrow: in cells of 5 cm the
footprint is tried in all headings, so the toll of a door counts from far away. It is searched first
with two fine cells of clearance, then with one, then with none: what is measured errs, and so do
wheels.

The footprint is rasterised at each angle as spans of cells in a row. With counts of what stands
in each row before each column two look-ups say whether a span is free, its inside included.

Source:
    Dolgov, Thrun, Montemerlo, Diebel, Path Planning for Autonomous Vehicles in Unknown
    Semi-structured Environments (2010): exact points in cells, the cost-to-go of the place alone as
    a heuristic, and direct drives to the goal. Deviations: turns on the spot take the place of
    Reeds and Shepp's curves; what headings cost at least is bounded, not looked up in a table.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.jit import kernel
from trolley_planner.costmap.fine_grid import FineGrid
from trolley_planner.costmap.footprint import Footprint
from trolley_planner.costmap.inflation import WEIGHT_UNIT
from trolley_planner.paths.heap import sift_up, take_first
from trolley_planner.paths.search import STEP, UNREACHED, cost_to_go_into, make_queue
from trolley_planner.sensing.beams import inside_polygon, wrapped

HEADINGS = 64
"""Headings of the states."""
TURN_RAD = 2.0 * math.pi / HEADINGS
"""Angle between two headings: 5.6 degrees."""
PHASES = 4
"""The headings of a search begin at one of so many angles, so that one of them is nearly the
goal's."""
ANGLES = PHASES * HEADINGS
"""Angles at which the footprint is checked: poses between two headings, as of curves and of direct
drives, would else be off by a centimetre at its corners."""
ANGLE_RAD = TURN_RAD / PHASES
"""Angle between two of them: 1.4 degrees."""


class PoseSearchParams(NamedTuple):
    """States, moves and their costs; by hand where no source is given."""

    cell_m: float = 0.025
    """Edge of a state's cell."""
    move_m: float = 0.0375
    """Length of a move: more than the diagonal of a cell, so that each leads into another one."""
    near: float = 2.0
    """A metre costs this much more where the footprint has less room than is wanted."""
    beside: float = 6.0
    """this much more where it comes right beside something:"""
    beside_m: float = 0.026
    """nearer than this, two fine cells;"""
    touching: float = 12.0
    """and this much more where it all but touches:"""
    touching_m: float = 0.016
    """nearer than this, one fine cell. So the robot keeps to the middle of a door, and straight."""
    reverse: float = 0.8
    """A metre backwards costs this much more: it is driven at half the speed."""
    turn_m: float = 0.35
    """A turn on the spot by one radian costs as much as this many metres."""
    arc_m: float = 0.1
    """The same for a turn while driving: straight lines are easier to follow."""
    switch_m: float = 0.3
    """So does a change between forwards and backwards,"""
    halt_m: float = 0.2
    """and one between driving and turning."""
    direct_m: float = 1.5
    """A direct drive is tried from states this near to the goal [m],"""
    direct_every: int = 16
    """from one of this many of them."""
    octile: float = 0.9239
    """A straight line is at least this share of the shortest path along 8 directions: cosine of
    22.5 degrees."""
    greed: float = 2.5
    """The rest of the way counts this much: the way found costs at most this much more than the
    cheapest, and is found far sooner;"""
    last_greed: float = 3.0
    """where there is no clearance, this much."""
    heuristic_m: float = 0.05
    """Edge of the cells of the heuristic, about."""
    begin_share: float = 0.7
    """A way that is searched from its end begins this share of what may be missed beside it."""
    exact_m: float = 0.01
    """A way that is searched from its end leads to the robot's own place this exactly,"""
    exact_rad: float = 0.02
    """and to its heading."""
    swings: int = 6
    """Curves to a place where there is room to turn end in so many headings to either side"""
    swing_rad: float = 0.2
    """of the straight line, this much apart."""
    bend_radius_m: float = 0.3
    """Curves that replace pieces of a way are no tighter than this,"""
    bend_states: int = 60
    """and replace at most so many states,"""
    bend_every: int = 3
    """every third of which is tried as their end."""
    creep: float = 4.0
    """A metre backwards, or a turn, over what is out of sight costs this much more: `base` lets the
    robot creep there only, at a fifth of its speed."""
    states: int = 2**18
    """States that can be remembered, a power of two: 24 MB with the heap,"""
    soon: int = 4000
    """A way with more clearance is looked for among this many states,"""
    driving: int = 10000
    """and any way, where the robot waits for it, among this many."""
    fill: float = 0.75
    """this share of which is used before the search ends without an answer."""


SEARCH = PoseSearchParams()
FORWARDS, BACKWARDS, TURNING, AT_START = 1, -1, 0, 2
"""How the robot comes to a pose."""
GOAL_KEY = 2**62
"""Stands for the goal itself, at the end of a direct drive."""
NONE = -1
IN_SIGHT, OUT_OF_SIGHT, NEVER_SEEN = range(3)
"""How floor is known: what was seen free and is out of sight may be backed over, at a creep."""
BLOCKED, NEAR, BESIDE, NEXT_TO, UNSEEN, HIDDEN = range(6)
"""Which cells are counted; see `Room`."""
FOUND, NOT_FOUND, FULL = 0, 1, 2
"""How a search ends; a full memory proves nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class Maneuver:
    """A way with headings.

    Attributes:
        poses: (n, 3) x, y [m], yaw [rad, not wrapped] in `grid`, a little apart.
        motions: (n,) FORWARDS, BACKWARDS or TURNING: how the robot comes to each pose from the
            one before; the first has that of the second.
    """

    poses: NDArray[np.float64]
    motions: NDArray[np.int8]


class Task(NamedTuple):
    """From where to where, in `grid`."""

    x: float
    y: float
    yaw: float
    goal_x: float
    goal_y: float
    goal_yaw: float
    any_heading: bool
    """Whether the goal's heading does not matter."""
    xy_m: float
    """How far the goal's place may be missed."""
    yaw_rad: float
    """How far its heading may be missed."""
    wanted_m: float
    """Clearance from which on nothing costs more."""


class Room(NamedTuple):
    """Where the footprint may be. Places are measured from the corner [m]."""

    blocked: NDArray[np.uint16]
    """(rows, cols + 1) cells in each row, before each column, in which something stands."""
    near: NDArray[np.uint16]
    """(rows, cols + 1) the same of cells that are nearer to something than is wanted."""
    beside: NDArray[np.uint16]
    """(rows, cols + 1) the same of cells right beside something."""
    touching: NDArray[np.uint16]
    """(rows, cols + 1) the same of cells next to something."""
    unknown: NDArray[np.uint16]
    """(rows, cols + 1) the same of cells that the robot must not back into."""
    hidden: NDArray[np.uint16]
    """(rows, cols + 1) the same of cells that it backs and turns into at a creep only."""
    distance_m: NDArray[np.float32]
    """(rows, cols) to the nearest obstacle."""
    to_go_m: NDArray[np.float32]
    """(rows, cols) of larger cells with a rim: cost-to-go of the place alone, +inf where the origin
    may not be."""
    fine_m: float
    """Edge of a cell."""
    coarse_m: float
    """Edge of a larger cell."""
    wanted_m: float
    """Clearance from which on nothing costs more."""
    goal: tuple[float, float, float]
    """x, y, yaw of the goal,"""
    missed_m: float
    """how far it may be missed,"""
    any_heading: bool
    """and whether any heading will do there."""
    greed: float
    """How much the rest of the way counts."""
    begin_m: float
    """How far the end may be missed of a way that is searched from there."""
    sense: int
    """BACKWARDS where the way is searched from its end: the robot drives the other way then."""


class Shape(NamedTuple):
    """The footprint at each angle."""

    spans: NDArray[np.int16]
    """(ANGLES, n, 3) row, first column and the one behind the last, from the origin's cell."""
    num_spans: NDArray[np.int64]
    """(ANGLES,) how many of them count."""
    phase: int
    """Angle of the first heading."""
    first_yaw: float
    """The same [rad]."""
    reach: int
    """Rows on either side of the origin [cells]."""
    circumscribed_m: float


class Memory(NamedTuple):
    """States that were reached: a hash table with open addresses, and a heap of them."""

    stamps: NDArray[np.int32]
    """(states,) number of the search in which the entry was made."""
    keys: NDArray[np.int64]
    """(states,) cell and heading; the first heading where there is room to turn."""
    headings: NDArray[np.int8]
    """(states,) index of the heading with which it was reached."""
    places: NDArray[np.float32]
    """(states, 2) exact place."""
    costs: NDArray[np.float32]
    """(states,) from the start."""
    previous: NDArray[np.int32]
    """(states,) where it was reached from."""
    motions: NDArray[np.int8]
    """(states,) how."""
    closed: NDArray[np.uint8]
    """(states,) whether the cheapest way to it is known."""
    heap: NDArray[np.float64]
    """(entries, 2) estimated cost of the whole way, and the state."""
    counts: NDArray[np.int64]
    """(2,) states reached by the search, and entries of the heap."""


class Reached(NamedTuple):
    """A state, and how it was reached."""

    key: int
    x: float
    y: float
    heading: int
    cost: float
    previous: int
    motion: int


class Drive(NamedTuple):
    """A direct drive to the goal: turn, straight line, turn."""

    cost: float
    """+inf where there is none."""
    first_turn: float
    """[rad]."""
    length: float
    """[m], negative backwards."""
    last_turn: float
    """[rad]."""


class Swing(NamedTuple):
    """A curve to the goal's place, and a turn on the spot there."""

    cost: float
    """+inf where there is none."""
    sense: int
    """FORWARDS or BACKWARDS."""
    yaw: float
    """Heading at the end of the curve [rad]."""


class PoseSearch:
    """Finds ways for one footprint; its memory is made once.

    Args:
        footprint: of the robot.
    """

    def __init__(self, footprint: Footprint) -> None:
        self._footprint = footprint
        self._shapes: dict[float, Shape] = {}
        count = SEARCH.states
        self._memory = Memory(
            np.zeros(count, dtype=np.int32),
            np.empty(count, dtype=np.int64),
            np.empty(count, dtype=np.int8),
            np.empty((count, 2), dtype=np.float32),
            np.empty(count, dtype=np.float32),
            np.empty(count, dtype=np.int32),
            np.empty(count, dtype=np.int8),
            np.empty(count, dtype=np.uint8),
            np.empty((4 * count, 2), dtype=np.float64),
            np.zeros(2, dtype=np.int64),
        )
        self._number = 0
        self.num_states = 0
        """States that the last search reached."""

    def find(
        self,
        grid: FineGrid,
        unseen: NDArray[np.uint8],
        closed: NDArray[np.uint8],
        task: Task,
        most: int = SEARCH.states,
    ) -> Maneuver | None:
        """Return the cheapest way that was found from pose to pose, None if there is none.

        Args:
            grid: what stands around.
            unseen: (rows, cols) of `grid`: IN_SIGHT, OUT_OF_SIGHT or NEVER_SEEN, which the robot
                must not back into.
            closed: (rows, cols) of `grid`, set where its origin must not be.
            task: from where to where; there is no way to or from outside `grid`.
            most: states after which it gives up.
        """
        if not (grid.contains(task.x, task.y) and grid.contains(task.goal_x, task.goal_y)):
            return None
        shape = self._shape(grid.fine_m, task.goal_yaw)
        room, weights = self._room(grid, unseen, closed, task, shape)
        start = task.x - grid.x, task.y - grid.y, task.yaw
        goal = task.goal_x - grid.x, task.goal_y - grid.y, task.goal_yaw
        found = None
        if not task.any_heading and _is_tighter_at_end(room, shape, start, goal):
            back = task._replace(xy_m=SEARCH.exact_m, yaw_rad=SEARCH.exact_rad)
            turned = room._replace(begin_m=SEARCH.begin_share * task.xy_m, sense=BACKWARDS)
            found = self._way(turned, weights, shape, (goal, start), back, most)
        if found is None:
            found = self._way(room, weights, shape, (start, goal), task, most)
        if found is None:
            return None
        poses, motions = found
        poses[0] = start  # Which lies between two headings; the search begins at one.
        poses[:, 2] = np.unwrap(poses[:, 2])
        poses, motions = _smoothed(poses, motions, room, shape)
        motions[0] = motions[1] if len(motions) > 1 else TURNING
        poses[:, :2] += (grid.x, grid.y)
        return Maneuver(poses, motions)

    def _way(
        self,
        room: Room,
        weights: NDArray[np.uint8],
        shape: Shape,
        ends: tuple[tuple[float, float, float], tuple[float, float, float]],
        task: Task,
        most: int,
    ) -> tuple[NDArray[np.float64], NDArray[np.int8]] | None:
        """Return a way's poses (n, 3) from the corner, and how each is reached."""
        goal = ends[1]
        room, last = self._search(room, weights, shape, ends, task, most)
        if last == NONE:
            return None
        poses, motions = _traced(self._memory, last, shape)
        if int(self._memory.keys[last]) == GOAL_KEY:
            state = float(poses[-1, 0]), float(poses[-1, 1]), float(poses[-1, 2])
            before = int(motions[-1])
            drive = direct_drive(room, shape, (state, goal), task, before, math.inf)
            cost, sense = direct_bend(room, shape, (state, goal), task, before, drive.cost)
            least = min(drive.cost, cost)
            swing = Swing(math.inf, 0, 0.0)
            if can_turn(room, shape, goal[:2], 0.0):
                swing = direct_swing(room, shape, (state, goal), task, before, least)
            if swing.sense != 0:
                more, kinds = _swung(state, goal, swing, task)
            elif cost < math.inf:
                more, kinds = _bent(state, goal, sense)
            else:
                more, kinds = _driven(state, goal, drive)
            poses, motions = np.concatenate([poses, more]), np.concatenate([motions, kinds])
        if room.sense == FORWARDS:
            return poses, motions
        return poses[::-1].copy(), np.roll(-motions[::-1], 1)

    def _search(
        self,
        room: Room,
        weights: NDArray[np.uint8],
        shape: Shape,
        ends: tuple[tuple[float, float, float], tuple[float, float, float]],
        task: Task,
        most: int,
    ) -> tuple[Room, int]:
        """Search with as much clearance as a way is soon found with, in the end with none.

        Returns:
            The room with what then counts as blocked; the last state, NONE if there is no way.
        """
        self.num_states = 0
        begin, goal = ends
        start_cell, goal_cell = _coarse_cell(room, begin), _coarse_cell(room, goal)
        room = room._replace(goal=goal, missed_m=task.xy_m, any_heading=task.any_heading)
        weights = weights.copy()
        weights[goal_cell] = WEIGHT_UNIT
        dearest = 1.0 + SEARCH.near
        for blocked in (room.beside, room.touching):
            dearest_weight = round(dearest * WEIGHT_UNIT)
            dearest += SEARCH.beside
            # The robot stands where it starts; at its goal it must fit.
            fits = is_free(blocked, shape, room.fine_m, goal[:2], nearest_angle(goal[2]))
            if not (task.any_heading or room.sense == BACKWARDS or fits):
                continue
            passable = np.where(weights <= dearest_weight, weights, np.uint8(0))
            to_go_m = _to_go(passable, goal_cell, room.coarse_m)
            if not math.isfinite(to_go_m[start_cell]):
                continue
            roomy = room._replace(blocked=blocked, to_go_m=to_go_m, greed=SEARCH.greed)
            found, last = self._search_once(roomy, shape, ends, task, SEARCH.soon)
            if found == FOUND:
                return roomy, last
        room = room._replace(to_go_m=_to_go(weights, goal_cell, room.coarse_m))
        found, last = self._search_once(room, shape, ends, task, most)
        return room, last if found == FOUND else NONE

    def _search_once(
        self,
        room: Room,
        shape: Shape,
        ends: tuple[tuple[float, float, float], tuple[float, float, float]],
        task: Task,
        most: int,
    ) -> tuple[int, int]:
        """Search in a room, reaching so many states at most; return how it ended, and the last."""
        self._number += 1
        most = min(most, int(SEARCH.fill * self._memory.keys.shape[0]))
        found = search_poses(self._memory, self._number, room, shape, ends, task, most)
        self.num_states += int(self._memory.counts[0])
        return found

    def _shape(self, fine_m: float, yaw: float) -> Shape:
        """Return the footprint for headings one of which is nearly this one."""
        if fine_m not in self._shapes:
            self._shapes[fine_m] = rasterised(self._footprint, fine_m)
        phase = round(yaw / ANGLE_RAD) % PHASES
        return self._shapes[fine_m]._replace(phase=phase, first_yaw=phase * ANGLE_RAD)

    def _room(
        self,
        grid: FineGrid,
        unseen: NDArray[np.uint8],
        closed: NDArray[np.uint8],
        task: Task,
        shape: Shape,
    ) -> tuple[Room, NDArray[np.uint8]]:
        """Return the look-ups of a search, and what a metre costs in the larger cells."""
        fine_rows, fine_cols = grid.mask.shape
        own = Pose2D(task.x - grid.x, task.y - grid.y, task.yaw)
        outline = own.transform_points(self._footprint.polygon) / grid.fine_m
        counts = np.empty((6, fine_rows, fine_cols + 1), dtype=np.uint16)
        count_into(counts, (grid.mask, grid.distance_m, unseen), outline, task.wanted_m)
        group = max(1, round(SEARCH.heuristic_m / grid.fine_m))
        edge = group * grid.fine_m
        rows, cols = -(-fine_rows // group) + 2, -(-fine_cols // group) + 2
        weights = np.zeros((rows, cols), dtype=np.uint8)
        radii = self._footprint.inscribed_m, self._footprint.circumscribed_m, task.wanted_m
        parity = heading_of(shape, task.goal_yaw) % 2
        cells = group, grid.fine_m
        weigh_into(weights, counts, shape, grid.distance_m, closed, radii, cells, parity)
        return Room(
            counts[BLOCKED],
            counts[NEAR],
            counts[BESIDE],
            counts[NEXT_TO],
            counts[UNSEEN],
            counts[HIDDEN],
            grid.distance_m,
            np.zeros((0, 0), dtype=np.float32),
            grid.fine_m,
            edge,
            task.wanted_m,
            (0.0, 0.0, 0.0),
            0.0,
            False,
            SEARCH.last_greed,
            0.0,
            FORWARDS,
        ), weights


def _is_tighter_at_end(
    room: Room,
    shape: Shape,
    start: tuple[float, float, float],
    goal: tuple[float, float, float],
) -> bool:
    """Say whether there is room to turn at the start of a way, and none at its end."""
    return can_turn(room, shape, start[:2], 0.0) and not can_turn(room, shape, goal[:2], 0.0)


def _coarse_cell(room: Room, place: tuple[float, float, float]) -> tuple[int, int]:
    """Return row and column of a place among the larger cells."""
    x, y = place[0], place[1]
    return math.floor(y / room.coarse_m) + 1, math.floor(x / room.coarse_m) + 1


def _to_go(weights: NDArray[np.uint8], goal: tuple[int, int], edge_m: float) -> NDArray[np.float32]:
    """Return the cost-to-go [m] (rows, cols) of the place alone to a cell, row and column."""
    rows, cols = weights.shape
    costs = np.empty(rows * cols, dtype=np.int32)
    seeds = np.array([[goal[0] * cols + goal[1], 0]], dtype=np.int32)
    flat, queue = weights.reshape(-1), make_queue(rows * cols)
    cost_to_go_into(costs, flat, queue, seeds, cols, (-1, 0), 8)
    metres = SEARCH.octile * edge_m / (2 * STEP * WEIGHT_UNIT)
    to_go_m = np.where(costs == UNREACHED, np.inf, metres * costs).astype(np.float32)
    return to_go_m.reshape(rows, cols)


def rasterised(footprint: Footprint, fine_m: float) -> Shape:
    """Return the footprint as spans of the cells that it touches.

    Args:
        footprint: of the robot.
        fine_m: edge of a cell.
    """
    reach = math.ceil(footprint.circumscribed_m / fine_m) + 1
    # A line meets a polygon of n corners in n / 2 spans at most.
    most = (2 * reach + 1) * (len(footprint.polygon) // 2)
    spans = np.zeros((ANGLES, most, 3), dtype=np.int16)
    num_spans = np.zeros(ANGLES, dtype=np.int64)
    rasterise_into(spans, num_spans, footprint.polygon / fine_m, reach)
    return Shape(spans, num_spans, 0, 0.0, reach, footprint.circumscribed_m)


def _traced(
    memory: Memory, last: int, shape: Shape
) -> tuple[NDArray[np.float64], NDArray[np.int8]]:
    """Return the poses (n, 3) of the states that led to the last, and how each was reached."""
    states: list[int] = []
    state = last if int(memory.keys[last]) != GOAL_KEY else int(memory.previous[last])
    while state != NONE:
        states.append(state)
        state = int(memory.previous[state])
    chosen = np.array(states[::-1], dtype=np.int64)
    headings = memory.headings[chosen].astype(np.int64)
    yaws = np.unwrap(shape.first_yaw + headings * TURN_RAD)
    poses = np.empty((len(chosen), 3))
    poses[:, :2], poses[:, 2] = memory.places[chosen], yaws
    motions = memory.motions[chosen]
    # Where there is room, a state is reached by a turn of any size and a line.
    parts, kinds = [poses[:1]], [motions[:1]]
    for index in range(1, len(poses)):
        turn = float(poses[index, 2] - poses[index - 1, 2])
        count = round(abs(turn) / TURN_RAD)
        if count > 1:
            turned = np.repeat(poses[index - 1 : index], count, axis=0)
            turned[:, 2] += turn * np.arange(1, count + 1) / count
            parts.append(turned)
            kinds.append(np.full(count, TURNING, dtype=np.int8))
        parts.append(poses[index : index + 1])
        kinds.append(motions[index : index + 1])
    return np.concatenate(parts), np.concatenate(kinds)


def _driven(
    state: tuple[float, float, float], goal: tuple[float, float, float], drive: Drive
) -> tuple[NDArray[np.float64], NDArray[np.int8]]:
    """Return the poses (n, 3) of a direct drive, without its first, and how each is reached."""
    x, y, yaw = state
    end_x, end_y = (goal[0], goal[1]) if drive.length != 0.0 else (x, y)
    counts = [
        math.ceil(abs(drive.first_turn) / TURN_RAD),
        math.ceil(abs(drive.length) / SEARCH.move_m),
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


def _bent(
    state: tuple[float, float, float], goal: tuple[float, float, float], sense: int
) -> tuple[NDArray[np.float64], NDArray[np.int8]]:
    """Return the poses (n, 3) of a curve to the goal without its first, and how each is reached."""
    first, last = np.array(state), np.array(goal)
    last[2] = first[2] + wrapped(last[2] - first[2])
    curve = np.empty((bend_count(first, last), 3))
    bend_into(curve, first, last, sense)
    return curve, np.full(len(curve), sense, dtype=np.int8)


def _swung(
    state: tuple[float, float, float],
    goal: tuple[float, float, float],
    swing: Swing,
    task: Task,
) -> tuple[NDArray[np.float64], NDArray[np.int8]]:
    """Return the poses (n, 3) of a curve and a turn to the goal, and how each is reached."""
    curve, kinds = _bent(state, (goal[0], goal[1], swing.yaw), swing.sense)
    end = float(curve[-1, 0]), float(curve[-1, 1]), float(curve[-1, 2])
    turn = Drive(0.0, last_turn(task, goal[2] - swing.yaw), 0.0, 0.0)
    more, turning = _driven(end, goal, turn)
    return np.concatenate([curve, more]), np.concatenate([kinds, turning])


def _smoothed(
    poses: NDArray[np.float64], motions: NDArray[np.int8], room: Room, shape: Shape
) -> tuple[NDArray[np.float64], NDArray[np.int8]]:
    """Return a way with curves in place of lines and turns where they are free and cost less."""
    costs = np.empty(len(poses))
    way_costs_into(costs, poses, motions, room, shape)
    parts, kinds = [poses[:1]], [motions[:1]]
    at = 0
    while at < len(poses) - 1:
        end, sense = longest_bend(poses, costs, at, room, shape)
        if end == at + 1:
            parts.append(poses[end : end + 1])
            kinds.append(motions[end : end + 1])
        else:
            count = bend_count(poses[at], poses[end])
            curve = np.empty((count, 3))
            bend_into(curve, poses[at], poses[end], sense)
            parts.append(curve)
            kinds.append(np.full(count, sense, dtype=np.int8))
        at = end
    return np.concatenate(parts), np.concatenate(kinds)


@kernel
def way_costs_into(
    out_costs: NDArray[np.float64],
    poses: NDArray[np.float64],
    motions: NDArray[np.int8],
    room: Room,
    shape: Shape,
) -> None:
    """Write what the way to each of its poses (n, 3) costs [m], from the first on."""
    out_costs[0] = 0.0
    for index in range(1, poses.shape[0]):
        motion, before = int(motions[index]), int(motions[index - 1])
        turn = abs(poses[index, 2] - poses[index - 1, 2])
        dx, dy = poses[index, 0] - poses[index - 1, 0], poses[index, 1] - poses[index - 1, 1]
        length = SEARCH.turn_m * turn
        if motion != TURNING:
            length = math.hypot(dx, dy) + SEARCH.arc_m * turn
        place = poses[index, 0], poses[index, 1]
        price = price_of(room, shape, place, nearest_angle(poses[index, 2]), motion)
        # The way is free; beside the search's headings it may look otherwise.
        most = 1.0 + SEARCH.near + SEARCH.beside + SEARCH.touching + SEARCH.reverse + SEARCH.creep
        price = min(price, most)
        change = 0.0 if index == 1 else change_cost(before, motion)
        out_costs[index] = out_costs[index - 1] + price * length + change


@kernel
def bend_count(first: NDArray[np.float64], last: NDArray[np.float64]) -> int:
    """Return into how many pieces a curve between two poses is divided."""
    return max(1, math.ceil(math.hypot(last[0] - first[0], last[1] - first[1]) / SEARCH.cell_m))


@kernel
def bend_into(
    out_poses: NDArray[np.float64],
    first: NDArray[np.float64],
    last: NDArray[np.float64],
    sense: int,
) -> float:
    """Write poses (n, 3) along a cubic curve between two poses, without the first.

    Returns:
        Its largest curvature [1/m], +inf where it has a cusp.
    """
    count = out_poses.shape[0]
    reach = math.hypot(last[0] - first[0], last[1] - first[1]) * sense
    ax, ay = reach * math.cos(first[2]), reach * math.sin(first[2])
    bx, by = reach * math.cos(last[2]), reach * math.sin(last[2])
    yaw, x, y, worst = first[2], first[0], first[1], 0.0
    for index in range(count):
        t = (index + 1) / count
        # Hermite's basis, and its derivative.
        h0, h1 = (1.0 + 2.0 * t) * (1.0 - t) ** 2, t * (1.0 - t) ** 2
        h2, h3 = t * t * (3.0 - 2.0 * t), t * t * (t - 1.0)
        to_x = h0 * first[0] + h1 * ax + h2 * last[0] + h3 * bx
        to_y = h0 * first[1] + h1 * ay + h2 * last[1] + h3 * by
        d0, d1, d3 = 6.0 * t * (t - 1.0), (1.0 - t) * (1.0 - 3.0 * t), t * (3.0 * t - 2.0)
        dx = d0 * (first[0] - last[0]) + d1 * ax + d3 * bx
        dy = d0 * (first[1] - last[1]) + d1 * ay + d3 * by
        turn = wrapped(math.atan2(sense * dy, sense * dx) - yaw)
        length = math.hypot(to_x - x, to_y - y)
        if length < 1e-6:
            return math.inf
        worst = max(worst, abs(turn) / length)
        yaw, x, y = yaw + turn, to_x, to_y
        out_poses[index, 0], out_poses[index, 1], out_poses[index, 2] = x, y, yaw
    return worst if abs(yaw - last[2]) < 0.01 else math.inf


@kernel
def bend_cost(
    curve: NDArray[np.float64],
    first: NDArray[np.float64],
    sense: int,
    room: Room,
    shape: Shape,
    most: float,
) -> float:
    """Return what a curve (n, 3) from a pose costs [m], +inf if that is not less than `most`."""
    total = 0.0
    x, y, yaw = first[0], first[1], first[2]
    for index in range(curve.shape[0]):
        place, angle = (curve[index, 0], curve[index, 1]), nearest_angle(curve[index, 2])
        length = math.hypot(place[0] - x, place[1] - y)
        turn = abs(curve[index, 2] - yaw)
        total += price_of(room, shape, place, angle, sense) * (length + SEARCH.arc_m * turn)
        x, y, yaw = curve[index, 0], curve[index, 1], curve[index, 2]
        if total >= most:
            return math.inf
    return total


@kernel
def longest_bend(
    poses: NDArray[np.float64],
    costs: NDArray[np.float64],
    first: int,
    room: Room,
    shape: Shape,
) -> tuple[int, int]:
    """Return the farthest state to which a curve is free and costs no more, and its sense.

    The state after `first` and 0 where there is none.
    """
    curve = np.empty((int(SEARCH.bend_states * 2), 3))
    farthest = min(first + SEARCH.bend_states, poses.shape[0] - 1)
    for end in range(farthest, first + 1, -SEARCH.bend_every):
        dx, dy = poses[end, 0] - poses[first, 0], poses[end, 1] - poses[first, 1]
        ahead = dx * math.cos(poses[first, 2]) + dy * math.sin(poses[first, 2])
        sense = FORWARDS if ahead > 0.0 else BACKWARDS
        count = bend_count(poses[first], poses[end])
        if count < 2 or count > curve.shape[0]:
            continue
        if bend_into(curve[:count], poses[first], poses[end], sense) > 1.0 / SEARCH.bend_radius_m:
            continue
        most = costs[end] - costs[first] + 1e-9
        if bend_cost(curve[:count], poses[first], sense, room, shape, most) < most:
            return end, sense
    return first + 1, TURNING


@kernel
def rasterise_into(
    out_spans: NDArray[np.int16],
    out_num: NDArray[np.int64],
    polygon: NDArray[np.float64],
    reach: int,
) -> None:
    """Write the spans of cells that an outline covers or nearly touches, at each angle.

    A cell counts if its centre is inside, or within half a cell of an edge.

    Args:
        out_spans: (ANGLES, n, 3), overwritten; see `Shape`.
        out_num: (ANGLES,), overwritten.
        polygon: (m, 2) corners [cells].
        reach: rows on either side of the origin.
    """
    turned = np.empty_like(polygon)
    for angle in range(ANGLES):
        yaw = angle * ANGLE_RAD
        cos, sin = math.cos(yaw), math.sin(yaw)
        for corner in range(polygon.shape[0]):
            x, y = polygon[corner, 0], polygon[corner, 1]
            turned[corner, 0], turned[corner, 1] = cos * x - sin * y, sin * x + cos * y
        count = 0
        for row in range(-reach, reach + 1):
            first = reach + 1
            for col in range(-reach, reach + 2):
                is_covered = col <= reach and (
                    inside_polygon(turned, col, row) or is_near_edge(turned, col, row, 0.5)
                )
                if is_covered and first > reach:
                    first = col
                elif not is_covered and first <= reach:
                    out_spans[angle, count, 0] = row
                    out_spans[angle, count, 1] = first
                    out_spans[angle, count, 2] = col
                    count += 1
                    first = reach + 1
        out_num[angle] = count


@kernel
def is_near_edge(polygon: NDArray[np.float64], x: float, y: float, within: float) -> bool:
    """Say whether a point is nearer than `within` to an edge of a polygon (n, 2)."""
    for index in range(polygon.shape[0]):
        ax, ay = polygon[index - 1, 0], polygon[index - 1, 1]
        dx, dy = polygon[index, 0] - ax, polygon[index, 1] - ay
        share = ((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy)
        share = min(max(share, 0.0), 1.0)
        if math.hypot(ax + share * dx - x, ay + share * dy - y) < within:
            return True
    return False


@kernel
def count_into(
    out_counts: NDArray[np.uint16],
    layers: tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.uint8]],
    outline: NDArray[np.float64],
    wanted_m: float,
) -> None:
    """Write how many cells of each row, before each column, are of each kind.

    Args:
        out_counts: (6, rows, cols + 1), overwritten; see `Room`.
        layers: (rows, cols) each: set where something stands; distance to the nearest of that; how
            it is known.
        outline: (n, 2) of the robot [cells]: nothing stands where it is.
        wanted_m: cells nearer than this are near.
    """
    mask, distance_m, known = layers
    rows, cols = mask.shape
    for row in range(rows):
        blocked, near, beside = np.uint16(0), np.uint16(0), np.uint16(0)
        next_to, unseen, hidden = np.uint16(0), np.uint16(0), np.uint16(0)
        for col in range(cols):
            out_counts[BLOCKED, row, col], out_counts[NEAR, row, col] = blocked, near
            out_counts[BESIDE, row, col], out_counts[NEXT_TO, row, col] = beside, next_to
            out_counts[UNSEEN, row, col], out_counts[HIDDEN, row, col] = unseen, hidden
            away = distance_m[row, col]
            blocked += np.uint16(mask[row, col] != 0)
            near += np.uint16(away < wanted_m)
            beside += np.uint16(away < SEARCH.beside_m)
            next_to += np.uint16(away < SEARCH.touching_m)
            unseen += np.uint16(known[row, col] == NEVER_SEEN)
            hidden += np.uint16(known[row, col] != IN_SIGHT and mask[row, col] == 0)
        out_counts[BLOCKED, row, cols], out_counts[NEAR, row, cols] = blocked, near
        out_counts[BESIDE, row, cols], out_counts[NEXT_TO, row, cols] = beside, next_to
        out_counts[UNSEEN, row, cols], out_counts[HIDDEN, row, cols] = unseen, hidden
    first_row = max(math.floor(outline[:, 1].min()) - 1, 0)
    first_col = max(math.floor(outline[:, 0].min()) - 1, 0)
    last_col = min(math.ceil(outline[:, 0].max()) + 1, cols)
    for row in range(first_row, min(math.ceil(outline[:, 1].max()) + 1, rows)):
        taken = np.uint16(0)
        for col in range(first_col, cols):
            stands = mask[row, col] != 0 and col < last_col
            x, y = col + 0.5, row + 0.5
            if stands and (inside_polygon(outline, x, y) or is_near_edge(outline, x, y, 1.0)):
                taken += np.uint16(1)
            out_counts[BLOCKED, row, col + 1] -= taken


@kernel
def weigh_into(
    out_weights: NDArray[np.uint8],
    counts: NDArray[np.uint16],
    shape: Shape,
    distance_m: NDArray[np.float32],
    closed: NDArray[np.uint8],
    radii: tuple[float, float, float],
    cells: tuple[int, float],
    parity: int,
) -> None:
    """Write what a metre costs about at least in larger cells, whatever the heading.

    Args:
        out_weights: (rows, cols) with a rim of one cell, zero before: the origin must not be there.
        counts: (6, fine rows, fine cols + 1) see `Room`.
        shape: the footprint.
        distance_m: (fine rows, fine cols).
        closed: (fine rows, fine cols) set where the origin must not be.
        radii: the footprint's inscribed and circumscribed one; the clearance that is wanted [m].
        cells: fine ones in the edge of a larger one; edge of a fine one [m].
        parity: the headings that are tried are even, 0, or odd, 1.
    """
    inscribed_m, circumscribed_m, wanted_m = radii
    group, fine_m = cells
    rows, cols = distance_m.shape
    kinds = (NEAR, BESIDE, NEXT_TO)
    needed_m = (wanted_m, SEARCH.beside_m, SEARCH.touching_m)
    more = (SEARCH.near, SEARCH.beside, SEARCH.touching)
    for row in range(out_weights.shape[0] - 2):
        for col in range(out_weights.shape[1] - 2):
            best_row, best_col, farthest = 0, 0, np.float32(-1.0)
            for fine_row in range(row * group, min((row + 1) * group, rows)):
                for fine_col in range(col * group, min((col + 1) * group, cols)):
                    away = distance_m[fine_row, fine_col]
                    if away > farthest and closed[fine_row, fine_col] == 0:
                        best_row, best_col, farthest = fine_row, fine_col, away
            # Between centres of cells: what stands, and the origin, may be half a cell nearer.
            if farthest < inscribed_m:
                continue
            place = (best_col + 0.5) * fine_m, (best_row + 0.5) * fine_m
            price = 1.0
            for level in range(len(kinds)):
                if farthest > circumscribed_m + needed_m[level] or (
                    farthest >= inscribed_m + needed_m[level]
                    and fits_somehow(counts[kinds[level]], shape, fine_m, place, parity)
                ):
                    break
                price += more[level]
            out_weights[row + 1, col + 1] = int(price * WEIGHT_UNIT)


@kernel
def fits_somehow(
    counts: NDArray[np.uint16],
    shape: Shape,
    fine_m: float,
    place: tuple[float, float],
    parity: int,
) -> bool:
    """Say whether the footprint covers no counted cell at a place in one of every other heading."""
    for heading in range(parity, HEADINGS, 2):
        if is_free(counts, shape, fine_m, place, angle_of(shape, heading)):
            return True
    return False


@kernel
def is_free(
    counts: NDArray[np.uint16],
    shape: Shape,
    fine_m: float,
    place: tuple[float, float],
    angle: int,
) -> bool:
    """Say whether the footprint covers no counted cell, and none outside.

    Args:
        counts: (rows, cols + 1) see `Room`.
        shape: the footprint.
        fine_m: edge of a cell.
        place: x, y from the corner [m].
        angle: index.
    """
    rows, cols = counts.shape[0], counts.shape[1] - 1
    row, col = math.floor(place[1] / fine_m), math.floor(place[0] / fine_m)
    reach = shape.reach
    if row < reach or col < reach or row >= rows - reach or col >= cols - reach:
        return False
    for index in range(shape.num_spans[angle]):
        at = row + shape.spans[angle, index, 0]
        first, end = shape.spans[angle, index, 1], shape.spans[angle, index, 2]
        if counts[at, col + end] != counts[at, col + first]:
            return False
    return True


@kernel
def heading_of(shape: Shape, yaw: float) -> int:
    """Return the heading nearest to a direction [rad]."""
    return math.floor((yaw - shape.first_yaw) / TURN_RAD + 0.5) % HEADINGS


@kernel
def angle_of(shape: Shape, heading: int) -> int:
    """Return the angle of a heading."""
    return heading * PHASES + shape.phase


@kernel
def nearest_angle(yaw: float) -> int:
    """Return the angle nearest to a direction [rad]."""
    return math.floor(yaw / ANGLE_RAD + 0.5) % ANGLES


@kernel
def price_of(
    room: Room, shape: Shape, place: tuple[float, float], angle: int, motion: int
) -> float:
    """Return what a metre to a pose costs, +inf if the footprint must not come there.

    Args:
        room: where it is.
        shape: the footprint.
        place: x, y from the corner [m].
        angle: index.
        motion: how it comes there; TURNING: what a metre of its outline's way would cost.
    """
    has_room = can_turn(room, shape, place, 0.0)
    backs = motion * room.sense == BACKWARDS
    if has_room and motion * room.sense == FORWARDS:
        return 1.0
    if not has_room and not is_free(room.blocked, shape, room.fine_m, place, angle):
        return math.inf
    price = 1.0
    if backs:
        if not is_free(room.unknown, shape, room.fine_m, place, angle):
            return math.inf
        price += SEARCH.reverse
    if motion != FORWARDS * room.sense and not is_free(
        room.hidden, shape, room.fine_m, place, angle
    ):
        price += SEARCH.creep
    if not has_room and not is_free(room.near, shape, room.fine_m, place, angle):
        price += SEARCH.near
        if not is_free(room.beside, shape, room.fine_m, place, angle):
            price += SEARCH.beside
            if not is_free(room.touching, shape, room.fine_m, place, angle):
                price += SEARCH.touching
    return price


@kernel
def change_cost(before: int, motion: int) -> float:
    """Return what the change from one motion to another costs [m]."""
    if before == AT_START:
        return 0.0
    if before == motion:
        return 0.0
    return SEARCH.halt_m if before == TURNING or motion == TURNING else SEARCH.switch_m


@kernel
def turn_cost(
    room: Room, shape: Shape, place: tuple[float, float], yaw: float, turn: float
) -> float:
    """Return what a turn on the spot by an angle costs [m], +inf if something is in the way."""
    count = math.ceil(abs(turn) / TURN_RAD)
    total = 0.0
    for index in range(1, count + 1):
        angle = nearest_angle(yaw + turn * index / count)
        price = price_of(room, shape, place, angle, TURNING)
        if price == math.inf:
            return math.inf
        total += price * SEARCH.turn_m * abs(turn) / count
    return total


@kernel
def cheaper_turn(
    room: Room, shape: Shape, place: tuple[float, float], yaw: float, turn: float
) -> tuple[float, float]:
    """Return cost and angle of a turn to a heading: the shorter way around if that is free."""
    cost = turn_cost(room, shape, place, yaw, turn)
    if cost < math.inf:
        return cost, turn
    longer = turn - math.copysign(2.0 * math.pi, turn)
    return turn_cost(room, shape, place, yaw, longer), longer


@kernel
def last_turn(task: Task, turn: float) -> float:
    """Return by how much to turn at the goal, to half of what may be missed [rad]."""
    turn = wrapped(turn)
    if task.any_heading or abs(turn) <= task.yaw_rad:
        return 0.0
    return turn - math.copysign(0.5 * task.yaw_rad, turn)


@kernel
def direct_drive(
    room: Room,
    shape: Shape,
    ends: tuple[tuple[float, float, float], tuple[float, float, float]],
    task: Task,
    before: int,
    most: float,
) -> Drive:
    """Return the cheapest direct drive between two poses.

    Args:
        room: where it is.
        shape: the footprint.
        ends: x, y, yaw of start and goal, from the corner.
        task: says whether the goal's heading matters.
        before: how the robot came to the start.
        most: it must cost less than this [m].
    """
    (x, y, yaw), (goal_x, goal_y, goal_yaw) = ends
    length = math.hypot(goal_x - x, goal_y - y)
    best = Drive(most, 0.0, 0.0, 0.0)
    if length <= task.xy_m:
        cost, turn = cheaper_turn(room, shape, (x, y), yaw, last_turn(task, goal_yaw - yaw))
        cost += change_cost(before, TURNING)
        return Drive(cost if cost < most else math.inf, 0.0, 0.0, turn)
    bearing = math.atan2(goal_y - y, goal_x - x)
    count = math.ceil(length / SEARCH.move_m)
    for motion in (FORWARDS, BACKWARDS):
        facing = bearing if motion == FORWARDS else bearing + math.pi
        angle = nearest_angle(facing)
        turns = abs(wrapped(facing - yaw))
        turns += abs(last_turn(task, goal_yaw - facing))
        if length + SEARCH.turn_m * turns >= best.cost:
            continue
        cost = 0.0
        for index in range(1, count + 1):
            share = index / count
            place = x + share * (goal_x - x), y + share * (goal_y - y)
            cost += price_of(room, shape, place, angle, motion) * length / count
            if cost >= best.cost:
                break
        if cost >= best.cost:
            continue
        price, first = cheaper_turn(room, shape, (x, y), yaw, wrapped(facing - yaw))
        cost += price + change_cost(before, motion if abs(first) < 0.01 else TURNING)
        cost += SEARCH.halt_m if abs(first) >= 0.01 else 0.0
        last = last_turn(task, goal_yaw - facing)
        if last != 0.0:
            price, last = cheaper_turn(room, shape, (goal_x, goal_y), facing, last)
            cost += price + SEARCH.halt_m
        if cost < best.cost:
            best = Drive(cost, first, length * motion, last)
    return best if best.length != 0.0 else Drive(math.inf, 0.0, 0.0, 0.0)


@kernel
def direct_bend(
    room: Room,
    shape: Shape,
    ends: tuple[tuple[float, float, float], tuple[float, float, float]],
    task: Task,
    before: int,
    most: float,
) -> tuple[float, int]:
    """Return what a curve between two poses costs [m], +inf if there is none, and its sense.

    Args:
        room: where it is.
        shape: the footprint.
        ends: x, y, yaw of start and goal, from the corner.
        task: says whether the goal's heading matters.
        before: how the robot came to the start.
        most: it must cost less than this [m].
    """
    first, last = np.array(ends[0]), np.array(ends[1])
    last[2] = first[2] + wrapped(last[2] - first[2])
    ahead = (last[0] - first[0]) * math.cos(first[2]) + (last[1] - first[1]) * math.sin(first[2])
    sense = FORWARDS if ahead > 0.0 else BACKWARDS
    count = bend_count(first, last)
    most -= change_cost(before, sense)
    if task.any_heading or count < 2 or count * SEARCH.cell_m > most + SEARCH.cell_m:
        return math.inf, sense
    curve = np.empty((count, 3))
    if bend_into(curve, first, last, sense) > 1.0 / SEARCH.bend_radius_m:
        return math.inf, sense
    cost = bend_cost(curve, first, sense, room, shape, most)
    return cost + change_cost(before, sense), sense


@kernel
def direct_swing(
    room: Room,
    shape: Shape,
    ends: tuple[tuple[float, float, float], tuple[float, float, float]],
    task: Task,
    before: int,
    most: float,
) -> Swing:
    """Return the cheapest curve to a place with a turn on the spot at its end.

    Args:
        room: where it is.
        shape: the footprint.
        ends: x, y, yaw of start and goal, from the corner; at the goal there is room to turn.
        task: says whether the goal's heading matters.
        before: how the robot came to the start.
        most: it must cost less than this [m].
    """
    first, last = np.array(ends[0]), np.array(ends[1])
    best = Swing(most, 0, 0.0)
    count = bend_count(first, last)
    if count < 2:
        return Swing(math.inf, 0, 0.0)
    bearing = math.atan2(last[1] - first[1], last[0] - first[0])
    curve = np.empty((count, 3))
    for sense in (FORWARDS, BACKWARDS):
        facing = bearing if sense == FORWARDS else bearing + math.pi
        for which in range(-SEARCH.swings, SEARCH.swings + 1):
            last[2] = first[2] + wrapped(facing + which * SEARCH.swing_rad - first[2])
            turn = abs(last_turn(task, ends[1][2] - last[2]))
            least = change_cost(before, sense)
            least += SEARCH.halt_m + SEARCH.turn_m * turn if turn > 0.0 else 0.0
            if least + count * SEARCH.cell_m >= best.cost + SEARCH.cell_m:
                continue
            if bend_into(curve, first, last, sense) > 1.0 / SEARCH.bend_radius_m:
                continue
            cost = least + bend_cost(curve, first, sense, room, shape, best.cost - least)
            if cost < best.cost:
                best = Swing(cost, sense, last[2])
    return best if best.sense != 0 else Swing(math.inf, 0, 0.0)


@kernel
def to_go(room: Room, place: tuple[float, float], yaw: float) -> float:
    """Return what the rest of the way costs at least [m], +inf where the origin must not be.

    Somewhere on any way without a change of direction the robot looks along the line from its start
    to its end, or away from it: so much it turns at least.
    """
    row, col = math.floor(place[1] / room.coarse_m) + 1, math.floor(place[0] / room.coarse_m) + 1
    rest_m = float(room.to_go_m[row, col])
    if rest_m == math.inf:
        return math.inf
    dx, dy = room.goal[0] - place[0], room.goal[1] - place[1]
    length = math.hypot(dx, dy)
    bearing = math.atan2(dy, dx) if length > SEARCH.cell_m else yaw
    ahead, back = abs(wrapped(bearing - yaw)), abs(wrapped(bearing + math.pi - yaw))
    least = ahead if length > SEARCH.cell_m else 0.0
    if not room.any_heading:
        ahead += abs(wrapped(room.goal[2] - bearing))
        back += abs(wrapped(room.goal[2] - bearing - math.pi))
        least = abs(wrapped(room.goal[2] - yaw))
    if room.sense == BACKWARDS:
        ahead, back = back, ahead
    turning = SEARCH.arc_m * ahead
    if length > SEARCH.cell_m:
        turning = min(turning, SEARCH.arc_m * back + SEARCH.reverse * length)
        turning = min(turning, SEARCH.arc_m * least + SEARCH.switch_m)
    return max(rest_m - room.coarse_m, length - room.missed_m, 0.0) + turning


@kernel
def can_turn(room: Room, shape: Shape, place: tuple[float, float], more_m: float) -> bool:
    """Say whether there is room for a full turn at a place, with the wanted clearance and more."""
    row, col = math.floor(place[1] / room.fine_m), math.floor(place[0] / room.fine_m)
    rows, cols = room.distance_m.shape
    if not (0 <= row < rows and 0 <= col < cols):
        return False
    least_m = shape.circumscribed_m + room.wanted_m + room.fine_m + more_m
    return room.distance_m[row, col] > least_m


@kernel
def key_of(room: Room, shape: Shape, place: tuple[float, float], heading: int, cols: int) -> int:
    """Return the key of the state at a place; `cols` cells are in a row."""
    row, col = math.floor(place[1] / SEARCH.cell_m), math.floor(place[0] / SEARCH.cell_m)
    cell = (row * cols + col) * HEADINGS
    return cell if can_turn(room, shape, place, 0.0) else cell + heading


@kernel
def slot_of(memory: Memory, number: int, key: int) -> int:
    """Return where a state is, or where it goes if it was not reached."""
    size = memory.keys.shape[0]
    slot = ((key * 2654435761) >> 11) & (size - 1)
    while memory.stamps[slot] == number and memory.keys[slot] != key:
        slot = (slot + 1) & (size - 1)
    return slot


@kernel
def remember(memory: Memory, number: int, reached: Reached, estimate: float) -> bool:
    """Keep a state, in place of a dearer way to it; False if the memory is full.

    Args:
        memory: changed in place.
        number: of the search.
        reached: the state.
        estimate: of the cost of the whole way through it.
    """
    slot = slot_of(memory, number, reached.key)
    if memory.stamps[slot] != number:
        if memory.counts[0] >= int(SEARCH.fill * memory.keys.shape[0]):
            return False
        memory.counts[0] += 1
        memory.stamps[slot], memory.keys[slot] = number, reached.key
    if memory.counts[1] >= memory.heap.shape[0]:
        return False
    memory.closed[slot] = 0
    memory.places[slot, 0], memory.places[slot, 1] = reached.x, reached.y
    memory.headings[slot], memory.motions[slot] = reached.heading, reached.motion
    memory.costs[slot], memory.previous[slot] = reached.cost, reached.previous
    sift_up(memory.heap, memory.counts[1], estimate, slot)
    memory.counts[1] += 1
    return True


@kernel
def begin(
    memory: Memory,
    number: int,
    room: Room,
    shape: Shape,
    start: tuple[float, float, float],
    cols: int,
) -> None:
    """Begin a search at a pose: it may take either of the headings beside its own.

    Where neither fits, the robot leaves by the nearer one: it stands there after all.
    """
    memory.counts[0], memory.counts[1] = 0, 0
    nearest = heading_of(shape, start[2])
    off = wrapped(start[2] - shape.first_yaw - nearest * TURN_RAD)
    for which in range(2):
        heading = nearest
        if which == 1:
            heading = (nearest + (1 if off > 0.0 else -1)) % HEADINGS
            if not is_free(room.blocked, shape, room.fine_m, start[:2], angle_of(shape, heading)):
                continue
        turn = abs(wrapped(start[2] - shape.first_yaw - heading * TURN_RAD))
        begin_at(memory, number, room, shape, start[:2], heading, SEARCH.turn_m * turn, cols)


@kernel
def begin_around(
    memory: Memory,
    number: int,
    room: Room,
    shape: Shape,
    end: tuple[float, float, float],
    missed_m: float,
    cols: int,
) -> None:
    """Begin a search at the end of the way, and around it as far as it may be missed.

    What is missed costs as much as a way beside something: it is worth it where that makes room.
    """
    memory.counts[0], memory.counts[1] = 0, 0
    heading = heading_of(shape, end[2])
    for which in range(9):
        place = end[:2]
        if which > 0:
            bearing = 0.25 * math.pi * which
            place = end[0] + missed_m * math.cos(bearing), end[1] + missed_m * math.sin(bearing)
        if is_free(room.blocked, shape, room.fine_m, place, angle_of(shape, heading)):
            cost = 0.0 if which == 0 else SEARCH.beside * missed_m
            begin_at(memory, number, room, shape, place, heading, cost, cols)


@kernel
def begin_at(
    memory: Memory,
    number: int,
    room: Room,
    shape: Shape,
    place: tuple[float, float],
    heading: int,
    cost: float,
    cols: int,
) -> None:
    """Put a first state into the memory, if its cell and heading are not there yet."""
    key = key_of(room, shape, place, heading, cols)
    if memory.counts[0] > 0 and memory.stamps[slot_of(memory, number, key)] == number:
        return
    reached = Reached(key, place[0], place[1], heading, cost, NONE, AT_START)
    rest = to_go(room, place, shape.first_yaw + heading * TURN_RAD)
    remember(memory, number, reached, cost + rest)


@kernel
def offer_direct_drive(
    memory: Memory,
    number: int,
    room: Room,
    shape: Shape,
    state: int,
    goal: tuple[float, float, float],
    task: Task,
) -> bool:
    """Keep the direct drive or curve to the goal if it is cheaper; False if there is no room.

    Args:
        memory: changed in place.
        number: of the search.
        room: where the footprint may be.
        shape: the footprint.
        state: where the drive begins.
        goal: x, y, yaw from the corner.
        task: says whether the goal's heading matters.
    """
    slot = slot_of(memory, number, GOAL_KEY)
    cost, motion = memory.costs[state], int(memory.motions[state])
    most = memory.costs[slot] - cost if memory.stamps[slot] == number else math.inf
    yaw = shape.first_yaw + memory.headings[state] * TURN_RAD
    here = float(memory.places[state, 0]), float(memory.places[state, 1]), yaw
    drive = direct_drive(room, shape, (here, goal), task, motion, most)
    bend, _ = direct_bend(room, shape, (here, goal), task, motion, min(most, drive.cost))
    least = min(drive.cost, bend)
    if can_turn(room, shape, goal[:2], 0.0):
        swing = direct_swing(room, shape, (here, goal), task, motion, min(most, least))
        least = min(least, swing.cost)
    if least == math.inf:
        return True
    through = cost + least
    reached = Reached(GOAL_KEY, goal[0], goal[1], 0, through, state, motion)
    return remember(memory, number, reached, through)


@kernel
def move_from(
    place: tuple[float, float],
    yaw: float,
    which: int,
    heading: int,
    turns_freely: bool,
    sense: int,
) -> tuple[int, int, tuple[float, float]]:
    """Return one move from a state: the motion, the headings it turns by, and where it leads.

    Args:
        place: x, y of the state.
        yaw: its heading [rad].
        which: number of the move: with room to turn one line for each heading, forwards and
            then backwards, as the robot will drive; else turns, lines and arcs.
        heading: index of the state's heading.
        turns_freely: whether there is room to turn.
        sense: of the room.
    """
    if turns_freely:
        motion = sense if which < HEADINGS else -sense
        turn = (which - heading + HEADINGS // 2) % HEADINGS - HEADINGS // 2
        facing = yaw + turn * TURN_RAD
    elif which < 2:
        return TURNING, 2 * which - 1, place
    else:
        motion = FORWARDS if which < 5 else BACKWARDS
        turn = (which - 2) % 3 - 1
        facing = yaw + 0.5 * turn * TURN_RAD
    by = motion * SEARCH.move_m
    return motion, turn, (place[0] + by * math.cos(facing), place[1] + by * math.sin(facing))


@kernel
def move_cost(before: int, motion: int, turn: int, turns_freely: bool) -> float:
    """Return what a move of `move_from` costs at least [m]."""
    cost = change_cost(before, motion)
    if motion == TURNING:
        return cost + SEARCH.turn_m * TURN_RAD
    if turns_freely:
        cost += SEARCH.turn_m * TURN_RAD * abs(turn) + (SEARCH.halt_m if turn != 0 else 0.0)
        return cost + SEARCH.move_m
    return cost + SEARCH.move_m + SEARCH.arc_m * TURN_RAD * abs(turn)


@kernel
def expand(memory: Memory, number: int, room: Room, shape: Shape, state: int, cols: int) -> bool:
    """Reach for the neighbours of a state; False if the memory is full.

    Args:
        memory: changed in place.
        number: of the search.
        room: where the footprint may be.
        shape: the footprint.
        state: whose cheapest way is known.
        cols: cells in a row.
    """
    heading, before = int(memory.headings[state]), int(memory.motions[state])
    cost = float(memory.costs[state])
    here = float(memory.places[state, 0]), float(memory.places[state, 1])
    yaw = shape.first_yaw + heading * TURN_RAD
    turns_freely = can_turn(room, shape, here, 0.0)
    # From room to room every fourth heading will do, and nobody needs to back.
    is_inside = turns_freely and can_turn(room, shape, here, SEARCH.move_m)
    num_moves = HEADINGS if is_inside else (2 * HEADINGS if turns_freely else 8)
    for which in range(0, num_moves, 4 if is_inside else 1):
        motion, turn, place = move_from(here, yaw, which, heading, turns_freely, room.sense)
        next_heading = (heading + turn) % HEADINGS
        rest = to_go(room, place, shape.first_yaw + next_heading * TURN_RAD)
        is_spare = motion * room.sense == BACKWARDS or next_heading % 4 != 0
        if rest == math.inf or (
            turns_freely and is_spare and not is_inside and can_turn(room, shape, place, 0.0)
        ):
            continue
        key = key_of(room, shape, place, next_heading, cols)
        slot = slot_of(memory, number, key)
        is_known = memory.stamps[slot] == number
        through = cost + move_cost(before, motion, turn, turns_freely)
        if is_known and (memory.closed[slot] != 0 or memory.costs[slot] <= through):
            continue
        price = price_of(room, shape, place, angle_of(shape, next_heading), motion)
        length = SEARCH.turn_m * TURN_RAD
        if motion != TURNING:
            length = SEARCH.move_m + (0.0 if turns_freely else SEARCH.arc_m * TURN_RAD * abs(turn))
        through += (price - 1.0) * length
        if price == math.inf or (is_known and memory.costs[slot] <= through):
            continue
        reached = Reached(key, place[0], place[1], next_heading, through, state, motion)
        if not remember(memory, number, reached, through + room.greed * rest):
            return False
    return True


@kernel
def search_poses(
    memory: Memory,
    number: int,
    room: Room,
    shape: Shape,
    ends: tuple[tuple[float, float, float], tuple[float, float, float]],
    task: Task,
    most: int,
) -> tuple[int, int]:
    """Search from pose to pose; return how it ended, and the last state.

    Args:
        memory: scratch.
        number: of this search; differs from that of every other one.
        room: where the footprint may be.
        shape: the footprint.
        ends: x, y, yaw of start and goal, from the corner.
        task: what counts as the goal.
        most: states that it may reach.
    """
    start, goal = ends
    cols = math.ceil(room.blocked.shape[1] * room.fine_m / SEARCH.cell_m)
    if room.sense == FORWARDS:
        begin(memory, number, room, shape, start, cols)
    else:
        begin_around(memory, number, room, shape, start, room.begin_m, cols)
    num_near = 0
    while memory.counts[1] > 0:
        state = take_first(memory.heap, memory.counts[1])
        memory.counts[1] -= 1
        if memory.closed[state] != 0:
            continue
        memory.closed[state] = 1
        if memory.keys[state] == GOAL_KEY:
            return FOUND, state
        yaw = shape.first_yaw + memory.headings[state] * TURN_RAD
        away = math.hypot(goal[0] - memory.places[state, 0], goal[1] - memory.places[state, 1])
        is_turned = task.any_heading or abs(wrapped(goal[2] - yaw)) <= task.yaw_rad
        if away <= task.xy_m and is_turned:
            return FOUND, state
        if away < SEARCH.direct_m:
            num_near += 1
            is_due = num_near % SEARCH.direct_every == 1 or away < 2.0 * SEARCH.move_m
            if is_due and not offer_direct_drive(memory, number, room, shape, state, goal, task):
                return FULL, NONE
        is_full = memory.counts[0] >= most
        if is_full or not expand(memory, number, room, shape, state, cols):
            return FULL, NONE
    return NOT_FOUND, NONE
