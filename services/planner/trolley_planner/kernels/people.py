"""Compiled loop that puts the way of somebody who walks into the costmap."""

import math

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel


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
        layer of people: a price that is stretched along the motion; here linear, not Gaussian.
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
