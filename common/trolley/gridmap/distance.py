"""Distances and rays on grids, checked and typed over the compiled loops.

Importing this module imports numba.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trolley.gridmap.kernels import (
    cast_rays_into,
    column_distances_into,
    distance_transform_into,
)


def _as_mask(mask: NDArray[np.bool_] | NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a grid as contiguous uint8, as the kernels were compiled for.

    Raises:
        ValueError: not two-dimensional, or no cells.
    """
    if mask.ndim != 2 or mask.size == 0:
        raise ValueError(f"a grid needs rows and columns, not shape {mask.shape}")
    plain = np.ascontiguousarray(mask).view(np.uint8) if mask.dtype == np.bool_ else mask
    # Read-only arrays (views of messages) would each compile a second version of the kernel.
    return np.require(plain, dtype=np.uint8, requirements=["C", "W"])


def distance_transform(
    mask: NDArray[np.bool_] | NDArray[np.uint8],
    resolution: float,
    max_distance: float = math.inf,
) -> NDArray[np.float32]:
    """Return the exact Euclidean distance from each cell to the nearest set cell.

    Args:
        mask: (rows, cols), set where not 0.
        resolution: cell edge [m], > 0.
        max_distance: longer distances are cut off here [m]; a small one saves time.

    Returns:
        (rows, cols) [m] between the centres of cells, 0 in a set cell; `max_distance`
        (infinite by default) everywhere if no cell is set.

    Raises:
        ValueError: no cells, or a length that is not positive.
    """
    if not (resolution > 0.0 and max_distance > 0.0):
        raise ValueError(f"lengths must be positive, not {resolution} and {max_distance}")
    plain = _as_mask(mask)
    column_cells = np.empty(plain.shape, dtype=np.int32)
    out_m = np.empty(plain.shape, dtype=np.float32)
    column_distances_into(column_cells, plain)
    distance_transform_into(out_m, column_cells, float(resolution), float(max_distance))
    return out_m


def cast_rays(
    occupied: NDArray[np.bool_] | NDArray[np.uint8],
    resolution: float,
    start_grid: tuple[float, float],
    angles_grid: NDArray[np.floating[Any]],
    max_range: float,
) -> NDArray[np.float32]:
    """Return how far rays run before they enter an occupied cell.

    Args:
        occupied: (rows, cols), set where not 0.
        resolution: cell edge [m], > 0.
        start_grid: x, y in frame `grid` [m]; may lie outside the grid.
        angles_grid: (n,) directions in frame `grid` [rad], counter-clockwise from +x.
        max_range: farther hits do not count [m].

    Returns:
        (n,) [m] to the border of the cell that was hit, 0 from inside an occupied cell, +inf
        where nothing is hit.

    Raises:
        ValueError: no cells, or a length that is not positive.
    """
    if not (resolution > 0.0 and max_range > 0.0):
        raise ValueError(f"lengths must be positive, not {resolution} and {max_range}")
    angles = np.require(angles_grid, dtype=np.float64, requirements=["C", "W"])
    out_m = np.empty(angles.shape[0], dtype=np.float32)
    x, y = float(start_grid[0]), float(start_grid[1])
    cast_rays_into(out_m, _as_mask(occupied), float(resolution), x, y, angles, float(max_range))
    return out_m
