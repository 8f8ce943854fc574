"""The global plan: cheapest way over the costmap, straightened and smoothed."""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from trolley_planner.costmap.costmap import Costmap
from trolley_planner.costmap.inflation import LETHAL, WEIGHT_UNIT, close_disc, soften_disc
from trolley_planner.paths.cost_to_go import COST_OF_CELL, GoalField, Terrain
from trolley_planner.paths.footprint_check import Fitted, Fitting
from trolley_planner.paths.lines import polyline_cost, straighten
from trolley_planner.paths.path import PlannedPath

Point = tuple[float, float]


ESCAPE_WEIGHT = 60 * WEIGHT_UNIT
"""Price of cells that are lethal, but from which the robot must find a way out."""


OBSTRUCTED_WEIGHT = 30 * WEIGHT_UNIT
"""Price of what the lidar saw in the way, for a plan that hopes it will be gone."""


START_ESCAPE_M = 0.5


GOAL_ESCAPE_M = 0.15


SEEN_GIVE_CELLS, MAP_GIVE_CELLS = 0.5, 0.15
"""Where there is no other way, obstacles may reach so far into the footprint: seen, and mapped."""


NARROW_PLACES = 8
"""So many places that prove too narrow are gone round, then there is no way."""


NARROW_M = 0.12
"""Radius that is closed at such a place, at least."""


@dataclass(frozen=True, slots=True, eq=False)
class _Leg:
    """The way to one target.

    Attributes:
        points: (n, 2) [m].
        weights: (rows, cols) that it is made for: where start or target are too near to
            something and it needs to pass there, with the way out.
        cost: in metres of free floor.
    """

    points: NDArray[np.float64]
    weights: NDArray[np.uint8]
    cost: float


class GlobalPlanner:
    """Plans on one costmap; keeps what it knows of the goal's cost-to-go from plan to plan.

    All points are in frame `grid` [m].
    """

    def __init__(self, costmap: Costmap) -> None:
        self._costmap = costmap
        self._field = GoalField(costmap.shape)
        self._fitting = Fitting(costmap.footprint, costmap.resolution_m)
        self.narrow: list[Point] = []
        """Where the last plan found that the footprint does not get through."""

    def plan(
        self,
        start: Point,
        targets: list[Point],
        weights: NDArray[np.uint8],
        distance_m: NDArray[np.float32],
    ) -> PlannedPath | None:
        """Return the cheapest way through all targets, None if there is none.

        Args:
            start: where the robot is.
            targets: via points in their order, then the goal.
            weights: (rows, cols) of the costmap, with or without what the lidar has seen.
            distance_m: (rows, cols) that belongs to them.
        """
        leaving = self._costmap.leaving
        if leaving is not None:
            # Dear, so that the way leads out of the zone by the shortest way, and not through it.
            weights = np.where(leaving & (weights != LETHAL), np.uint8(ESCAPE_WEIGHT), weights)
        self.narrow = []
        ends = [start, *targets]
        found = self._fitting_way(ends, weights, distance_m, False)
        # Onto what stands on a target no way is narrow: there is none.
        if found is None and all(self._has_room(target, distance_m) for target in targets):
            squeezed = self._costmap.squeezed(weights, distance_m)
            found = self._fitting_way(ends, squeezed, distance_m, True)
        return found

    def _fitting_way(
        self,
        ends: list[Point],
        weights: NDArray[np.uint8],
        distance_m: NDArray[np.float32],
        is_tight: bool,
    ) -> PlannedPath | None:
        """Return the cheapest way along which the footprint fits, None if there is none.

        Args:
            ends: the start, then the targets.
            weights: as in `plan`.
            distance_m: as in `plan`.
            is_tight: whether it may touch where that is only because of the size of the cells.
        """
        for _ in range(NARROW_PLACES):
            found = self._through(ends, weights, distance_m, is_tight)
            if isinstance(found, PlannedPath) or found is None:
                return found
            self.narrow.append(found)
            weights = weights.copy()
            cells = found[0] / self._costmap.resolution_m, found[1] / self._costmap.resolution_m
            radius_m = max(self._costmap.footprint.inscribed_m, NARROW_M)
            close_disc(weights, cells, radius_m / self._costmap.resolution_m)
        return None

    def too_narrow(
        self,
        start: Point,
        targets: list[Point],
        weights: NDArray[np.uint8],
        distance_m: NDArray[np.float32],
    ) -> list[Point]:
        """Return where the robot does not get through on a way that is free but too narrow.

        Args:
            start: as in `plan`, which found no way with the same arguments a moment ago.
            targets: as there.
            weights: as there.
            distance_m: as there.
        """
        if self.narrow:
            return list(self.narrow)
        squeezed = np.where(
            (weights == LETHAL) & (distance_m > 0.0), np.uint8(ESCAPE_WEIGHT), weights
        )
        squeezed[0, :] = squeezed[-1, :] = squeezed[:, 0] = squeezed[:, -1] = LETHAL
        found: list[Point] = []
        for here, target in zip([start, *targets], targets, strict=False):
            leg = self._leg(here, target, squeezed, distance_m)
            if leg is None:
                return []
            cells = np.floor(leg.points / self._costmap.resolution_m).astype(np.int64)
            tight = weights[cells[:, 1], cells[:, 0]] == LETHAL
            room_m = distance_m[cells[:, 1], cells[:, 0]]
            for places in np.split(np.arange(len(tight)), np.flatnonzero(np.diff(tight)) + 1):
                x, y = (float(value) for value in leg.points[places[np.argmin(room_m[places])]])
                # The robot's own place and the target's may be tight and still be right.
                is_end = math.dist((x, y), start) < START_ESCAPE_M or (x, y) == target
                if tight[places[0]] and not is_end:
                    found.append((x, y))
        return found

    def cost_of(self, points: NDArray[np.float64], weights: NDArray[np.uint8]) -> float:
        """Return the price of a path (n, 2) [m of free floor]; lethal cells are very dear."""
        cells = points / self._costmap.resolution_m
        cost = polyline_cost(weights, cells, float(ESCAPE_WEIGHT))
        return cost * self._costmap.resolution_m / WEIGHT_UNIT

    def hopeful_weights(self) -> NDArray[np.uint8]:
        """Return weights in which what the lidar saw in the way is dear, but not impassable."""
        costmap = self._costmap
        passable = (costmap.weights == LETHAL) & (costmap.static_weights != LETHAL)
        return np.where(passable, np.uint8(OBSTRUCTED_WEIGHT), costmap.weights)

    def _through(
        self,
        ends: list[Point],
        weights: NDArray[np.uint8],
        distance_m: NDArray[np.float32],
        is_tight: bool,
    ) -> PlannedPath | Point | None:
        """Return the way through all targets, or else where it is too narrow; None: no way."""
        legs: list[NDArray[np.float64]] = []
        cost = 0.0
        for here, target in pairwise(ends):
            leg = self._leg(here, target, weights, distance_m)
            if leg is None:
                return None
            fitted = self._fit(leg, distance_m, is_tight)
            if fitted.narrow is not None:
                return fitted.narrow
            legs.append(fitted.points)
            cost += leg.cost
        return PlannedPath.join(legs, cost, is_tight)

    def _fit(self, leg: _Leg, distance_m: NDArray[np.float32], is_tight: bool) -> Fitted:
        """Lead a leg through where the footprint fits."""
        if not is_tight:
            return self._fitting.fit(leg.points, leg.weights, distance_m)
        # What the lidar saw gives way by cells, but the map's walls are where they are drawn.
        fitted = self._fitting.fit(leg.points, leg.weights, distance_m, SEEN_GIVE_CELLS)
        if fitted.narrow is not None:
            return fitted
        walls_m = self._costmap.static_distance_m
        return self._fitting.fit(fitted.points, leg.weights, walls_m, MAP_GIVE_CELLS)

    def _leg(
        self,
        start: Point,
        target: Point,
        weights: NDArray[np.uint8],
        distance_m: NDArray[np.float32],
    ) -> _Leg | None:
        """Return the way between two points, None if there is none."""
        start_cell, target_cell = self._cell(start), self._cell(target)
        if start_cell is None or target_cell is None:
            return None
        scale = 1.0 / self._costmap.resolution_m
        discs = np.array([[*start, START_ESCAPE_M], [*target, GOAL_ESCAPE_M]]) * scale
        is_tight = weights.reshape(-1)[[start_cell, target_cell]] == LETHAL
        found = None
        # Nothing is squeezed through where there is another way.
        for reach in (is_tight, np.ones(2)):
            discs[:, 2] = reach * (START_ESCAPE_M * scale, GOAL_ESCAPE_M * scale)
            found = self._field.way(start_cell, Terrain(weights, distance_m, discs, ESCAPE_WEIGHT))
            if found is not None:
                break
        if found is None:
            return None
        cells, cost = found
        cols = self._costmap.shape[1]
        points = np.stack([cells % cols, cells // cols], axis=1).astype(np.float64) + 0.5
        if len(cells) == 1:
            points = np.repeat(points, 2, axis=0)
        points[0], points[-1] = discs[0, :2], discs[1, :2]
        metres = cost / COST_OF_CELL * self._costmap.resolution_m
        if math.isinf(polyline_cost(weights, points, math.inf)):
            weights = weights.copy()
            for x, y, radius in discs:
                soften_disc(weights, distance_m, (x, y), radius, ESCAPE_WEIGHT)
        smooth_points = straighten(points, weights, scale) * self._costmap.resolution_m
        return _Leg(smooth_points, weights, metres)

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
