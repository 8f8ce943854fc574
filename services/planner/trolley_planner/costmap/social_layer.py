"""The costmap layer of people: where they walk, and are about to walk.

A walking person is no obstacle of the costmap: they will be elsewhere when the robot comes. The
floor ahead of them is expensive, so that paths lead behind them, but never closed.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel
from trolley_planner.costmap.inflation import WEIGHT_UNIT
from trolley_planner.costmap.obstacle_grid import ObstacleGrid, mark_dirty
from trolley_planner.people.tracker import TrackedPerson


@dataclass(frozen=True, slots=True)
class SocialLayerParams:
    """Cost of crossing in front of people; all by hand."""

    ahead_s: float = 1.5
    """A person's path matters for this long."""
    body_m: float = 0.25
    """Half the width of a person, who is seen from one side."""
    price: float = 4.0
    """Cost of a metre right in front of a person, where a metre of free floor costs 1."""


SOCIAL = SocialLayerParams()


class SocialLayer:
    """Weights of where people are about to walk.

    Args:
        shape: rows and columns.
        resolution_m: cell edge [m].
        keep_m: distance from the robot's centre at which they touch.
    """

    def __init__(self, shape: tuple[int, int], resolution_m: float, keep_m: float) -> None:
        self._scale = 1.0 / resolution_m
        self._reach_cells = 2.0 * (keep_m + SOCIAL.body_m) * self._scale
        self._boxes: list[tuple[int, int, int, int]] = []
        """First and last row, first and last column of each person's weights."""
        self._changed: list[tuple[int, int, int, int]] = []
        self.weights = np.zeros(shape, dtype=np.uint8)
        """(rows, cols) the least weight (units: `WEIGHT_UNIT`), 0 = nobody walks."""

    def update(self, people: Sequence[TrackedPerson], grid: ObstacleGrid) -> None:
        """Replace the people of the last scan by those of the newest.

        Args:
            people: in `grid`.
            grid: its box of changes is extended.
        """
        before = self._boxes
        for first_row, last_row, first_col, last_col in before:
            self.weights[first_row : last_row + 1, first_col : last_col + 1] = 0
        self._boxes = [self._spread(person) for person in people]
        for first_row, last_row, first_col, last_col in before + self._boxes:
            if first_row <= last_row and first_col <= last_col:
                mark_dirty(grid.dirty, first_row, first_col)
                mark_dirty(grid.dirty, last_row, last_col)
                self._changed.append((first_row, last_row + 1, first_col, last_col + 1))

    @property
    def is_anyone_walking(self) -> bool:
        """Whether there are weights of anybody."""
        return bool(self._boxes)

    def pop_changed(self) -> list[tuple[int, int, int, int]]:
        """Return first and end row, first and end column of what changed since the last call."""
        changed, self._changed = self._changed, []
        return changed

    def _spread(self, person: TrackedPerson) -> tuple[int, int, int, int]:
        """Raise the weights ahead of a person; return the box of changed cells."""
        start = person.points.mean(axis=0)
        end = start + SOCIAL.ahead_s * person.velocity
        cells = self._scale * np.concatenate([start, end])
        walk = float(cells[0]), float(cells[1]), float(cells[2]), float(cells[3])
        return spread_walk(
            self.weights, walk, self._reach_cells, WEIGHT_UNIT * (1.0 + SOCIAL.price)
        )


@kernel
def spread_walk(
    weights: NDArray[np.uint8],
    walk_cells: tuple[float, float, float, float],
    reach_cells: float,
    highest: float,
) -> tuple[int, int, int, int]:
    """Raise the weights near a line, the less the farther along it and the farther from it.

    Args:
        weights: (rows, cols), changed in place, never lowered.
        walk_cells: x, y where somebody is, and where they will be [cells].
        reach_cells: how far beside the line weights are raised [cells].
        highest: weight where somebody is.

    Returns:
        First and last row, first and last column that may have changed; last < first for none.

    Source:
        Lu, Hershberger, Smart, Layered Costmaps for Context-Sensitive Navigation (2014), the
        social layer: a cost stretched along the motion; here linear, not Gaussian.
    """
    rows, cols = weights.shape
    x1, y1, x2, y2 = walk_cells
    dx, dy = x2 - x1, y2 - y1
    squared = dx * dx + dy * dy
    first_row = max(0, math.floor(min(y1, y2) - reach_cells))
    last_row = min(rows - 1, math.floor(max(y1, y2) + reach_cells))
    first_col = max(0, math.floor(min(x1, x2) - reach_cells))
    last_col = min(cols - 1, math.floor(max(x1, x2) + reach_cells))
    for row in range(first_row, last_row + 1):
        for col in range(first_col, last_col + 1):
            x, y = col + 0.5 - x1, row + 0.5 - y1
            along = (x * dx + y * dy) / squared if squared > 0.0 else 0.0
            along = min(max(along, 0.0), 1.0)
            away = math.hypot(x - along * dx, y - along * dy)
            if away < reach_cells:
                weight = highest * (1.0 - 0.7 * along) * (1.0 - away / reach_cells)
                weights[row, col] = max(int(weights[row, col]), math.floor(weight))
    return first_row, last_row, first_col, last_col
