"""The distances of the costmap: from each cell to the nearest obstacle of all layers."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.gridmap.distance import distance_transform
from trolley_planner.costmap.inflation import (
    CostmapLayers,
    compose_into,
    measure_box,
    replace_mask,
    update_distances,
)


@dataclass(frozen=True, slots=True)
class DistanceFieldParams:
    """When distances are brought up to date cell by cell."""

    most_flipped: int = 40
    """If more cells than this change at once, the distances between them are recomputed, too;
    found by bench/planner/costmap."""


DISTANCE_FIELD = DistanceFieldParams()


class DistanceField:
    """The distance to the nearest obstacle, kept up to date where the layers changed.

    Args:
        shape: rows and columns.
        resolution_m: cell edge [m].
        reach_m: greater distances count as this [m].
        unknown_blocks: whether cells that nobody has seen are obstacles.
    """

    def __init__(
        self, shape: tuple[int, int], resolution_m: float, reach_m: float, unknown_blocks: bool
    ) -> None:
        self._resolution_m = resolution_m
        self._reach_m = reach_m
        self._unknown_blocks = unknown_blocks
        self._is_occupied = np.zeros(shape, dtype=np.uint8)
        self.values_m = np.full(shape, reach_m, dtype=np.float32)
        """(rows, cols) [m]."""

    def recompute(self, layers: CostmapLayers) -> None:
        """Measure all distances."""
        compose_into(self._is_occupied, layers, (0, 0), self._unknown_blocks)
        self.values_m = distance_transform(self._is_occupied, self._resolution_m, self._reach_m)

    def update(self, layers: CostmapLayers, dirty: tuple[int, int, int, int]) -> NDArray[np.int64]:
        """Bring the distances up to date after a box of the layers changed.

        Args:
            layers: what can block a cell.
            dirty: first and last row, first and last column of the box.

        Returns:
            (n, 4) boxes in which distances may have changed: first and end row, first and end
            column.
        """
        first_row, last_row, first_col, last_col = dirty
        shape, first = (last_row + 1 - first_row, last_col + 1 - first_col), (first_row, first_col)
        is_occupied = np.empty(shape, dtype=np.uint8)
        compose_into(is_occupied, layers, first, self._unknown_blocks)
        flipped = replace_mask(self._is_occupied, is_occupied, first)
        edge_m, reach_m = self._resolution_m, self._reach_m
        if len(flipped) <= DISTANCE_FIELD.most_flipped:
            return update_distances(self.values_m, self._is_occupied, flipped, edge_m, reach_m)
        # Distances change within reach of what changed.
        reach, (rows, cols) = math.ceil(reach_m / edge_m), self.values_m.shape
        low, high = flipped.min(axis=0) - reach, flipped.max(axis=0) + reach + 1
        box = np.array([max(low[0], 0), min(high[0], rows), max(low[1], 0), min(high[1], cols)])
        measure_box(self.values_m, self._is_occupied, box, reach, edge_m, reach_m)
        return box[None]
