"""Compiled loops over the tiles of a grid of weights: the coarse grid, and a corridor through it.

A tile is a square of `TILE` x `TILE` cells; the grid of tiles has a rim of lethal ones around it,
so that tile (row, col) holds the cells from (row - 1) * TILE and (col - 1) * TILE on.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel
from trolley_planner.kernels.layers import LETHAL
from trolley_planner.kernels.search import (
    COSTLIEST_STEP,
    DIAGONAL,
    STEP,
    UNREACHED,
    Queue,
    clear_queue,
    push,
)

TILE = 4


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
    """What the weights in a corridor are made of."""

    weights: NDArray[np.uint8]
    """(rows, cols)."""
    distance_m: NDArray[np.float32]
    """(rows, cols) to the nearest obstacle."""
    discs: NDArray[np.float64]
    """(n, 3) x, y, radius [cells]: within them lethal cells where nothing stands are passable,"""
    price: int
    """at this weight."""


@kernel
def coarsen_into(out_weights: NDArray[np.uint8], weights: NDArray[np.uint8]) -> None:
    """Write the lowest weight of each tile that is not lethal, 0 where all are.

    Args:
        out_weights: (tile rows, tile cols), overwritten.
        weights: (rows, cols).
    """
    rows, cols = weights.shape
    out_weights[:, :] = LETHAL
    lowest = np.empty(cols, dtype=np.uint8)
    for tile_row in range(1, out_weights.shape[0] - 1):
        # Less one, lethal is the highest of all; a loop without branches over whole rows.
        lowest[:] = 255
        for row in range((tile_row - 1) * TILE, min(tile_row * TILE, rows)):
            for col in range(cols):
                lowest[col] = min(lowest[col], np.uint8(weights[row, col] - np.uint8(1)))
        for tile_col in range(1, out_weights.shape[1] - 1):
            best = np.uint8(255)
            for col in range((tile_col - 1) * TILE, min(tile_col * TILE, cols)):
                best = min(best, lowest[col])
            out_weights[tile_row, tile_col] = np.uint8(best + np.uint8(1))


@kernel
def weight_at(terrain: Terrain, row: int, col: int) -> int:
    """Return what a cell of the corridor weighs."""
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


@kernel
def load_tile(corridor: Corridor, terrain: Terrain, tile_row: int, tile_col: int) -> int:
    """Bring the weights of a tile of the corridor up to date.

    Returns:
        All costs below this are still right: the least cost-to-go of a cell that has changed or
        lies beside one that has.
    """
    rows, cols = terrain.weights.shape
    least = UNREACHED
    for row in range((tile_row - 1) * TILE, min(tile_row * TILE, rows)):
        for col in range((tile_col - 1) * TILE, min(tile_col * TILE, cols)):
            weight = weight_at(terrain, row, col)
            if weight == corridor.weights[row, col]:
                continue
            corridor.weights[row, col] = weight
            for beside_row in range(row - 1, row + 2):
                for beside_col in range(col - 1, col + 2):
                    if corridor.weights[beside_row, beside_col] != LETHAL:
                        least = min(least, corridor.cost[beside_row, beside_col])
    return least


@kernel
def open_box(
    corridor: Corridor, num_tiles: int, terrain: Terrain, box: tuple[int, int, int, int]
) -> tuple[int, int]:
    """Take all tiles of a box into the corridor, and bring those that are in it up to date.

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
def open_way(
    corridor: Corridor,
    num_tiles: int,
    weights: NDArray[np.uint8],
    way: NDArray[np.int32],
    reach: int,
) -> int:
    """Take the tiles of a way and those at most `reach` from it into the corridor.

    No cost must be known yet, and the tiles under the discs be inside.

    Returns:
        How many are inside now.
    """
    tile_cols = corridor.is_inside.shape[1]
    rows, cols = corridor.weights.shape
    for tile in way:
        row, col = tile // tile_cols, tile % tile_cols
        for near_row in range(row - reach, row + reach + 1):
            for near_col in range(col - reach, col + reach + 1):
                # The rim of the grid of tiles is never part of a way, but may lie beside one.
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
    """Take all tiles out of the corridor."""
    tile_cols = corridor.is_inside.shape[1]
    rows, cols = corridor.weights.shape
    for index in range(num_tiles):
        tile_row = corridor.tiles[index] // tile_cols
        tile_col = corridor.tiles[index] % tile_cols
        corridor.is_inside[tile_row, tile_col] = 0
        for row in range((tile_row - 1) * TILE, min(tile_row * TILE, rows)):
            for col in range((tile_col - 1) * TILE, min(tile_col * TILE, cols)):
                corridor.weights[row, col] = LETHAL


@kernel
def has_opened(
    seen: NDArray[np.uint8], weights: NDArray[np.uint8], is_inside: NDArray[np.uint8]
) -> bool:
    """Say whether a cell outside the corridor has become cheaper.

    Args:
        seen: (rows, cols) as they were.
        weights: (rows, cols) as they are.
        is_inside: (tile rows, tile cols) of the corridor.
    """
    rows, cols = weights.shape
    for row in range(rows):
        tile_row = row // TILE + 1
        for first in range(0, cols, 64):
            last = min(first + 64, cols)
            cheaper = 0
            # Less one, lethal is the dearest of all; without branches it compares many at once.
            for col in range(first, last):
                is_cheaper = np.uint8(weights[row, col] - np.uint8(1)) < np.uint8(
                    seen[row, col] - np.uint8(1)
                )
                cheaper += is_cheaper
            if cheaper == 0:
                continue
            for col in range(first, last):
                weight, before = int(weights[row, col]), int(seen[row, col])
                is_cheaper = weight != LETHAL and (before == LETHAL or weight < before)
                if is_cheaper and is_inside[tile_row, col // TILE + 1] == 0:
                    return True
    return False


@kernel
def retile(out_weights: NDArray[np.uint8], corridor: Corridor, num_tiles: int) -> None:
    """Write the lowest weight of the tiles inside, which may differ from the grid's.

    Args:
        out_weights: (tile rows, tile cols), changed.
        corridor: up to date.
        num_tiles: inside.
    """
    tile_cols = corridor.is_inside.shape[1]
    rows, cols = corridor.weights.shape
    for index in range(num_tiles):
        tile_row = corridor.tiles[index] // tile_cols
        tile_col = corridor.tiles[index] % tile_cols
        lowest = 256
        for row in range((tile_row - 1) * TILE, min(tile_row * TILE, rows)):
            for col in range((tile_col - 1) * TILE, min(tile_col * TILE, cols)):
                if corridor.weights[row, col] != LETHAL:
                    lowest = min(lowest, int(corridor.weights[row, col]))
        out_weights[tile_row, tile_col] = lowest if lowest < 256 else LETHAL


@kernel
def cost_of_way(corridor: Corridor, way: NDArray[np.int32]) -> float:
    """Return what the way along tiles costs over their mean weights, one step over a tile.

    Args:
        corridor: must hold the way.
        way: (n,) tiles, from the start to the target.
    """
    tile_cols = corridor.is_inside.shape[1]
    rows, cols = corridor.weights.shape
    total, before = 0.0, 0.0
    for index in range(way.shape[0]):
        tile_row, tile_col = way[index] // tile_cols, way[index] % tile_cols
        weight, count = 0, 0
        for row in range((tile_row - 1) * TILE, min(tile_row * TILE, rows)):
            for col in range((tile_col - 1) * TILE, min(tile_col * TILE, cols)):
                weight += corridor.weights[row, col]
                count += corridor.weights[row, col] != LETHAL
        mean = weight / count
        if index > 0:
            step = abs(way[index] - way[index - 1])
            total += (STEP if step == 1 or step == tile_cols else DIAGONAL) * (before + mean)
        before = mean
    return total
