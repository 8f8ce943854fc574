"""A search over poses with the true footprint: forwards, backwards and on the spot.

Where the footprint matters a path of points will not do: which way the robot looks, and when it
backs, decide whether it gets through. States are a cell, one of 64 headings and, as in hybrid A*,
the exact point at which the cell was reached first, so that straight lines stay straight. Moves are
short lines and arcs, both ways, and turns on the spot. Where there is room for a full turn one
state stands for all headings: in open floor that leaves a search of the place alone. From states
near the goal a direct drive is tried as well.

It is searched first with two fine cells of clearance, then with one, then with none: what is
measured errs, and so do wheels. Where that takes too many states, it takes a longer path.

Source:
    Dolgov, Thrun, Montemerlo, Diebel, Path Planning for Autonomous Vehicles in Unknown
    Semi-structured Environments (2010): exact points in cells, the cost-to-go of the place alone as
    a heuristic, and direct drives to the goal. Deviations: turns on the spot take the place of
    Reeds and Shepp's curves; what headings cost at least is bounded, not looked up in a table.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley_planner.costmap.fine_grid import FineGrid
from trolley_planner.costmap.footprint import Footprint
from trolley_planner.costmap.inflation import WEIGHT_UNIT
from trolley_planner.paths.hybrid_astar.analytic_expansion import expand_to_goal, expansion_poses
from trolley_planner.paths.hybrid_astar.footprint_spans import (
    ANGLE_RAD,
    PHASES,
    SWING_M,
    FootprintSpans,
    heading_of,
    nearest_angle,
    rasterized,
)
from trolley_planner.paths.hybrid_astar.heuristic import (
    HEURISTIC,
    Heuristic,
    Query,
    cell_of,
    least_weights,
    make_heuristic,
)
from trolley_planner.paths.hybrid_astar.motion_primitives import (
    BACKWARDS,
    FORWARDS,
    TURNING,
    Maneuver,
    Motions,
    PoseXYYaw,
)
from trolley_planner.paths.hybrid_astar.open_list import (
    CAME_THERE,
    GOAL_KEY,
    NUM_STATES,
    USABLE,
    make_memory,
    traced,
)
from trolley_planner.paths.hybrid_astar.search import FOUND, can_arrive, search_poses
from trolley_planner.paths.hybrid_astar.search_space import (
    BESIDE,
    TOUCHING,
    TRAVERSAL,
    SearchSpace,
    can_turn,
    fits,
    make_search_space,
)
from trolley_planner.paths.hybrid_astar.smoothing import smoothed


class PoseSearchParams(NamedTuple):
    """How long a path is searched, and how exactly its start is met; by hand."""

    roomy_states: int = 4000
    """Number of states searched for a path with more clearance."""
    driving_states: int = 10000
    """Number of states searched for any path while the robot waits for it."""
    hasty_states: int = 4000
    """Number of states searched for any path, however long, where these did not suffice."""
    begin_share: float = 0.7
    """Share of the tolerance within which a path that is searched from its end begins."""
    exact_m: float = 0.01
    """Tolerance of the robot's position for a path that is searched from its end."""
    exact_rad: float = 0.02
    """Tolerance of the robot's heading for a path that is searched from its end."""


POSE_SEARCH = PoseSearchParams()


class Task(NamedTuple):
    """From where to where, in `grid`."""

    start: Pose2D
    goal: Pose2D
    any_heading: bool
    """Whether the goal's heading does not matter."""
    xy_m: float
    """How far the goal's place may be missed."""
    yaw_rad: float
    """How far its heading may be missed."""
    wanted_m: float
    """Clearance from which on nothing costs more."""
    else_any: bool = False
    """Whether any heading will do where that of the goal cannot be had."""


class PoseSearch:
    """Finds maneuvers for one footprint; its memory is made once.

    Args:
        footprint: of the robot.
        fine_m: edge of the cells of the grids in which it searches.
    """

    def __init__(self, footprint: Footprint, fine_m: float) -> None:
        self._footprint = footprint
        self._spans = rasterized(footprint, fine_m)
        self._memory = make_memory()
        self._may_come_there = True
        """Whether another heading at its goal may help the last search: no proof that none does."""
        self.num_states = 0
        """States that all its searches have reached."""

    def find(
        self,
        grid: FineGrid,
        unseen: NDArray[np.uint8],
        closed: NDArray[np.uint8],
        task: Task,
        most: int = USABLE,
    ) -> Maneuver | None:
        """Return the cheapest maneuver that was found from pose to pose, None if there is none.

        Args:
            grid: what stands around.
            unseen: (rows, cols) of `grid`: IN_SIGHT, OUT_OF_SIGHT or NEVER_SEEN, which the robot
                must not back into.
            closed: (rows, cols) of `grid`, set where its origin must not be.
            task: from where to where; none leads to or from outside `grid`.
            most: states after which it gives up.
        """
        begin, end = task.start, task.goal
        if not (grid.contains(begin.x, begin.y) and grid.contains(end.x, end.y)):
            return None
        own = Pose2D(begin.x - grid.x, begin.y - grid.y, begin.yaw)
        start, goal = (own.x, own.y, own.yaw), (end.x - grid.x, end.y - grid.y, end.yaw)
        spans = self._spans_for(end.yaw)
        space = make_search_space(grid, unseen, own, self._footprint, spans, task.wanted_m)
        query = Query(start, goal, task.any_heading, task.xy_m, task.yaw_rad, FORWARDS, 0.0)
        found = self._find_from(space, closed, query, most)
        if found is None and task.else_any and self._may_come_there:
            query = query._replace(any_heading=True)
            found = self._find_from(space, closed, query, most)
        if found is None:
            return None
        poses, motions = found
        poses[0] = start  # Which lies between two headings; the search begins at one.
        poses[:, 2] = np.unwrap(poses[:, 2])
        poses, motions = smoothed(poses, motions, space)
        motions[0] = motions[1] if len(motions) > 1 else TURNING
        poses[:, :2] += (grid.x, grid.y)
        return Maneuver(*_divided(poses, motions, self._footprint.circumscribed_m))

    def _find_from(
        self, space: SearchSpace, closed: NDArray[np.uint8], query: Query, most: int
    ) -> Motions | None:
        """Search in headings one of which is nearly the goal's, then in the start's own."""
        self._may_come_there = not can_arrive(space, query)
        if self._may_come_there:
            return None
        found = self._find_in(space, closed, query, most)
        own_spans = self._spans_for(query.start[2])
        is_other = own_spans.phase != space.footprint.phase
        if found is None and is_other and _touches(space, query.start):
            # Neither heading beside its own may fit where it stands, as askew in a door.
            found = self._find_in(space._replace(footprint=own_spans), closed, query, most)
        return found

    def _find_in(
        self, space: SearchSpace, closed: NDArray[np.uint8], query: Query, most: int
    ) -> Motions | None:
        """Search from the end that leaves less room first."""
        weights = least_weights(space, closed, heading_of(space.footprint, query.goal[2]) % 2)
        if not query.any_heading and _is_tighter_at_end(space, query):
            found = self._search(space, weights, _from_end(query), most)
            if found is not None:
                return found
        return self._search(space, weights, query, most)

    def _spans_for(self, yaw: float) -> FootprintSpans:
        """Return the footprint for headings one of which is nearly this one."""
        phase = round(yaw / ANGLE_RAD) % PHASES
        return self._spans._replace(phase=phase, first_yaw=phase * ANGLE_RAD)

    def _search(
        self, space: SearchSpace, weights: NDArray[np.uint8], query: Query, most: int
    ) -> Motions | None:
        """Search with as much clearance as a path is soon found with, in the end with none."""
        start, goal = cell_of(space, query.start), cell_of(space, query.goal)
        weights = weights.copy()
        weights[goal] = WEIGHT_UNIT
        dearest = 1.0 + TRAVERSAL.near
        for blocking in (BESIDE, TOUCHING):
            dearest_weight = round(dearest * WEIGHT_UNIT)
            dearest += TRAVERSAL.beside
            # The robot stands where it starts; at its goal it must fit.
            angle = nearest_angle(query.goal[2])
            may_be = query.any_heading or query.sense == BACKWARDS
            if not (may_be or fits(space, query.goal[:2], angle, blocking)):
                continue
            passable = np.where(weights <= dearest_weight, weights, np.uint8(0))
            heuristic = make_heuristic(space, passable, goal, HEURISTIC.greed)
            if not math.isfinite(heuristic.to_go_m[start]):
                continue
            roomy = space._replace(blocking=blocking)
            found = self._search_once(roomy, query, heuristic, POSE_SEARCH.roomy_states)
            if found is not None:
                return found
        heuristic = make_heuristic(space, weights, goal, HEURISTIC.last_greed)
        most, counts = min(most, USABLE), self._memory.counts
        found = self._search_once(space, query, heuristic, most)
        is_full = bool(counts[NUM_STATES] >= most)
        self._may_come_there |= is_full or bool(counts[CAME_THERE])
        if found is None and is_full:
            hasty = heuristic._replace(greed=HEURISTIC.hasty_greed)
            found = self._search_once(space, query, hasty, POSE_SEARCH.hasty_states)
        return found

    def _search_once(
        self, space: SearchSpace, query: Query, heuristic: Heuristic, most: int
    ) -> Motions | None:
        """Return a path in a room as poses (n, 3) from the corner, and how each is reached."""
        outcome, last = search_poses(self._memory, space, query, heuristic, most)
        self.num_states += int(self._memory.counts[NUM_STATES])
        if outcome != FOUND:
            return None
        poses, motions = traced(self._memory, last, space.footprint)
        if int(self._memory.keys[last]) == GOAL_KEY:
            state: PoseXYYaw = float(poses[-1, 0]), float(poses[-1, 1]), float(poses[-1, 2])
            expansion = expand_to_goal(space, query, state, int(motions[-1]), math.inf)
            more, kinds = expansion_poses(expansion, query, state)
            poses, motions = np.concatenate([poses, more]), np.concatenate([motions, kinds])
        if query.sense == FORWARDS:
            return poses, motions
        return poses[::-1].copy(), np.roll(-motions[::-1], 1)


def _divided(poses: NDArray[np.float64], motions: NDArray[np.int8], reach_m: float) -> Motions:
    """Return a maneuver (n, 3) with poses in between where the outermost point swings far."""
    swings = reach_m * np.abs(np.diff(poses[:, 2]))
    counts = np.maximum(np.ceil(swings / SWING_M), 1.0).astype(np.int64)
    index = np.arange(len(poses))
    starts = np.append(0, np.cumsum(counts))
    at = np.interp(np.arange(starts[-1] + 1), starts, index)
    divided = np.column_stack([np.interp(at, index, column) for column in poses.T])
    return divided, motions[np.ceil(at - 1e-9).astype(np.int64)]


def _touches(space: SearchSpace, pose: PoseXYYaw) -> bool:
    """Say whether the footprint all but touches something at a pose."""
    return not fits(space, pose[:2], nearest_angle(pose[2]), TOUCHING)


def _is_tighter_at_end(space: SearchSpace, query: Query) -> bool:
    """Say whether there is room to turn at the start, and none at the goal."""
    return can_turn(space, query.start[:2], 0.0) and not can_turn(space, query.goal[:2], 0.0)


def _from_end(query: Query) -> Query:
    """Return the same query, searched from its end."""
    return query._replace(
        start=query.goal,
        goal=query.start,
        xy_m=POSE_SEARCH.exact_m,
        yaw_rad=POSE_SEARCH.exact_rad,
        sense=BACKWARDS,
        begin_m=POSE_SEARCH.begin_share * query.xy_m,
    )
