"""The coarse grid: tiles of some cells, each as passable as its best row or column."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel, lean_kernel
from trolley_planner.costmap.inflation import LETHAL, WEIGHT_UNIT
from trolley_planner.paths.corridor import TILE, Corridor
from trolley_planner.paths.search import UNREACHED, Queue

CUT = 4096
"""Stands for a lethal weight in sums; more than those of all others in a line of a tile."""


class Coarse(NamedTuple):
    """The grid of tiles."""

    weights: NDArray[np.uint8]
    """(tile rows, tile cols) what it takes to cross each."""
    cost: NDArray[np.int32]
    """(tiles,) cost-to-go."""
    queue: Queue
    """Cells that the search of tiles has still to expand."""
    seen: NDArray[np.uint8]
    """(rows, cols) weights of the cells that the tiles were made of, except in stale rows."""
    is_stale: NDArray[np.uint8]
    """(tile rows,) 1 where a row of tiles was not yet made of the present weights."""


@kernel
def retile_changes(coarse: Coarse, weights: NDArray[np.uint8]) -> None:
    """Bring the tiles' weights up to date with those of the cells (rows, cols)."""
    rows = weights.shape[0]
    cols = weights.shape[1]
    flat, flat_seen = weights.reshape(-1), coarse.seen.reshape(-1)
    for tile_row in range(1, coarse.weights.shape[0] - 1):
        first, last = (tile_row - 1) * TILE, min(tile_row * TILE, rows)
        cells = slice(first * cols, last * cols)
        if differs(flat_seen[cells], flat[cells]) or coarse.is_stale[tile_row] != 0:
            flat_seen[cells] = flat[cells]
            coarsen_row_into(coarse.weights[tile_row], weights[first:last])
            coarse.is_stale[tile_row] = 0


@lean_kernel
def differs(one: NDArray[np.uint8], other: NDArray[np.uint8]) -> bool:
    """Say whether two stretches (n,) differ; without branches, so many cells at a time."""
    difference = np.uint8(0)
    for col in range(one.shape[0]):
        difference = np.uint8(difference | np.uint8(one[col] ^ other[col]))
    return difference != 0


@kernel
def coarsen_row_into(out_weights: NDArray[np.uint8], weights: NDArray[np.uint8]) -> None:
    """Write what it takes to cross each tile of a row: the mean weight of its best row or column.

    Where all of them are cut, its lowest weight; 0 where all cells are lethal.

    Args:
        out_weights: (tile cols,), overwritten.
        weights: (up to TILE, cols) of its cells; what lies beyond is lethal.
    """
    rows, cols = weights.shape
    tile_cols = out_weights.shape[0] - 2
    row_line = np.full(TILE * tile_cols, CUT, dtype=np.uint16)
    columns = np.zeros(TILE * tile_cols, dtype=np.uint16)
    lowest = np.full(TILE * tile_cols, CUT, dtype=np.uint16)
    best = np.full(tile_cols, CUT, dtype=np.uint16)
    # Loops without branches over whole rows.
    for row in range(rows):
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
    if rows < TILE:
        columns[:] = CUT
    out_weights[0] = out_weights[-1] = LETHAL
    for tile in range(tile_cols):
        least, line = np.uint16(CUT), best[tile]
        for col in range(TILE * tile, TILE * (tile + 1)):
            least, line = min(least, lowest[col]), min(line, columns[col])
        out_weights[tile + 1] = tile_weight(int(line), int(least))


@lean_kernel
def tile_weight(line: int, least: int) -> int:
    """Return the weight of a tile by the sum of its best line and its lowest weight."""
    if line < CUT:
        return (line + TILE // 2) // TILE
    return least if least < CUT else LETHAL


@kernel
def retile(coarse: Coarse, corridor: Corridor, num_tiles: int) -> None:
    """Write the weights of the tiles inside, which may differ from the grid's.

    Args:
        coarse: changed; the rows of these tiles will be rebuilt next time.
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
        coarse.weights[tile_row, tile_col] = tile_weight(line, least)
        coarse.is_stale[tile_row] = 1


@lean_kernel
def cut_at(weights: NDArray[np.uint8], row: int, col: int, rows: int, cols: int) -> int:
    """Return the weight of a cell, `CUT` where it is lethal or outside."""
    if row >= rows or col >= cols or weights[row, col] == LETHAL:
        return CUT
    return int(weights[row, col])


@kernel
def block(coarse: Coarse, corridor: Corridor, tiles: NDArray[np.int32]) -> None:
    """Close the tile of a coarse path (n,) behind the last one that was reached from the target."""
    rows, cols = corridor.weights.shape
    tile_cols = coarse.weights.shape[1]
    for index in range(tiles.shape[0] - 1, -1, -1):
        tile_row, tile_col = tiles[index] // tile_cols, tiles[index] % tile_cols
        is_reached = False
        for row in range((tile_row - 1) * TILE, min(tile_row * TILE, rows)):
            for col in range((tile_col - 1) * TILE, min(tile_col * TILE, cols)):
                is_free = corridor.weights[row, col] != LETHAL
                is_reached |= is_free and corridor.cost[row, col] != UNREACHED
        if not is_reached:
            coarse.weights[tile_row, tile_col] = LETHAL
            coarse.is_stale[tile_row] = 1
            return


@kernel
def even_share(weights: NDArray[np.uint8]) -> float:
    """Return what share of the passable tiles (tile rows, tile cols) costs the least there is."""
    flat = weights.reshape(-1)
    even, passable = 0, 0
    for tile in range(flat.shape[0]):
        even += 1 if flat[tile] == WEIGHT_UNIT else 0
        passable += 1 if flat[tile] != LETHAL else 0
    return even / max(passable, 1)


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
    for row in range(weights.shape[0]):
        if num_cheaper(seen[row], weights[row]) == 0:
            continue
        for col in range(weights.shape[1]):
            weight, before = int(weights[row, col]), int(seen[row, col])
            is_cheaper = weight != LETHAL and (before == LETHAL or weight < before)
            if is_cheaper and is_inside[row // TILE + 1, col // TILE + 1] == 0:
                return True
    return False


@kernel
def num_cheaper(seen: NDArray[np.uint8], weights: NDArray[np.uint8]) -> int:
    """Return how many cells (n,) have become cheaper; without branches, so that it vectorizes."""
    count = 0
    for col in range(seen.shape[0]):
        # Less one, lethal is the dearest of all.
        weight, before = np.uint8(weights[col] - np.uint8(1)), np.uint8(seen[col] - np.uint8(1))
        count += 1 if weight < before else 0
    return count
