"""How far points lie from the outline of the robot: a table. Frame `base_link`, SI.

The stop field asks 50 times a second for thousands of points.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import circumscribed_radius, distance_to_outline, polygon_contains

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class FootprintDistanceParams:
    """How fine the table is; set by hand."""

    cells: int = 128
    """Cells from the table's middle to each side; for a robot of 0.3 m that is 2 mm a cell."""
    rows_at_once: int = 16
    """Rows of the table computed at once: few enough to stay in the processor's cache."""


PARAMS = FootprintDistanceParams()


class FootprintDistance:
    """Signed distances from an outline, negative inside.

    Args:
        footprint: (n, 2) corners [m], counter-clockwise.
        reach: up to how far from it distances are asked for [m].
    """

    def __init__(self, footprint: Floats, reach: float) -> None:
        self.radius = circumscribed_radius(footprint)
        """Of the smallest circle about `base_link` that holds the outline [m]."""
        half = self.radius + reach
        self._cells_per_m = PARAMS.cells / half
        self._middle = PARAMS.cells + 1.0
        ticks = (np.arange(2 * PARAMS.cells + 3) - self._middle) / self._cells_per_m
        self._row = len(ticks)
        self._table = np.empty(self._row * self._row)
        for first in range(0, self._row, PARAMS.rows_at_once):
            rows = ticks[first : first + PARAMS.rows_at_once]
            points = np.empty((len(rows), self._row, 2))
            points[..., 0], points[..., 1] = ticks, rows[:, None]
            points = points.reshape(-1, 2)
            distance = distance_to_outline(footprint, points)
            distance[polygon_contains(footprint, points)] *= -1.0
            self._table[first * self._row :][: len(points)] = distance

    def at(self, x: Floats, y: Floats) -> Floats:
        """Return the distances (n,) [m] of points, none farther than `reach` from the circle."""
        col, row = x * self._cells_per_m + self._middle, y * self._cells_per_m + self._middle
        left, below = col.astype(np.intp), row.astype(np.intp)
        col -= left
        row -= below
        left += below * self._row
        table = self._table
        low = table[left]
        low += col * (table[left + 1] - low)
        left += self._row
        high = table[left]
        high += col * (table[left + 1] - high)
        return low + row * (high - low)
