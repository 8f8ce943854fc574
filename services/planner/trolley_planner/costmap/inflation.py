"""Inflation: which cells are blocked, and the weights of passing near them.

Row-major cells; a box of cells is (first row, first column) and the shape of the output.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.gridmap.kernels import (
    column_distances_into,
    disc_box,
    distance_transform_into,
    is_in_disc,
)
from trolley.jit import kernel

FREE, UNKNOWN, WALL = 0, 1, 2
"""Kinds of cells of the map."""
WEIGHT_UNIT = 4
"""A weight of 1 (a free cell, far from everything) in the units of the grids of weights."""
TABLE_STEP_M = 0.005
"""Distance between two entries of an inflation table."""
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
    """Write 1 in each occupied cell of a box."""
    # Bound to names once: looked up for each cell they made the loop 50 times slower.
    kinds, keepout, closed = layers.kinds, layers.keepout, layers.closed
    evidence, observed = layers.evidence, layers.observed
    for out_row in range(out_mask.shape[0]):
        row, cols = first[0] + out_row, slice(first[1], first[1] + out_mask.shape[1])
        merge_row(
            out_mask[out_row],
            kinds[row, cols],
            evidence[row, cols],
            keepout[row, cols],
            closed[row, cols],
        )
        if unknown_blocks:
            merge_unknown(out_mask[out_row], kinds[row, cols], observed[row, cols])


@kernel
def merge_row(
    out_mask: NDArray[np.uint8],
    kinds: NDArray[np.uint8],
    evidence: NDArray[np.uint8],
    keepout: NDArray[np.uint8],
    closed: NDArray[np.uint8],
) -> None:
    """Write 1 in each occupied cell of a row; without branches, so that it vectorizes."""
    for col in range(out_mask.shape[0]):
        is_occupied = np.uint8(kinds[col] == WALL) | np.uint8(evidence[col] != 0)
        out_mask[col] = is_occupied | np.uint8(keepout[col] != 0) | np.uint8(closed[col] != 0)


@kernel
def merge_unknown(
    mask: NDArray[np.uint8], kinds: NDArray[np.uint8], observed: NDArray[np.int32]
) -> None:
    """Set 1 in each unknown cell of a row."""
    for col in range(mask.shape[0]):
        mask[col] |= np.uint8(kinds[col] == UNKNOWN) & np.uint8(observed[col] == 0)


@kernel
def replace_mask(
    mask: NDArray[np.uint8], new_mask: NDArray[np.uint8], first: tuple[int, int]
) -> NDArray[np.int64]:
    """Write a new mask over a box of an old one; return the cells (n, 2) that differ.

    Args:
        mask: (rows, cols), changed in place.
        new_mask: of the box.
        first: its first row and column.
    """
    flipped = np.empty((new_mask.size, 2), np.int64)
    count, cols = 0, slice(first[1], first[1] + new_mask.shape[1])
    for new_row in range(new_mask.shape[0]):
        row = first[0] + new_row
        if count_different(mask[row, cols], new_mask[new_row]) == 0:
            continue
        for new_col in range(new_mask.shape[1]):
            if mask[row, first[1] + new_col] != new_mask[new_row, new_col]:
                mask[row, first[1] + new_col] = new_mask[new_row, new_col]
                flipped[count, 0], flipped[count, 1] = row, first[1] + new_col
                count += 1
    return flipped[:count].copy()


@kernel
def count_different(one: NDArray[np.uint8], other: NDArray[np.uint8]) -> int:
    """Return how many values of two arrays (n,) differ; without branches, so that it vectorizes."""
    count = 0
    for index in range(one.shape[0]):
        count += 1 if one[index] != other[index] else 0
    return count


@kernel
def update_distances(
    distance_m: NDArray[np.float32],
    mask: NDArray[np.uint8],
    flipped: NDArray[np.int64],
    resolution_m: float,
    limit_m: float,
) -> NDArray[np.int64]:
    """Bring the distances to the nearest set cell up to date after some cells were set or cleared.

    Around one that was set, distances are at most those to it. Where one that was cleared was the
    nearest, they are recomputed, in the box that holds all these cells.

    Args:
        distance_m: (rows, cols) as `distance_transform_into` wrote it; changed in place.
        mask: (rows, cols) set where not 0.
        flipped: (n, 2) row and column of cells that are not as they were then.
        resolution_m: cell edge [m].
        limit_m: as given there.

    Returns:
        (n, 4) for each of them first and end row, first and end column of what may have changed.
    """
    rows, cols = mask.shape
    reach = math.ceil(limit_m / resolution_m)
    limit, scale = np.float32(limit_m), np.float32(resolution_m)
    boxes = np.zeros((flipped.shape[0], 4), np.int64)
    for was_cleared in (True, False):
        for index in range(flipped.shape[0]):
            row, col = flipped[index, 0], flipped[index, 1]
            if (mask[row, col] == 0) != was_cleared:
                continue
            box = boxes[index]
            box[0], box[1], box[2], box[3] = rows, 0, cols, 0
            for near_row in range(max(row - reach, 0), min(row + reach + 1, rows)):
                height = np.float32((near_row - row) * (near_row - row))
                for near_col in range(max(col - reach, 0), min(col + reach + 1, cols)):
                    beside = np.float32(near_col - col)
                    here = min(scale * np.sqrt(beside * beside + height), limit)
                    known = distance_m[near_row, near_col]
                    if (known != here) if was_cleared else (known <= here):
                        continue
                    if not was_cleared:
                        distance_m[near_row, near_col] = here
                    elif known == limit:
                        continue
                    box[0], box[1] = min(box[0], near_row), max(box[1], near_row + 1)
                    box[2], box[3] = min(box[2], near_col), max(box[3], near_col + 1)
            if was_cleared and box[0] < box[1]:
                measure_box(distance_m, mask, box, reach, resolution_m, limit_m)
    return boxes


@kernel
def measure_box(
    distance_m: NDArray[np.float32],
    mask: NDArray[np.uint8],
    box: NDArray[np.int64],
    reach: int,
    resolution_m: float,
    limit_m: float,
) -> None:
    """Write the distances to the nearest set cell in a box of cells.

    Args:
        distance_m: (rows, cols), changed in the box.
        mask: (rows, cols) set where not 0.
        box: (4,) first and end row, first and end column.
        reach: cells farther away do not count.
        resolution_m: cell edge [m].
        limit_m: longer distances are cut off here [m].
    """
    first_row, first_col = max(box[0] - reach, 0), max(box[2] - reach, 0)
    around = mask[
        first_row : min(box[1] + reach, mask.shape[0]),
        first_col : min(box[3] + reach, mask.shape[1]),
    ].copy()
    columns = np.empty(around.shape, np.int32)
    found = np.empty(around.shape, np.float32)
    column_distances_into(columns, around)
    top, left = box[0] - first_row, box[2] - first_col
    wanted = columns[top : top + box[1] - box[0]]
    distance_transform_into(found[: wanted.shape[0]], wanted, resolution_m, limit_m)
    distance_m[box[0] : box[1], box[2] : box[3]] = found[
        : wanted.shape[0], left : left + box[3] - box[2]
    ]


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
def weigh_boxes(
    weights: NDArray[np.uint8],
    distance_m: NDArray[np.float32],
    table: NDArray[np.uint8],
    step_m: float,
    boxes: NDArray[np.int64],
) -> None:
    """Write the weights in boxes (n, 4): first and end row, first and end column.

    See `weigh_into`; the outermost cells of the grid are lethal.
    """
    rows, cols = weights.shape
    for index in range(boxes.shape[0]):
        row, end_row = max(boxes[index, 0], 1), min(boxes[index, 1], rows - 1)
        col, end_col = max(boxes[index, 2], 1), min(boxes[index, 3], cols - 1)
        if row < end_row and col < end_col:
            box = slice(row, end_row), slice(col, end_col)
            weigh_into(weights[box], distance_m[box], table, step_m)


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
