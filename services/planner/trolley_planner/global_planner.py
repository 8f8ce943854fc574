"""The global plan: cheapest way over the costmap, straightened and smoothed."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley_planner.costmap import Costmap
from trolley_planner.kernels.layers import LETHAL, WEIGHT_UNIT, soften_disc
from trolley_planner.kernels.search import (
    NUM_BUCKETS,
    STEP,
    UNREACHED,
    Queue,
    cost_to_go_into,
    descend_into,
    polyline_cost,
    shortcut_into,
    smooth,
)
from trolley_planner.path import SPACING_M, PlannedPath, resample

Point = tuple[float, float]

COST_OF_CELL = 2 * STEP * WEIGHT_UNIT
"""Cost of a straight step over free cells."""
ESCAPE_WEIGHT = 60 * WEIGHT_UNIT
"""Price of cells that are lethal, but from which the robot must find a way out."""
OBSTRUCTED_WEIGHT = 30 * WEIGHT_UNIT
"""Price of what the lidar saw in the way, for a plan that hopes it will be gone."""
START_ESCAPE_M = 0.5
GOAL_ESCAPE_M = 0.15
SLACK_M = 2.0
"""How far the search goes on beyond the robot, so that the result serves where it drives next."""
SHORTCUT_POINTS = 160
SHORTCUT_ALLOWANCE = 1.02
SMOOTHING_ROUNDS = 30


@dataclass(slots=True, eq=False)
class _Field:
    """Cost-to-go of one target, and what it was computed with."""

    target: Point
    weights: NDArray[np.uint8]
    cost: NDArray[np.int32]


class GlobalPlanner:
    """Plans on one costmap; keeps the goal's cost-to-go as long as the weights stay the same.

    All points are in frame `grid` [m].
    """

    def __init__(self, costmap: Costmap) -> None:
        self._costmap = costmap
        rows, cols = costmap.shape
        cells = rows * cols
        self._queue = Queue(
            np.empty(NUM_BUCKETS, dtype=np.int32),
            np.empty(cells, dtype=np.int32),
            np.empty(cells, dtype=np.int32),
        )
        self._field: _Field | None = None

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
        legs: list[NDArray[np.float64]] = []
        cost = 0.0
        here = start
        for target in targets:
            leg = self._leg(here, target, weights, distance_m)
            if leg is None:
                return None
            legs.append(leg[0])
            cost += leg[1]
            here = target
        return PlannedPath.join(legs, cost)

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

    def _leg(
        self,
        start: Point,
        target: Point,
        weights: NDArray[np.uint8],
        distance_m: NDArray[np.float32],
    ) -> tuple[NDArray[np.float64], float] | None:
        """Return the points of the way between two points and its cost, None if there is none."""
        softened = self._soften(start, target, weights, distance_m)
        start_cell, target_cell = self._cell(start), self._cell(target)
        if start_cell is None or target_cell is None:
            return None
        field = self._cost_to_go(target, target_cell, start_cell, softened)
        if field[start_cell] == UNREACHED:
            return None
        rows, cols = self._costmap.shape
        cells = np.empty(4 * (rows + cols) + rows * cols // 4, dtype=np.int32)
        count = descend_into(cells, field, softened.reshape(-1), start_cell, cols)
        points = np.empty((count, 2), dtype=np.float64)
        points[:, 0] = cells[:count] % cols + 0.5
        points[:, 1] = cells[:count] // cols + 0.5
        scale = 1.0 / self._costmap.resolution_m
        points[0] = (start[0] * scale, start[1] * scale)
        points[-1] = (target[0] * scale, target[1] * scale)
        if count == 1:
            points = np.array([[start[0], start[1]], [target[0], target[1]]]) * scale
        metres = float(field[start_cell]) / COST_OF_CELL * self._costmap.resolution_m
        return self._straighten(points, softened) * self._costmap.resolution_m, metres

    def _straighten(
        self, points: NDArray[np.float64], weights: NDArray[np.uint8]
    ) -> NDArray[np.float64]:
        """Return a smooth path (m, 2) of one along cells (n, 2), both in cells."""
        kept = np.empty(len(points), dtype=np.int32)
        count = shortcut_into(kept, weights, points, SHORTCUT_POINTS, SHORTCUT_ALLOWANCE)
        spacing = SPACING_M / self._costmap.resolution_m
        # Smoothing moves corners by a few points at most, so coarse points first reach farther.
        coarse = resample(points[kept[:count]], 2.0 * spacing)
        smooth(coarse, weights, np.zeros(len(coarse), dtype=np.uint8), SMOOTHING_ROUNDS)
        return resample(coarse, spacing)

    def _cost_to_go(
        self, target: Point, target_cell: int, start_cell: int, weights: NDArray[np.uint8]
    ) -> NDArray[np.int32]:
        kept = self._field
        if (
            kept is not None
            and kept.target == target
            and kept.cost[start_cell] != UNREACHED
            and np.array_equal(kept.weights, weights)
        ):
            return kept.cost
        cost = np.empty(weights.size, dtype=np.int32)
        slack = round(SLACK_M / self._costmap.resolution_m * COST_OF_CELL)
        seeds = np.array([[target_cell, 0]], dtype=np.int32)
        cols = self._costmap.shape[1]
        flat = weights.reshape(-1)
        cost_to_go_into(cost, flat, self._queue, seeds, cols, (start_cell, slack))
        self._field = _Field(target, weights, cost)
        return cost

    def _soften(
        self,
        start: Point,
        target: Point,
        weights: NDArray[np.uint8],
        distance_m: NDArray[np.float32],
    ) -> NDArray[np.uint8]:
        """Return weights in which the way out of the start and into the target is possible."""
        softened = weights.copy()
        scale = 1.0 / self._costmap.resolution_m
        for (x, y), radius_m in ((start, START_ESCAPE_M), (target, GOAL_ESCAPE_M)):
            centre = (x * scale, y * scale)
            soften_disc(softened, distance_m, centre, radius_m * scale, ESCAPE_WEIGHT)
        leaving = self._costmap.leaving
        if leaving is not None:
            # Dear, so that the way leads out of the zone by the shortest way, and not through it.
            softened[leaving & (softened != LETHAL)] = ESCAPE_WEIGHT
        return softened

    def _cell(self, point: Point) -> int | None:
        """Return the flat index of the cell under a point, None outside and on the border."""
        if not self._costmap.contains(*point):
            return None
        scale = 1.0 / self._costmap.resolution_m
        return int(point[1] * scale) * self._costmap.shape[1] + int(point[0] * scale)
