"""The cells in which a path is searched: those of some tiles, with weights and costs."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel, lean_kernel
from trolley_planner.costmap.inflation import LETHAL
from trolley_planner.paths.search import COSTLIEST_STEP, UNREACHED, Queue, clear_queue, push

TILE = 4
"""Cells in the edge of a tile."""


class Corridor(NamedTuple):
    """Cells that a search may use; outside all weights are lethal."""

    tiles: NDArray[np.int32]
    """(tiles,) those inside, from index 0."""
    is_inside: NDArray[np.uint8]
    """(tile rows, tile cols) 1 inside."""
    weights: NDArray[np.uint8]
    """(rows, cols), 0 outside."""
    cost: NDArray[np.int32]
    """(rows, cols) cost-to-go; without meaning outside."""


class Terrain(NamedTuple):
    """The inputs from which the weights in a corridor are computed."""

    weights: NDArray[np.uint8]
    """(rows, cols)."""
    distance_m: NDArray[np.float32]
    """(rows, cols) to the nearest obstacle."""
    discs: NDArray[np.float64]
    """(n, 3) x, y, radius [cells]: lethal cells within them that hold no obstacle are passable."""
    price: int
    """Weight of the lethal cells that are passable within `discs`."""


@lean_kernel
def tile_of(cell: int, cols: int, tile_cols: int) -> int:
    """Return the tile that a cell lies in."""
    return (cell // cols // TILE + 1) * tile_cols + cell % cols // TILE + 1


@lean_kernel
def weight_at(terrain: Terrain, row: int, col: int) -> int:
    """Return the weight of a cell of the corridor."""
    weight = terrain.weights[row, col]
    if weight != LETHAL or terrain.distance_m[row, col] <= 0.0:
        return weight
    rows, cols = terrain.weights.shape
    if row == 0 or col == 0 or row == rows - 1 or col == cols - 1:
        return weight
    for index in range(terrain.discs.shape[0]):
        x, y, radius = terrain.discs[index, 0], terrain.discs[index, 1], terrain.discs[index, 2]
        if math.hypot(col + 0.5 - x, row + 0.5 - y) <= radius:
            return terrain.price
    return weight


@lean_kernel
def load_tile(corridor: Corridor, terrain: Terrain, tile_row: int, tile_col: int) -> int:
    """Bring the weights of a tile of the corridor up to date.

    Returns:
        All costs below this are still right: the least cost-to-go of a cell that has changed or
        lies beside one that has.
    """
    weights, known, cost = terrain.weights, corridor.weights, corridor.cost
    rows, cols = weights.shape
    least = UNREACHED
    for row in range((tile_row - 1) * TILE, min(tile_row * TILE, rows)):
        for col in range((tile_col - 1) * TILE, min(tile_col * TILE, cols)):
            weight = int(weights[row, col])
            if weight == LETHAL:
                weight = weight_at(terrain, row, col)
            if weight == known[row, col]:
                continue
            known[row, col] = weight
            for beside_row in range(row - 1, row + 2):
                for beside_col in range(col - 1, col + 2):
                    if known[beside_row, beside_col] != LETHAL:
                        least = min(least, cost[beside_row, beside_col])
    return least


@kernel
def open_box(
    corridor: Corridor, num_tiles: int, terrain: Terrain, box: tuple[int, int, int, int]
) -> tuple[int, int]:
    """Add all tiles of a box to the corridor, and update those that are in it.

    Args:
        corridor: changed.
        num_tiles: how many are inside so far.
        terrain: what it is made of.
        box: first and last row, first and last column [tiles]; may reach beyond the grid.

    Returns:
        How many are inside now, and up to which cost all costs are still right.
    """
    tile_rows, tile_cols = corridor.is_inside.shape
    rows, cols = corridor.weights.shape
    least = UNREACHED
    for tile_row in range(max(box[0], 1), min(box[1], tile_rows - 2) + 1):
        for tile_col in range(max(box[2], 1), min(box[3], tile_cols - 2) + 1):
            if corridor.is_inside[tile_row, tile_col] == 0:
                corridor.is_inside[tile_row, tile_col] = 1
                corridor.tiles[num_tiles] = tile_row * tile_cols + tile_col
                num_tiles += 1
                for row in range((tile_row - 1) * TILE, min(tile_row * TILE, rows)):
                    for col in range((tile_col - 1) * TILE, min(tile_col * TILE, cols)):
                        corridor.cost[row, col] = UNREACHED
            least = min(least, load_tile(corridor, terrain, tile_row, tile_col))
    return num_tiles, least


@kernel
def open_discs(corridor: Corridor, num_tiles: int, terrain: Terrain) -> tuple[int, int]:
    """Add all tiles under the discs to the corridor, and update those that are in it.

    Returns:
        How many are inside now, and up to which cost all costs are still right.
    """
    right = UNREACHED
    for index in range(terrain.discs.shape[0]):
        x, y, radius = terrain.discs[index, 0], terrain.discs[index, 1], terrain.discs[index, 2]
        box = (
            math.floor(y - radius) // TILE + 1,
            math.floor(y + radius) // TILE + 1,
            math.floor(x - radius) // TILE + 1,
            math.floor(x + radius) // TILE + 1,
        )
        num_tiles, least = open_box(corridor, num_tiles, terrain, box)
        right = min(right, least)
    return num_tiles, right


@kernel
def open_path(
    corridor: Corridor,
    num_tiles: int,
    weights: NDArray[np.uint8],
    cheapest_path: NDArray[np.int32],
    reach: int,
) -> int:
    """Add tiles and those at most `reach` from them to the corridor.

    The tiles under the discs must be inside. With a reach of 1 only those with an edge in common
    are added: with them a diagonal path is wide enough.

    Returns:
        How many are inside now.
    """
    tile_cols = corridor.is_inside.shape[1]
    rows, cols = corridor.weights.shape
    for tile in cheapest_path:
        row, col = tile // tile_cols, tile % tile_cols
        for near_row in range(row - reach, row + reach + 1):
            for near_col in range(col - reach, col + reach + 1):
                if reach == 1 and near_row != row and near_col != col:
                    continue
                # The rim of the grid of tiles is never part of a path, but may lie beside one.
                if not (0 < near_row < corridor.is_inside.shape[0] - 1):
                    continue
                if not (0 < near_col < tile_cols - 1) or corridor.is_inside[near_row, near_col]:
                    continue
                corridor.is_inside[near_row, near_col] = 1
                corridor.tiles[num_tiles] = near_row * tile_cols + near_col
                num_tiles += 1
                for cell_row in range((near_row - 1) * TILE, min(near_row * TILE, rows)):
                    for cell_col in range((near_col - 1) * TILE, min(near_col * TILE, cols)):
                        corridor.cost[cell_row, cell_col] = UNREACHED
                        corridor.weights[cell_row, cell_col] = weights[cell_row, cell_col]
    return num_tiles


@kernel
def reload(corridor: Corridor, num_tiles: int, terrain: Terrain) -> int:
    """Bring all weights of the corridor up to date; return up to which cost all are still right."""
    tile_cols = corridor.is_inside.shape[1]
    least = UNREACHED
    for index in range(num_tiles):
        tile = corridor.tiles[index]
        least = min(least, load_tile(corridor, terrain, tile // tile_cols, tile % tile_cols))
    return least


@kernel
def rewind(corridor: Corridor, num_tiles: int, queue: Queue, until: int) -> None:
    """Forget all costs above `until`, and queue the cells from which the search goes on."""
    clear_queue(queue)
    tile_cols = corridor.is_inside.shape[1]
    rows, cols = corridor.weights.shape
    flat = corridor.cost.reshape(-1)
    for index in range(num_tiles):
        tile_row = corridor.tiles[index] // tile_cols
        tile_col = corridor.tiles[index] % tile_cols
        for row in range((tile_row - 1) * TILE, min(tile_row * TILE, rows)):
            for col in range((tile_col - 1) * TILE, min(tile_col * TILE, cols)):
                cost = corridor.cost[row, col]
                if cost > until - COSTLIEST_STEP:
                    corridor.cost[row, col] = UNREACHED
                    if cost <= until and corridor.weights[row, col] != LETHAL:
                        push(queue, flat, row * cols + col, cost)


@kernel
def close(corridor: Corridor, num_tiles: int) -> None:
    """Remove all tiles from the corridor."""
    tile_cols = corridor.is_inside.shape[1]
    rows, cols = corridor.weights.shape
    for index in range(num_tiles):
        tile_row = corridor.tiles[index] // tile_cols
        tile_col = corridor.tiles[index] % tile_cols
        corridor.is_inside[tile_row, tile_col] = 0
        for row in range((tile_row - 1) * TILE, min(tile_row * TILE, rows)):
            for col in range((tile_col - 1) * TILE, min(tile_col * TILE, cols)):
                corridor.weights[row, col] = LETHAL
