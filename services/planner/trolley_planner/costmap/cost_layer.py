"""The costmap layer of costs that programs publish: where the robot would rather not drive."""

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley.gridmap.wire import grid_of
from trolley.jit import kernel
from trolley.messages import OccupancyGrid
from trolley_planner.costmap.inflation import WEIGHT_UNIT
from trolley_planner.costmap.obstacle_grid import ObstacleGrid, mark_dirty

COST_OF_METRE = 10
"""A metre through cells of this cost counts as one more metre of free floor."""
HIGHEST_COST = 100
MOST_SAMPLES = 4
"""Number of points along a cell's edge at which finer cells are looked up, at most."""


class CostLayer:
    """Weights from the costs that programs publish; they never block and never open a cell.

    Args:
        shape: rows and columns.
        resolution_m: cell edge [m].
    """

    def __init__(self, shape: tuple[int, int], resolution_m: float) -> None:
        self._resolution_m = resolution_m
        self._by_source: dict[str, tuple[OccupancyGrid, NDArray[np.uint8]]] = {}
        self._changed: list[tuple[int, int, int, int]] = []
        self.weights = np.zeros(shape, dtype=np.uint8)
        """(rows, cols) the least weight (units: `WEIGHT_UNIT`), 0 = no costs."""

    @property
    def has_costs(self) -> bool:
        """Whether any program publishes costs."""
        return bool(self._by_source)

    def update(
        self, costs: Mapping[str, OccupancyGrid], frame_T_grid: Pose2D, grid: ObstacleGrid
    ) -> None:
        """Take over which programs publish costs, and of one of them what is new.

        One at a time, since a large grid takes 30 ms: the commands must not wait for eight. Where
        several lie over a cell, the highest counts.

        Args:
            costs: by program; cells of 0 or less for none to `HIGHEST_COST`.
            frame_T_grid: places this grid in the frame of theirs.
            grid: its box of changes is extended.
        """
        gone = self._by_source.keys() - costs.keys()
        for source in gone:
            del self._by_source[source]
        new = [source for source in costs if source not in self._by_source]
        for source in (*new, *self._by_source):
            kept, message = self._by_source.get(source), costs[source]
            if kept is None or kept[0] is not message:
                weights = np.zeros_like(self.weights)
                given = grid_of(message)
                self._raise(weights, given, given.origin.inverse() @ frame_T_grid)
                # At the end, so that each has its turn however often one publishes.
                self._by_source.pop(source, None)
                self._by_source[source] = message, weights
                break
        else:
            if not gone:
                return
        before, self.weights = self.weights, np.zeros_like(self.weights)
        for _, weights in self._by_source.values():
            np.maximum(self.weights, weights, out=self.weights)
        rows, cols = np.nonzero(self.weights != before)
        if len(rows) == 0:
            return
        box = int(rows.min()), int(rows.max()), int(cols.min()), int(cols.max())
        mark_dirty(grid.dirty, box[0], box[2])
        mark_dirty(grid.dirty, box[1], box[3])
        self._changed.append((box[0], box[1] + 1, box[2], box[3] + 1))

    def pop_changed(self) -> list[tuple[int, int, int, int]]:
        """Return first and end row, first and end column of what changed since the last call."""
        changed, self._changed = self._changed, []
        return changed

    def _raise(self, weights: NDArray[np.uint8], costs: GridMap, costs_T_grid: Pose2D) -> None:
        """Raise the weights under one grid of costs."""
        height, width = costs.cells.shape
        corners = costs.resolution * np.array([(0, 0), (width, 0), (width, height), (0, height)])
        corners = costs_T_grid.inverse().transform_points(corners) / self._resolution_m
        (first_col, first_row), (end_col, end_row) = corners.min(axis=0), corners.max(axis=0)
        rows, cols = weights.shape
        box = (
            math.floor(min(max(first_row, 0), rows)),
            math.ceil(min(max(end_row, 0), rows)),
            math.floor(min(max(first_col, 0), cols)),
            math.ceil(min(max(end_col, 0), cols)),
        )
        scale = self._resolution_m / costs.resolution
        samples = min(math.ceil(scale), MOST_SAMPLES)
        placed = (
            scale * math.cos(costs_T_grid.yaw),
            scale * math.sin(costs_T_grid.yaw),
            costs_T_grid.x / costs.resolution,
            costs_T_grid.y / costs.resolution,
        )
        raise_weights(weights, box, np.array(costs.cells), placed, samples)


@kernel
def raise_weights(
    weights: NDArray[np.uint8],
    box: tuple[int, int, int, int],
    costs: NDArray[np.int8],
    placed: tuple[float, float, float, float],
    samples: int,
) -> None:
    """Raise the weights of cells by the highest cost that points in them look up.

    Args:
        weights: (rows, cols), changed in place, never lowered.
        box: first and end row, first and end column of the cells.
        costs: (cost rows, cost cols).
        placed: cosine and sine, each times the edge of a cell in cells of `costs`, and x, y of
            the corner of `weights` in cells of `costs`.
        samples: points along a cell's edge.
    """
    first_row, end_row, first_col, end_col = box
    along, across, corner_x, corner_y = placed
    cost_rows, cost_cols = costs.shape
    for row in range(first_row, end_row):
        for col in range(first_col, end_col):
            highest = 0
            for sample in range(samples * samples):
                y = row + (sample // samples + 0.5) / samples
                x = col + (sample % samples + 0.5) / samples
                cost_col = math.floor(corner_x + along * x - across * y)
                cost_row = math.floor(corner_y + across * x + along * y)
                if 0 <= cost_row < cost_rows and 0 <= cost_col < cost_cols:
                    highest = max(highest, int(costs[cost_row, cost_col]))
            if highest > 0:
                metres = 1.0 + min(highest, HIGHEST_COST) / COST_OF_METRE
                weights[row, col] = max(int(weights[row, col]), math.floor(WEIGHT_UNIT * metres))
