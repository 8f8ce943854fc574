"""Inflation: which cells are blocked, and the weights of passing near them.

Row-major cells; a box of cells is (first row, first column) and the shape of the output.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.gridmap.kernels import disc_box, is_in_disc
from trolley.jit import kernel

FREE, UNKNOWN, WALL = 0, 1, 2
"""Kinds of cells of the map."""
WEIGHT_UNIT = 4
"""A weight of 1 (a free cell, far from everything) in the units of the grids of weights."""
LETHAL = 0
"""The weight of cells where the footprint's centre must not be."""


class CostmapLayers(NamedTuple):
    """What can block a cell."""

    kinds: NDArray[np.uint8]
    """(rows, cols) FREE, UNKNOWN or WALL of the map."""
    keepout: NDArray[np.uint8]
    """(rows, cols) 1 in keep-out zones, but those that the robot is leaving."""
    closed: NDArray[np.uint8]
    """(rows, cols) 1 where the robot did not get through."""
    evidence: NDArray[np.uint8]
    """(rows, cols) of obstacles seen, 0 = none."""
    observed: NDArray[np.int32]
    """(rows, cols) 0 where no beam has passed; the others are not unknown any more."""


def inflation_table(
    inscribed_m: float, falloff_m: float, height: float, step_m: float, weight_unit: int
) -> NDArray[np.uint8]:
    """Return the weight by distance to the nearest obstacle's surface.

    0 (lethal) nearer than `inscribed_m`, then 1 + height * exp(-(d - inscribed) / falloff).

    Args:
        inscribed_m: where the footprint touches whatever its heading [m].
        falloff_m: distance over which the extra cost falls to 1/e [m].
        height: extra cost at the inscribed distance, in weights of a free cell.
        step_m: distance between two entries [m].
        weight_unit: weight of a free cell.
    """
    count = math.ceil((inscribed_m + 5.0 * falloff_m) / step_m) + 1
    distance = np.arange(count) * step_m
    extra = height * np.exp(-(distance - inscribed_m) / falloff_m)
    # The extra cost ends at zero where the table ends, so that open space is really free.
    extra = np.maximum(extra - extra[-1], 0.0)
    weights = np.rint(weight_unit * (1.0 + extra))
    weights[distance < inscribed_m] = 0
    return np.clip(weights, 0, 255).astype(np.uint8)


@kernel
def compose_into(
    out_mask: NDArray[np.uint8], layers: CostmapLayers, first: tuple[int, int], unknown_blocks: bool
) -> None:
    """Write 1 where something stands in a cell, over a box of cells."""
    # Bound to names once: looked up for each cell they made the loop 50 times slower.
    kinds, keepout, closed = layers.kinds, layers.keepout, layers.closed
    evidence, observed = layers.evidence, layers.observed
    for row in range(out_mask.shape[0]):
        for col in range(out_mask.shape[1]):
            cell = first[0] + row, first[1] + col
            kind = kinds[cell]
            blocked = (
                kind == WALL
                or keepout[cell] != 0
                or closed[cell] != 0
                or evidence[cell] != 0
                or (unknown_blocks and kind == UNKNOWN and observed[cell] == 0)
            )
            out_mask[row, col] = 1 if blocked else 0


@kernel
def weigh_into(
    out_weights: NDArray[np.uint8],
    distance_m: NDArray[np.float32],
    table: NDArray[np.uint8],
    step_m: float,
) -> None:
    """Write the weight of each cell by its distance to the nearest obstacle.

    Args:
        out_weights: (rows, cols), overwritten.
        distance_m: (rows, cols).
        table: (n,) weight at distance index * `step_m`; the last holds beyond.
        step_m: [m].
    """
    last = table.shape[0] - 1
    for row in range(out_weights.shape[0]):
        for col in range(out_weights.shape[1]):
            index = math.floor(distance_m[row, col] / step_m)
            out_weights[row, col] = table[min(max(index, 0), last)]


@kernel
def soften_disc(
    weights: NDArray[np.uint8],
    distance_m: NDArray[np.float32],
    centre_cells: tuple[float, float],
    radius_cells: float,
    weight: int,
) -> None:
    """Make lethal cells within a circle passable at a cost, except where something stands.

    A robot that stands too close to something (an error of the pose, somebody who came near)
    must still find a way out.

    Args:
        weights: (rows, cols), changed in place.
        distance_m: (rows, cols) to the nearest obstacle.
        centre_cells: x, y [cells].
        radius_cells: of the circle.
        weight: that they get.
    """
    rows, cols = weights.shape
    x, y = centre_cells
    top, left, bottom, right = disc_box(x, y, radius_cells, rows, cols)
    for row in range(max(1, top), min(rows - 1, bottom)):
        for col in range(max(1, left), min(cols - 1, right)):
            near = is_in_disc(row, col, x, y, radius_cells)
            if near and weights[row, col] == LETHAL and distance_m[row, col] > 0.0:
                weights[row, col] = weight


@kernel
def close_disc(
    weights: NDArray[np.uint8], centre_cells: tuple[float, float], radius_cells: float
) -> None:
    """Make all cells within a circle lethal.

    Args:
        weights: (rows, cols), changed in place.
        centre_cells: x, y [cells].
        radius_cells: of the circle.
    """
    rows, cols = weights.shape
    x, y = centre_cells
    top, left, bottom, right = disc_box(x, y, radius_cells, rows, cols)
    for row in range(top, bottom):
        for col in range(left, right):
            if is_in_disc(row, col, x, y, radius_cells):
                weights[row, col] = LETHAL
