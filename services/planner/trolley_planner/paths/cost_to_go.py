"""The cost-to-go of one target: searched coarsely first, then near the path only, and kept."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel
from trolley_planner.costmap.inflation import LETHAL, WEIGHT_UNIT, soften_disc
from trolley_planner.paths.search import (
    COSTLIEST_STEP,
    STEP,
    UNREACHED,
    Queue,
    clear_queue,
    cost_to_go_into,
    descend_into,
    grow,
    make_queue,
    push,
)


class CorridorParams(NamedTuple):
    """How far around the coarse path cells are searched; by hand."""

    near_cells: int = 400
    """Paths to targets no farther away than this keep to 16 directions, unless said otherwise,"""
    even_share: float = 0.6
    """where at least this share of the tiles is free floor far from everything: there nothing but
    the direction makes one path dearer than another. In houses it is a third, and paths along
    8 directions cost no more (bench/planner/paths)."""
    reach_tiles: int = 1
    """The corridor is at least this much wider than the coarse path on either side,"""
    wide_tiles: int = 20
    """and more where that is short: its length in tiles times the reach is at least this,"""
    reach_most_tiles: int = 3
    """if the reach is no more than this."""
    slack_cells: int = 40
    """A search goes on this far beyond the robot, so that the result serves where it drives
    next."""
    more_attempts: int = 3
    """After so many more coarse paths that lead through a wall all cells are searched."""
    dearer: float = 1.05
    """The path may cost this many times what the coarse one promised, or all tiles that
    promise better are searched, too. Found by bench/planner/paths and replans: with 1.03 every
    eighth first plan searches more, with 1.12 plans around new things cost 0.4 % more."""
    band_cells: int = 8
    """A tile may promise this much more and still be searched, since a promise is not
    exact."""


CORRIDOR = CorridorParams()
COST_OF_CELL = 2 * STEP * WEIGHT_UNIT
"""Cost of a straight step over free cells."""
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


class Coarse(NamedTuple):
    """The grid of tiles."""

    weights: NDArray[np.uint8]
    """(tile rows, tile cols) what it takes to cross each."""
    cost: NDArray[np.int32]
    """(tiles,) cost-to-go."""
    queue: Queue
    """What waits of the search for it."""
    seen: NDArray[np.uint8]
    """(rows, cols) the cells' weights that the tiles were made of,"""
    is_stale: NDArray[np.uint8]
    """(tile rows,) but for these rows of tiles: 1."""


class CostToGo:
    """Cost-to-go of the newest target; changes far from the path leave it as it is.

    The coarse grid takes each tile for as passable as its best row or column. If it holds no
    path there is none. Otherwise the cells near its path are searched. If they hold a path that
    costs more than promised, so are all tiles through which a cheaper one than that is promised.
    If they hold none (as where a wall is thinner than a tile), the tile where the search ended is
    closed and another coarse path followed; if that does not help, all cells are searched.

    Source:
        The promises guide the search as the costs of an abstraction do in Holte, Perez, Zimmer and
        MacDonald, Hierarchical A*: Searching Abstraction Hierarchies Efficiently (1996).

    Args:
        shape: rows and columns of the costmap.
        near_cells: paths to targets no farther away may keep to 16 directions, others keep to 8:
            they would take too long, and differ less.
    """

    def __init__(self, shape: tuple[int, int], near_cells: float = CORRIDOR.near_cells) -> None:
        self._shape = shape
        self._near_cells = near_cells
        tiles = tuple(-(-size // TILE) + 2 for size in shape)
        num_cells, num_tiles = math.prod(shape), math.prod(tiles)
        # Zeros, so that the system gives memory only for what is used.
        self._corridor = Corridor(
            np.zeros(num_tiles, dtype=np.int32),
            np.zeros(tiles, dtype=np.uint8),
            np.zeros(shape, dtype=np.uint8),
            np.zeros(shape, dtype=np.int32),
        )
        self._num_inside = 0
        self._queue = make_queue(num_cells)
        self._coarse = Coarse(
            np.zeros(tiles, dtype=np.uint8),
            np.zeros(num_tiles, dtype=np.int32),
            make_queue(num_tiles),
            np.zeros(shape, dtype=np.uint8),
            np.ones(tiles[0], dtype=np.uint8),
        )
        self._back_queue = make_queue(num_tiles)
        self._path = np.empty(num_cells, dtype=np.int32)
        self._target: tuple[float, float] | None = None
        # All costs below these are final.
        self._final_cost = self._final_coarse = 0
        self._has_all = False
        self._promise = CORRIDOR.dearer
        self._directions = 8
        self.searches = 0
        """How often all was looked for anew."""

    def cheapest_path(self, start: int, terrain: Terrain) -> tuple[NDArray[np.int32], int] | None:
        """Return the cells of the cheapest path and its cost, None if there is none.

        Args:
            start: cell.
            terrain: weights of the whole grid; its last disc is about the target.
        """
        x, y = float(terrain.discs[-1, 0]), float(terrain.discs[-1, 1])
        target = math.floor(y) * self._shape[1] + math.floor(x)
        cells = None
        if self._target == (x, y):
            cells = self._renewed(start, target, terrain)
        if cells is None:
            self._target = (x, y)
            cells = self._searched(start, target, terrain)
        if cells is None:
            self._target = None
            return None
        return cells, int(self._flat_cost[start])

    def forget(self) -> None:
        """Search the next path anew, whatever is known."""
        self._target = None

    @property
    def _flat_weights(self) -> NDArray[np.uint8]:
        return self._corridor.weights.reshape(-1)

    @property
    def _flat_cost(self) -> NDArray[np.int32]:
        return self._corridor.cost.reshape(-1)

    def _renewed(self, start: int, target: int, terrain: Terrain) -> NDArray[np.int32] | None:
        """Return the path by what is known, updated; None if it may not be the best."""
        corridor = self._corridor
        if has_opened(self._coarse.seen, terrain.weights, corridor.is_inside):
            return None
        self._num_inside, right = open_discs(corridor, self._num_inside, terrain)
        right = min(right, reload(corridor, self._num_inside, terrain))
        right = min(right, self._final_cost - 1)
        if self._flat_weights[target] == LETHAL:
            return None
        self._final_cost = right + 1
        if self._flat_cost[start] > right:
            rewind(corridor, self._num_inside, self._queue, right)
            self._grow(np.empty((0, 2), dtype=np.int32), max(0, right - COSTLIEST_STEP), start)
        return self._descend(start, terrain.discs)

    def _widened(self, start: int, target: int, terrain: Terrain) -> NDArray[np.int32] | None:
        """Return the path with all tiles in the corridor that promise a better one."""
        self._open_better(start, terrain.weights)
        rewind(self._corridor, self._num_inside, self._queue, -1)
        self._grow(np.array([[target, 0]], dtype=np.int32), 0, start)
        # What costs more than promised now does so everywhere.
        promise, self._promise = self._promise, math.inf
        cells = self._descend(start, terrain.discs)
        if cells is not None:
            self._promise = max(promise, self._ratio(cells, terrain.discs))
        return cells

    def _searched(self, start: int, target: int, terrain: Terrain) -> NDArray[np.int32] | None:
        """Return the path, searched anew; None if there is none."""
        self.searches += 1
        cols = self._shape[1]
        away = math.hypot(start % cols - target % cols, start // cols - target // cols)
        is_near = away <= self._near_cells
        self._has_all = False
        found = search_anew(
            self._path,
            self._corridor,
            self._num_inside,
            self._coarse,
            self._queue,
            terrain,
            (start, target),
            is_near,
        )
        count, self._num_inside, self._final_coarse, self._final_cost, self._directions = found
        self._promise = CORRIDOR.dearer
        if count < 0:
            return None
        if count > 0:
            cells = self._kept(self._path[:count].copy(), terrain.discs)
            return self._widened(start, target, terrain) if cells is None else cells
        self._open_all(terrain)
        clear_queue(self._queue)
        self._grow(np.array([[target, 0]], dtype=np.int32), 0, start)
        return self._descend(start, terrain.discs)

    def _open_better(self, start: int, weights: NDArray[np.uint8]) -> None:
        """Add all tiles to the corridor through which a cheaper path may lead."""
        coarse, back_queue = self._coarse, self._back_queue
        tile_cols = coarse.weights.shape[1]
        start_tile = tile_of(start, self._shape[1], tile_cols)
        flat = coarse.weights.reshape(-1)
        limit = (int(self._flat_cost[start]) + CORRIDOR.band_cells * COST_OF_CELL) // TILE
        slack = max(limit - int(coarse.cost[start_tile]), CORRIDOR.band_cells * COST_OF_CELL)
        none = np.empty((0, 2), dtype=np.int32)
        self._final_coarse = grow(
            coarse.cost,
            flat,
            coarse.queue,
            none,
            tile_cols,
            max(0, self._final_coarse - COSTLIEST_STEP),
            (start_tile, slack),
            self._directions,
        )
        # What the path from the start to each tile may still cost: nothing beyond is searched.
        left = np.maximum(limit + 1 - coarse.cost.astype(np.int64), 0).astype(np.int32)
        cost = left.copy()
        seed = np.array([[start_tile, 0]], dtype=np.int32)
        clear_queue(back_queue)
        grow(cost, flat, back_queue, seed, tile_cols, 0, (-1, 0), self._directions)
        better = np.flatnonzero(cost < left).astype(np.int32)
        self._num_inside = open_path(self._corridor, self._num_inside, weights, better, 0)

    def _open_all(self, terrain: Terrain) -> None:
        """Add everything to the corridor."""
        corridor = self._corridor
        np.copyto(corridor.weights, terrain.weights)
        for x, y, radius in terrain.discs:
            soften_disc(corridor.weights, terrain.distance_m, (x, y), radius, terrain.price)
        corridor.is_inside[1:-1, 1:-1] = 1
        inside = np.flatnonzero(corridor.is_inside)
        self._num_inside = len(inside)
        corridor.tiles[: len(inside)] = inside
        corridor.cost[:, :] = UNREACHED
        self._has_all = True

    def _descend(self, start: int, discs: NDArray[np.float64]) -> NDArray[np.int32] | None:
        """Return the path from a cell by the known costs; None if a better one may be elsewhere."""
        cost = self._flat_cost
        if cost[start] == UNREACHED:
            return None
        count = descend_into(
            self._path, cost, self._flat_weights, start, self._shape[1], self._directions
        )
        return self._kept(self._path[:count].copy(), discs)

    def _kept(
        self, cells: NDArray[np.int32], discs: NDArray[np.float64]
    ) -> NDArray[np.int32] | None:
        """Return a path, None if a better one may be elsewhere.

        A path near the coarse one is compared with it, except for its ends inside the discs, where
        it may have to pay for squeezing out.
        """
        is_good = self._has_all or self._ratio(cells, discs) <= self._promise
        return cells if is_good else None

    def _ratio(self, cells: NDArray[np.int32], discs: NDArray[np.float64]) -> float:
        """Return the cost of a path relative to the promised one, infinite where that is unknown.

        Half a tile is not counted: the promise does not know where in their tiles the ends are.
        """
        skipped, left = _ends(discs)
        if len(cells) <= skipped + left:
            return 1.0
        cost, coarse = self._flat_cost, self._coarse
        first, last = int(cells[skipped]), int(cells[-1 - left])
        cols, tile_cols = self._shape[1], coarse.weights.shape[1]
        coarse_first = int(coarse.cost[tile_of(first, cols, tile_cols)])
        if coarse_first >= self._final_coarse:
            return math.inf
        promised = TILE * (coarse_first - int(coarse.cost[tile_of(last, cols, tile_cols)]))
        dearer = int(cost[first]) - int(cost[last]) - TILE // 2 * COST_OF_CELL
        return dearer / max(promised, 1)

    def _grow(self, seeds: NDArray[np.int32], first: int, start: int) -> None:
        """Continue the search in the corridor until some distance beyond the start."""
        self._final_cost = grow(
            self._flat_cost,
            self._flat_weights,
            self._queue,
            seeds,
            self._shape[1],
            first,
            (start, CORRIDOR.slack_cells * COST_OF_CELL),
            self._directions,
        )


def _ends(discs: NDArray[np.float64]) -> tuple[int, int]:
    """Return how many cells at the start and at the end of a path may lie inside the discs."""
    return math.ceil(1.5 * float(discs[0, 2])), math.ceil(1.5 * float(discs[-1, 2]))


@kernel
def tile_of(cell: int, cols: int, tile_cols: int) -> int:
    """Return the tile that a cell lies in."""
    return (cell // cols // TILE + 1) * tile_cols + cell % cols // TILE + 1


@kernel
def search_anew(
    out_path: NDArray[np.int32],
    corridor: Corridor,
    num_inside: int,
    coarse: Coarse,
    queue: Queue,
    terrain: Terrain,
    ends: tuple[int, int],
    is_near: bool,
) -> tuple[int, int, int, int, int]:
    """Search the coarse grid for a path, and the cells near that.

    Args:
        out_path: (cells,) the path is written from index 0.
        corridor: changed.
        num_inside: how many tiles are inside.
        coarse: changed.
        queue: of the corridor's search, changed.
        terrain: as it is now.
        ends: start and target [cells].
        is_near: whether the path may keep to 16 directions.

    Returns:
        How many cells the path has, 0 if there is none in the corridor, -1 if there is none at all;
        how many tiles are inside; below what the costs over tiles, and those over cells are final;
        to how many directions the path keeps.
    """
    start, target = ends
    cols, tile_cols = terrain.weights.shape[1], coarse.weights.shape[1]
    close(corridor, num_inside)
    retile_changes(coarse, terrain.weights)
    num_inside, _ = open_discs(corridor, 0, terrain)
    retile(coarse, corridor, num_inside)
    directions = 16 if is_near and even_share(coarse.weights) >= CORRIDOR.even_share else 8
    seeds = np.zeros((1, 2), dtype=np.int32)
    start_tile, seeds[0, 0] = tile_of(start, cols, tile_cols), tile_of(target, cols, tile_cols)
    flat = coarse.weights.reshape(-1)
    slack = CORRIDOR.slack_cells * COST_OF_CELL
    cost, weights = corridor.cost.reshape(-1), corridor.weights.reshape(-1)
    count, final, final_coarse = 0, 0, 0
    for attempt in range(1 + CORRIDOR.more_attempts):
        final_coarse = cost_to_go_into(
            coarse.cost,
            flat,
            coarse.queue,
            seeds,
            tile_cols,
            (start_tile, slack // TILE),
            directions,
        )
        if coarse.cost[start_tile] == UNREACHED:
            return 0 if attempt else -1, num_inside, final_coarse, final, directions
        count = descend_into(out_path, coarse.cost, flat, start_tile, tile_cols, directions)
        tiles = out_path[:count]
        reach = max(CORRIDOR.reach_tiles, CORRIDOR.wide_tiles // count)
        reach = min(reach, CORRIDOR.reach_most_tiles)
        num_inside = open_path(corridor, num_inside, terrain.weights, tiles, reach)
        fine_seeds = np.zeros((1, 2), dtype=np.int32)
        fine_seeds[0, 0] = target
        rewind(corridor, num_inside, queue, -1)
        final = grow(cost, weights, queue, fine_seeds, cols, 0, (start, slack), directions)
        if cost[start] != UNREACHED:
            count = descend_into(out_path, cost, weights, start, cols, directions)
            return count, num_inside, final_coarse, final, directions
        block(coarse, corridor, tiles)
    return 0, num_inside, final_coarse, final, directions


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


@kernel
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
    """Return how many cells (n,) have become cheaper; without branches, so many at a time."""
    count = 0
    for col in range(seen.shape[0]):
        # Less one, lethal is the dearest of all.
        weight, before = np.uint8(weights[col] - np.uint8(1)), np.uint8(seen[col] - np.uint8(1))
        count += 1 if weight < before else 0
    return count


@kernel
def retile(coarse: Coarse, corridor: Corridor, num_tiles: int) -> None:
    """Write the weights of the tiles inside, which may differ from the grid's.

    Args:
        coarse: changed; the rows of these tiles will be made anew next time.
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


@kernel
def cut_at(weights: NDArray[np.uint8], row: int, col: int, rows: int, cols: int) -> int:
    """Return the weight of a cell, `CUT` where it is lethal or outside."""
    if row >= rows or col >= cols or weights[row, col] == LETHAL:
        return CUT
    return int(weights[row, col])
