"""Connected components of the floor."""

import math

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.jit import kernel


def cells_around(
    shape: tuple[int, int], resolution_m: float, pose_grid: Pose2D, reach_m: float
) -> tuple[slice, slice]:
    """Return the rows and columns of a grid that lie within a distance along both axes."""
    half = math.ceil(reach_m / resolution_m)
    at_row, at_col = (math.floor(at / resolution_m) for at in (pose_grid.y, pose_grid.x))
    return (
        slice(max(at_row - half, 0), min(at_row + half + 1, shape[0])),
        slice(max(at_col - half, 0), min(at_col + half + 1, shape[1])),
    )


def components_of(mask: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Return the component of each cell (rows, cols), 1 to n; 0 outside the mask."""
    labels = np.empty(mask.shape, dtype=np.int32)
    label_components(labels, mask, mask)
    return labels


@kernel
def label_components(
    out_labels: NDArray[np.int32], wide: NDArray[np.bool_], free: NDArray[np.bool_]
) -> int:
    """Number the connected components of the floor; other cells join the nearest one.

    Args:
        out_labels: (rows, cols), overwritten: 1 to n, 0 where nothing is free.
        wide: (rows, cols) cells of the parts.
        free: (rows, cols) cells over which they spread, those of `wide` included.

    Returns:
        How many parts there are.
    """
    rows, cols = wide.shape
    out_labels[:, :] = 0
    queue = np.empty(rows * cols, dtype=np.int32)
    known, parts = 0, 0
    # Each part in turn; all of its cells stay in the queue, from which the spreading begins.
    for first in range(rows * cols):
        if not wide[first // cols, first % cols] or out_labels[first // cols, first % cols] != 0:
            continue
        parts += 1
        out_labels[first // cols, first % cols] = parts
        queue[known] = first
        taken, known = known, known + 1
        while taken < known:
            known = _spread(out_labels, wide, queue, taken, known)
            taken += 1
    taken = 0
    while taken < known:
        known = _spread(out_labels, free, queue, taken, known)
        taken += 1
    return parts


@kernel
def _spread(
    labels: NDArray[np.int32],
    mask: NDArray[np.bool_],
    queue: NDArray[np.int32],
    taken: int,
    known: int,
) -> int:
    """Give a cell's label to its neighbours; return the new length of the queue."""
    rows, cols = labels.shape
    row, col = queue[taken] // cols, queue[taken] % cols
    for side in range(4):
        r = row + (side == 0) - (side == 1)
        c = col + (side == 2) - (side == 3)
        if r < 0 or c < 0 or r >= rows or c >= cols or labels[r, c] != 0 or not mask[r, c]:
            continue
        labels[r, c] = labels[row, col]
        queue[known] = r * cols + c
        known += 1
    return known
