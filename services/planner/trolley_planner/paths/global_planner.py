"""The global plan: cheapest path over the costmap, straightened and smoothed."""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from trolley_planner.costmap.costmap import Costmap
from trolley_planner.costmap.inflation import LETHAL, WEIGHT_UNIT, close_disc, soften_disc
from trolley_planner.paths.corridor import Terrain
from trolley_planner.paths.cost_to_go import COST_OF_CELL, CostToGo
from trolley_planner.paths.footprint_check import FootprintCheck, Yaws
from trolley_planner.paths.path import (
    PlannedPath,
    polyline_cost,
    smooth_line,
    straighten,
    through_cells,
)

Point = tuple[float, float]


@dataclass(frozen=True, slots=True)
class GlobalPlannerParams:
    """What plans may cross, and at what cost; all by hand."""

    escape_weight: int = 60 * WEIGHT_UNIT
    """Weight of lethal cells from which the robot must find a way out."""
    optimistic_weight: int = 30 * WEIGHT_UNIT
    """Weight of seen obstacles for a plan that hopes that they will be gone."""
    start_escape_m: float = 0.5
    """Distance from the start within which lethal cells may be crossed."""
    goal_escape_m: float = 0.15
    """Distance from the goal within which lethal cells may be crossed."""
    most_narrow_places: int = 8
    """Number of places that may prove too narrow before there is no path."""
    most_poses: int = 1_000_000
    """Number of poses searched at such places after which it gives up: 1.4 s of a PC. Each search
    in vain among many things takes up to a fifth, and who plans for long gives no command."""
    narrow_m: float = 0.12
    """Least radius of the area that is closed at such a place."""


PLANNING = GlobalPlannerParams()


@dataclass(frozen=True, slots=True, eq=False)
class _Leg:
    """The path to one target.

    Attributes:
        points: (n, 2) [m].
        weights: (rows, cols) that it is made for: where start or target are too near to
            something and the path must pass there, with the way out.
        cost: in metres of free floor.
    """

    points: NDArray[np.float64]
    weights: NDArray[np.uint8]
    cost: float


class GlobalPlanner:
    """Plans on one costmap; reuses the goal's cost-to-go from plan to plan.

    All points are in frame `grid` [m].
    """

    def __init__(self, costmap: Costmap) -> None:
        self._costmap = costmap
        self._cost_to_go = CostToGo(costmap.shape)
        self._footprint_check = FootprintCheck(costmap)
        self.pose_search = self._footprint_check.pose_search
        """Finds ways with headings; its memory is large, so all who plan here share it."""
        self.narrow: list[Point] = []
        """Where the last plan found that the footprint does not get through."""

    def plan(
        self,
        start: Point,
        targets: list[Point],
        weights: NDArray[np.uint8],
        distance_m: NDArray[np.float32],
        yaws: Yaws = (None, None),
        most_poses: int = PLANNING.most_poses,
    ) -> PlannedPath | None:
        """Return the cheapest path through all targets, None if there is none.

        Args:
            start: where the robot is.
            targets: via points in their order, then the goal.
            weights: (rows, cols) of the costmap, with or without what the lidar has seen.
            distance_m: (rows, cols) that belongs to them.
            yaws: of the robot at the start and at the goal [rad], None where any will do.
            most_poses: searched at places that prove too narrow; then it gives up.
        """
        most_states = self.pose_search.num_states + most_poses
        leaving = self._costmap.static.leaving
        if leaving is not None:
            # Expensive, so that the path leaves the zone as soon as it can, and does not cross it.
            weights = np.where(
                leaving & (weights != LETHAL), np.uint8(PLANNING.escape_weight), weights
            )
        self.narrow = []
        ends = [start, *targets]
        found = self._plan_fitting_path(ends, weights, distance_m, False, yaws, most_states)
        # Where something stands on a target, the path is not too narrow: there is none.
        if found is None and all(self._has_room(target, distance_m) for target in targets):
            squeeze_weights = self._costmap.squeeze_weights(weights, distance_m)
            found = self._plan_fitting_path(
                ends, squeeze_weights, distance_m, True, yaws, most_states
            )
        return found

    def _plan_fitting_path(
        self,
        ends: list[Point],
        weights: NDArray[np.uint8],
        distance_m: NDArray[np.float32],
        is_tight: bool,
        yaws: Yaws,
        most_states: int,
    ) -> PlannedPath | None:
        """Return the cheapest path along which the footprint fits, None if there is none.

        Args:
            ends: the start, then the targets.
            weights: as in `plan`.
            distance_m: as in `plan`.
            is_tight: whether it may touch where that is only because of the size of the cells.
            yaws: as in `plan`.
            most_states: it gives up once the search over poses has reached so many in all.
        """
        for _ in range(PLANNING.most_narrow_places):
            found = self._plan_through(ends, weights, distance_m, is_tight, yaws)
            if isinstance(found, PlannedPath) or found is None:
                return found
            self.narrow.append(found)
            if any(math.dist(found, end) < PLANNING.start_escape_m for end in (ends[0], ends[-1])):
                return None  # However it goes on, there it must pass.
            if self.pose_search.num_states >= most_states:
                return None
            weights = weights.copy()
            cells = found[0] / self._costmap.resolution_m, found[1] / self._costmap.resolution_m
            radius_m = max(self._costmap.footprint.inscribed_m, PLANNING.narrow_m)
            close_disc(weights, cells, radius_m / self._costmap.resolution_m)
        return None

    def too_narrow(
        self,
        start: Point,
        targets: list[Point],
        weights: NDArray[np.uint8],
        distance_m: NDArray[np.float32],
    ) -> list[Point]:
        """Return the places of a free path that are too narrow for the robot.

        Args:
            start: as in `plan`, which found no path with the same arguments a moment ago.
            targets: as there.
            weights: as there.
            distance_m: as there.
        """
        if self.narrow:
            return list(self.narrow)
        squeeze_weights = np.where(
            (weights == LETHAL) & (distance_m > 0.0), np.uint8(PLANNING.escape_weight), weights
        )
        squeeze_weights[0, :] = squeeze_weights[-1, :] = squeeze_weights[:, 0] = squeeze_weights[
            :, -1
        ] = LETHAL
        found: list[Point] = []
        for here, target in zip([start, *targets], targets, strict=False):
            leg = self._leg(here, target, squeeze_weights, distance_m)
            if leg is None:
                return []
            cells = np.floor(leg.points / self._costmap.resolution_m).astype(np.int64)
            tight = weights[cells[:, 1], cells[:, 0]] == LETHAL
            room_m = distance_m[cells[:, 1], cells[:, 0]]
            for places in np.split(np.arange(len(tight)), np.flatnonzero(np.diff(tight)) + 1):
                x, y = (float(value) for value in leg.points[places[np.argmin(room_m[places])]])
                # The robot's own place and the target's may be tight and still be right.
                is_end = math.dist((x, y), start) < PLANNING.start_escape_m or (x, y) == target
                if tight[places[0]] and not is_end:
                    found.append((x, y))
        return found

    def cost_of(self, points: NDArray[np.float64], weights: NDArray[np.uint8]) -> float:
        """Return the cost of a path (n, 2) [m of free floor]; lethal cells are very expensive."""
        cells = points / self._costmap.resolution_m
        cost = polyline_cost(weights, cells, float(PLANNING.escape_weight))
        return cost * self._costmap.resolution_m / WEIGHT_UNIT

    def optimistic_weights(self) -> NDArray[np.uint8]:
        """Return weights in which seen obstacles are expensive, but passable."""
        costmap = self._costmap
        passable = (costmap.weights == LETHAL) & (costmap.static.weights != LETHAL)
        return np.where(passable, np.uint8(PLANNING.optimistic_weight), costmap.weights)

    def _plan_through(
        self,
        ends: list[Point],
        weights: NDArray[np.uint8],
        distance_m: NDArray[np.float32],
        is_tight: bool,
        yaws: Yaws,
    ) -> PlannedPath | Point | None:
        """Return the path through all targets, or else where it is too narrow; None: no path."""
        legs: list[NDArray[np.float64]] = []
        cost = 0.0
        for here, target in pairwise(ends):
            leg = self._leg(here, target, weights, distance_m)
            if leg is None:
                return None
            here_yaw = yaws[0] if here is ends[0] else None
            there_yaw = yaws[1] if target is ends[-1] else None
            checked = self._footprint_check.check(
                leg.points, leg.weights, distance_m, (here_yaw, there_yaw)
            )
            if checked.narrow is not None:
                return checked.narrow
            legs.append(checked.points)
            cost += leg.cost
        return PlannedPath.join(legs, cost, is_tight)

    def _leg(
        self,
        start: Point,
        target: Point,
        weights: NDArray[np.uint8],
        distance_m: NDArray[np.float32],
    ) -> _Leg | None:
        """Return the path between two points, None if there is none."""
        start_cell, target_cell = self._cell(start), self._cell(target)
        if start_cell is None or target_cell is None:
            return None
        scale = 1.0 / self._costmap.resolution_m
        places = start[0] * scale, start[1] * scale, target[0] * scale, target[1] * scale
        reach = PLANNING.start_escape_m * scale, PLANNING.goal_escape_m * scale
        is_tight = weights.item(start_cell) == LETHAL, weights.item(target_cell) == LETHAL
        found, discs = None, np.empty((2, 3))
        # The robot squeezes through nothing where there is another path.
        for open_start, open_target in (is_tight, (True, True)):
            discs[0] = places[0], places[1], reach[0] * open_start
            discs[1] = places[2], places[3], reach[1] * open_target
            found = self._cost_to_go.cheapest_path(
                start_cell, Terrain(weights, distance_m, discs, PLANNING.escape_weight)
            )
            if found is not None:
                break
        if found is None:
            return None
        cells, cost = found
        metres = cost / COST_OF_CELL * self._costmap.resolution_m
        cols = self._costmap.shape[1]
        points = smooth_line(cells, cols, places, weights, scale)
        if len(points) == 0:
            weights = weights.copy()
            for x, y, radius in discs:
                soften_disc(weights, distance_m, (x, y), radius, PLANNING.escape_weight)
            line = through_cells(cells, cols, places)
            points = straighten(line, weights, scale) * self._costmap.resolution_m
        return _Leg(points, weights, metres)

    def _has_room(self, point: Point, distance_m: NDArray[np.float32]) -> bool:
        """Say whether the footprint's centre may be at a point."""
        cell = self._cell(point)
        return cell is not None and float(distance_m.reshape(-1)[cell]) >= self._costmap.tight_m

    def _cell(self, point: Point) -> int | None:
        """Return the flat index of the cell under a point, None outside and on the border."""
        if not self._costmap.contains(*point):
            return None
        scale = 1.0 / self._costmap.resolution_m
        return int(point[1] * scale) * self._costmap.shape[1] + int(point[0] * scale)
