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
    UNREACHED,
    Queue,
    clear_queue,
    push,
)

TILE = 4
CUT = 4096
"""Stands for a lethal weight in sums; more than those of all others in a line of a tile."""


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
    """Write what it takes to cross each tile: the mean weight of its best row or column.

    Where all of them are cut, its lowest weight; 0 where all cells are lethal.

    Args:
        out_weights: (tile rows, tile cols), overwritten.
        weights: (rows, cols).
    """
    rows, cols = weights.shape
    out_weights[:, :] = LETHAL
    tile_cols = out_weights.shape[1] - 2
    row_line = np.full(TILE * tile_cols, CUT, dtype=np.uint16)
    columns = np.empty(TILE * tile_cols, dtype=np.uint16)
    lowest = np.empty(TILE * tile_cols, dtype=np.uint16)
    best = np.empty(tile_cols, dtype=np.uint16)
    for tile_row in range(1, out_weights.shape[0] - 1):
        best[:], columns[:], lowest[:] = CUT, 0, CUT
        for row in range((tile_row - 1) * TILE, tile_row * TILE):
            # Loops without branches over whole rows; what lies beyond the grid is lethal.
            if row == rows:
                columns[:] = CUT
                break
            for col in range(cols):
                weight = weights[row, col]
                row_line[col] = np.uint16(weight) + np.uint16(weight == 0) * np.uint16(CUT)
            for col in range(TILE * tile_cols):
                columns[col] += row_line[col]
                lowest[col] = min(lowest[col], row_line[col])
            for tile in range(tile_cols):
                first = TILE * tile
                total = row_line[first] + row_line[first + 1]
                total += row_line[first + 2] + row_line[first + 3]
                best[tile] = min(best[tile], np.uint16(total))
        for tile in range(tile_cols):
            least, line = np.uint16(CUT), best[tile]
            for col in range(TILE * tile, TILE * (tile + 1)):
                least, line = min(least, lowest[col]), min(line, columns[col])
            out_weights[tile_row, tile + 1] = tile_weight(int(line), int(least))


@kernel
def tile_weight(line: int, least: int) -> int:
    """Return the weight of a tile by the sum of its best line and its lowest weight."""
    if line < CUT:
        return (line + TILE // 2) // TILE
    return least if least < CUT else LETHAL


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
    """Take tiles and those at most `reach` from them into the corridor.

    The tiles under the discs must be inside. With a reach of 1 only those with an edge in common
    are taken: a way that goes across is wide enough with them.

    Returns:
        How many are inside now.
    """
    tile_cols = corridor.is_inside.shape[1]
    rows, cols = corridor.weights.shape
    for tile in way:
        row, col = tile // tile_cols, tile % tile_cols
        for near_row in range(row - reach, row + reach + 1):
            for near_col in range(col - reach, col + reach + 1):
                if reach == 1 and near_row != row and near_col != col:
                    continue
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
    """Write the weights of the tiles inside, as in `coarsen_into`; they may differ from the grid's.

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
        line, least = CUT, CUT
        for step in range(TILE):
            along_row, along_col = 0, 0
            for part in range(TILE):
                row, col = (tile_row - 1) * TILE + step, (tile_col - 1) * TILE + part
                weight = cut_at(corridor.weights, row, col, rows, cols)
                along_row, least = along_row + weight, min(least, weight)
                row, col = (tile_row - 1) * TILE + part, (tile_col - 1) * TILE + step
                along_col += cut_at(corridor.weights, row, col, rows, cols)
            line = min(line, min(along_row, along_col))
        out_weights[tile_row, tile_col] = tile_weight(line, least)


@kernel
def cut_at(weights: NDArray[np.uint8], row: int, col: int, rows: int, cols: int) -> int:
    """Return the weight of a cell, `CUT` where it is lethal or outside."""
    if row >= rows or col >= cols or weights[row, col] == LETHAL:
        return CUT
    return int(weights[row, col])
