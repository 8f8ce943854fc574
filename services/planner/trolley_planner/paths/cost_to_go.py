"""The cost-to-go of one target: searched coarsely first, then near the path only, and kept."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel
from trolley_planner.costmap.inflation import LETHAL, WEIGHT_UNIT, soften_disc
from trolley_planner.paths.corridor import (
    TILE,
    Corridor,
    Terrain,
    close,
    open_discs,
    open_path,
    reload,
    rewind,
    tile_of,
)
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
)
from trolley_planner.paths.tiles import (
    Coarse,
    block,
    even_share,
    has_opened,
    retile,
    retile_changes,
)


class CorridorParams(NamedTuple):
    """How far around the coarse path cells are searched; by hand."""

    near_cells: int = 400
    """Distance to the target up to which paths may use 16 directions, unless the caller says
    otherwise."""
    even_share: float = 0.6
    """Share of tiles of free floor, far from obstacles, from which on 16 directions are used: there
    only the direction makes one path dearer than another. Houses have a third, and paths along 8
    directions cost no more there (bench/planner/paths)."""
    reach_tiles: int = 1
    """Least distance by which the corridor is wider than the coarse path on either side."""
    wide_tiles: int = 20
    """Least product of the corridor's length and its reach, so that short corridors are wider."""
    reach_most_tiles: int = 3
    """Greatest distance by which the corridor is wider than the coarse path on either side."""
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
COARSE_SLACK = CORRIDOR.band_cells * COST_OF_CELL // TILE
"""A search over tiles goes on this far beyond the robot; it is continued where more is asked."""


class CostToGo:
    """Cost-to-go of the newest target; changes far from the path do not affect it.

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
        """Number of searches over all tiles."""

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
        """Search the next path from scratch."""
        self._target = None

    @property
    def _flat_weights(self) -> NDArray[np.uint8]:
        return self._corridor.weights.reshape(-1)

    @property
    def _flat_cost(self) -> NDArray[np.int32]:
        return self._corridor.cost.reshape(-1)

    def _renewed(self, start: int, target: int, terrain: Terrain) -> NDArray[np.int32] | None:
        """Return the updated path of the last search; None if it may not be the best."""
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

    def _searched(self, start: int, target: int, terrain: Terrain) -> NDArray[np.int32] | None:
        """Return the path, searched from scratch; None if there is none."""
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
            (self._queue, self._back_queue),
            terrain,
            (start, target),
            is_near,
        )
        count, self._num_inside, self._final_coarse, self._final_cost = found[:4]
        self._directions, self._promise = found[4:]
        if count < 0:
            return None
        if count > 0:
            return self._path[:count].copy()
        self._open_all(terrain)
        clear_queue(self._queue)
        self._grow(np.array([[target, 0]], dtype=np.int32), 0, start)
        return self._descend(start, terrain.discs)

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
        cells = self._path[:count].copy()
        if self._has_all:
            return cells
        ratio, self._final_coarse = promised_ratio(
            cells, cost, self._shape[1], self._coarse, discs, self._final_coarse, self._directions
        )
        return cells if ratio <= self._promise else None

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


@kernel
def promised_ratio(
    cells: NDArray[np.int32],
    cost: NDArray[np.int32],
    cols: int,
    coarse: Coarse,
    discs: NDArray[np.float64],
    final_coarse: int,
    directions: int,
) -> tuple[float, int]:
    """Return the cost of a path relative to the promised one, infinite where that is unknown.

    Its ends inside the discs are not compared: there it may have to pay for squeezing out. Nor is
    half a tile, since the promise does not know where in their tiles the ends are.

    Args:
        cells: (n,) of the path.
        cost: (cells,) cost-to-go.
        cols: cells in a row.
        coarse: its search goes on if it did not come as far.
        discs: see `Terrain`.
        final_coarse: below what its costs are final.
        directions: of its search.

    Returns:
        The ratio, and below what the costs over tiles are final now.
    """
    skipped, left = math.ceil(1.5 * discs[0, 2]), math.ceil(1.5 * discs[-1, 2])
    if cells.shape[0] <= skipped + left:
        return 1.0, final_coarse
    tile_cols = coarse.weights.shape[1]
    first, last = int(cells[skipped]), int(cells[cells.shape[0] - 1 - left])
    first_tile, last_tile = tile_of(first, cols, tile_cols), tile_of(last, cols, tile_cols)
    if coarse.cost[first_tile] >= final_coarse:
        final_coarse = go_on(coarse, final_coarse, first_tile, COARSE_SLACK, directions)
        if coarse.cost[first_tile] >= final_coarse:
            return math.inf, final_coarse
    promised = TILE * (coarse.cost[first_tile] - coarse.cost[last_tile])
    dearer = cost[first] - cost[last] - TILE // 2 * COST_OF_CELL
    return dearer / max(promised, 1), final_coarse


@kernel
def go_on(coarse: Coarse, final_coarse: int, tile: int, slack: int, directions: int) -> int:
    """Continue the search over tiles until so far beyond one; return below what it is final."""
    return grow(
        coarse.cost,
        coarse.weights.reshape(-1),
        coarse.queue,
        np.empty((0, 2), dtype=np.int32),
        coarse.weights.shape[1],
        max(0, final_coarse - COSTLIEST_STEP),
        (tile, slack),
        directions,
    )


@kernel
def better_tiles(
    coarse: Coarse, back_queue: Queue, start_tile: int, limit: int, directions: int
) -> NDArray[np.int32]:
    """Return the tiles (n,) through which a path may lead that costs no more than `limit`.

    Args:
        coarse: its costs are final up to the limit.
        back_queue: scratch, of the tiles.
        start_tile: where the path begins.
        limit: [cost over tiles].
        directions: 8 or 16.
    """
    # What the path from the start to each tile may still cost: nothing beyond is searched.
    left = np.empty_like(coarse.cost)
    for tile in range(left.shape[0]):
        left[tile] = max(limit + 1 - coarse.cost[tile], 0)
    cost = left.copy()
    seeds = np.zeros((1, 2), dtype=np.int32)
    seeds[0, 0] = start_tile
    clear_queue(back_queue)
    flat, tile_cols = coarse.weights.reshape(-1), coarse.weights.shape[1]
    grow(cost, flat, back_queue, seeds, tile_cols, 0, (-1, 0), directions)
    return np.flatnonzero(cost < left).astype(np.int32)


@kernel
def search_anew(
    out_path: NDArray[np.int32],
    corridor: Corridor,
    num_inside: int,
    coarse: Coarse,
    queues: tuple[Queue, Queue],
    terrain: Terrain,
    ends: tuple[int, int],
    is_near: bool,
) -> tuple[int, int, int, int, int, float]:
    """Search the coarse grid for a path, and the cells near that; more if it promised a better one.

    Args:
        out_path: (cells,) the path is written from index 0.
        corridor: changed.
        num_inside: how many tiles are inside.
        coarse: changed.
        queues: of the corridor's search, and one of tiles; changed.
        terrain: as it is now.
        ends: start and target [cells].
        is_near: whether the path may keep to 16 directions.

    Returns:
        How many cells the path has, 0 if there is none in the corridor, -1 if there is none at all;
        how many tiles are inside; below what the costs over tiles, and those over cells are final;
        to how many directions the path keeps; how many times what is promised it may cost.
    """
    start, target = ends
    queue, back_queue = queues
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
    fine_seeds = np.zeros((1, 2), dtype=np.int32)
    fine_seeds[0, 0] = target
    final, final_coarse = 0, 0
    for attempt in range(1 + CORRIDOR.more_attempts):
        final_coarse = cost_to_go_into(
            coarse.cost,
            flat,
            coarse.queue,
            seeds,
            tile_cols,
            (start_tile, COARSE_SLACK),
            directions,
        )
        if coarse.cost[start_tile] == UNREACHED:
            count = 0 if attempt else -1
            return count, num_inside, final_coarse, final, directions, CORRIDOR.dearer
        count = descend_into(out_path, coarse.cost, flat, start_tile, tile_cols, directions)
        tiles = out_path[:count]
        reach = max(CORRIDOR.reach_tiles, CORRIDOR.wide_tiles // count)
        reach = min(reach, CORRIDOR.reach_most_tiles)
        num_inside = open_path(corridor, num_inside, terrain.weights, tiles, reach)
        if attempt == 0:
            clear_queue(queue)  # All tiles are new.
        else:
            rewind(corridor, num_inside, queue, -1)
        final = grow(cost, weights, queue, fine_seeds, cols, 0, (start, slack), directions)
        if cost[start] != UNREACHED:
            break
        block(coarse, corridor, tiles)
    promise = CORRIDOR.dearer
    if cost[start] == UNREACHED:
        return 0, num_inside, final_coarse, final, directions, promise
    count = descend_into(out_path, cost, weights, start, cols, directions)
    ratio, final_coarse = promised_ratio(
        out_path[:count], cost, cols, coarse, terrain.discs, final_coarse, directions
    )
    if ratio > promise:
        limit = (cost[start] + CORRIDOR.band_cells * COST_OF_CELL) // TILE
        more = max(limit - coarse.cost[start_tile], CORRIDOR.band_cells * COST_OF_CELL)
        final_coarse = go_on(coarse, final_coarse, start_tile, more, directions)
        better = better_tiles(coarse, back_queue, start_tile, limit, directions)
        num_inside = open_path(corridor, num_inside, terrain.weights, better, 0)
        rewind(corridor, num_inside, queue, -1)
        final = grow(cost, weights, queue, fine_seeds, cols, 0, (start, slack), directions)
        count = descend_into(out_path, cost, weights, start, cols, directions)
        ratio, final_coarse = promised_ratio(
            out_path[:count], cost, cols, coarse, terrain.discs, final_coarse, directions
        )
        # What costs more than promised now does so everywhere.
        promise = max(promise, ratio)
    return count, num_inside, final_coarse, final, directions, promise
