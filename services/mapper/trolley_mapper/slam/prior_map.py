"""A map that was made before, as one large keyframe that never moves."""

import numpy as np
from numpy.typing import NDArray

from trolley.gridmap import GridMap
from trolley_mapper.slam.keyframe import Keyframe
from trolley_mapper.slam.occupancy_grid import prior_walls

WINDOW_CELLS = 3
"""Distance within which walls show which way a surface faces [cells]."""
FREE_EVERY = 2
"""Number of free cells along each axis of which one is kept."""


def prior_keyframe(number: int, grid: GridMap) -> Keyframe:
    """Return the surfaces and the free floor of a map; its pose is the map frame itself."""
    walls = prior_walls(grid.cells)
    free = (grid.cells >= 0) & ~walls
    rows, cols = np.nonzero(walls & _beside(free))
    normals_grid = _normals(rows, cols, walls & _beside(free), free)
    points = grid.cell_to_world(np.column_stack([rows, cols]))
    turn = np.array(
        [
            [np.cos(grid.origin.yaw), -np.sin(grid.origin.yaw)],
            [np.sin(grid.origin.yaw), np.cos(grid.origin.yaw)],
        ]
    )
    thin = np.zeros_like(free)
    thin[::FREE_EVERY, ::FREE_EVERY] = True
    floor = np.column_stack(np.nonzero(free & ~_beside(walls) & thin))
    return Keyframe(
        number,
        0,
        points.astype(np.float32),
        (normals_grid @ turn.T).astype(np.float32),
        np.zeros(2, np.float32),
        grid.cell_to_world(floor).astype(np.float32),
    )


def _beside(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the cells that have a set one beside, below or above them."""
    found = np.zeros_like(mask)
    found[1:] |= mask[:-1]
    found[:-1] |= mask[1:]
    found[:, 1:] |= mask[:, :-1]
    found[:, :-1] |= mask[:, 1:]
    return found


def _normals(
    rows: NDArray[np.int64],
    cols: NDArray[np.int64],
    edge: NDArray[np.bool_],
    free: NDArray[np.bool_],
) -> NDArray[np.float64]:
    """Return unit normals (n, 2) x, y of wall cells towards free ones; zero where unclear."""
    size = WINDOW_CELLS
    padded_edge, padded_free = np.pad(edge, size), np.pad(free, size)
    sums = np.zeros((6, len(rows)))
    towards = np.zeros((len(rows), 2))
    for dy in range(-size, size + 1):
        for dx in range(-size, size + 1):
            at = (rows + size + dy, cols + size + dx)
            is_edge = padded_edge[at]
            sums += is_edge * np.array([1, dx, dy, dx * dx, dx * dy, dy * dy])[:, None]
            towards += padded_free[at][:, None] * np.array([dx, dy])
    count = np.maximum(sums[0], 1)
    mean_x, mean_y = sums[1] / count, sums[2] / count
    xx, xy, yy = (
        sums[3] / count - mean_x**2,
        sums[4] / count - mean_x * mean_y,
        (sums[5] / count - mean_y**2),
    )
    along = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    normals = np.column_stack([-np.sin(along), np.cos(along)])
    normals *= np.sign(np.sum(normals * towards, axis=1))[:, None]
    half, root = 0.5 * (xx + yy), np.sqrt(0.25 * (xx - yy) ** 2 + xy**2)
    is_line = (sums[0] >= 3) & (half + root >= 4.0 * (half - root))
    return normals * is_line[:, None]
