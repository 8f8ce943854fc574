"""The cost-to-go of one target: looked for coarsely first, then near the way only, and kept."""

import math

import numpy as np
from numpy.typing import NDArray

from trolley_planner.kernels.corridor import (
    TILE,
    Corridor,
    Terrain,
    close,
    coarsen_into,
    cost_of_way,
    has_opened,
    open_box,
    open_way,
    reload,
    retile,
    rewind,
)
from trolley_planner.kernels.layers import LETHAL, WEIGHT_UNIT, soften_disc
from trolley_planner.kernels.search import (
    COSTLIEST_STEP,
    STEP,
    UNREACHED,
    clear_queue,
    cost_to_go_into,
    descend_into,
    grow,
    make_queue,
)

REACH_TILES = 1
"""The corridor is so much wider than the coarse way, on either side."""
SLACK_CELLS = 40
"""How far a search goes on beyond the robot, so that the result serves where it drives next."""
DEARER_CELLS = 2
"""It may cost so much more than the coarse one promised, or all other ways are looked at, too."""
COST_OF_CELL = 2 * STEP * WEIGHT_UNIT
"""Cost of a straight step over free cells."""


class GoalField:
    """Cost-to-go of the newest target; what changes far from the way leaves it as it is.

    The coarse grid takes each tile for as passable as its best cell. Where it knows no way there
    is none. Otherwise the cells near its way are searched; where they hold no way, or one much
    dearer than promised (as behind a wall thinner than a tile), all cells are.

    Args:
        shape: rows and columns of the costmap.
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        self._shape = shape
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
        self._coarse_weights = np.zeros(tiles, dtype=np.uint8)
        self._coarse_cost = np.zeros(num_tiles, dtype=np.int32)
        self._coarse_queue = make_queue(num_tiles)
        self._seen = np.zeros(shape, dtype=np.uint8)
        self._target: tuple[float, float] | None = None
        # All costs below these are final.
        self._final_cost = self._final_coarse = 0
        self._has_all = False
        self._promise = 1.0
        self.searches = 0
        """How often all was looked for anew."""

    def way(self, start: int, terrain: Terrain) -> tuple[NDArray[np.int32], int] | None:
        """Return the cells of the cheapest way and its cost, None if there is none.

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
        """Look for the next way anew, whatever is known."""
        self._target = None

    @property
    def _flat_weights(self) -> NDArray[np.uint8]:
        return self._corridor.weights.reshape(-1)

    @property
    def _flat_cost(self) -> NDArray[np.int32]:
        return self._corridor.cost.reshape(-1)

    def _renewed(self, start: int, target: int, terrain: Terrain) -> NDArray[np.int32] | None:
        """Return the way by what is known, brought up to date; None if that may not be the best."""
        corridor = self._corridor
        if has_opened(self._seen, terrain.weights, corridor.is_inside):
            return None
        right = min(self._final_cost - 1, self._open_discs(terrain))
        right = min(right, reload(corridor, self._num_inside, terrain))
        if self._flat_weights[target] == LETHAL:
            return None
        self._final_cost = right + 1
        if self._flat_cost[start] > right:
            rewind(corridor, self._num_inside, self._queue, right)
            self._grow(np.empty((0, 2), dtype=np.int32), max(0, right - COSTLIEST_STEP), start)
        return self._descend(start, terrain.discs)

    def _searched(self, start: int, target: int, terrain: Terrain) -> NDArray[np.int32] | None:
        """Return the way, looked for anew; None if there is none."""
        self.searches += 1
        corridor = self._corridor
        close(corridor, self._num_inside)
        self._num_inside = 0
        self._has_all = False
        self._seen[:] = terrain.weights
        self._open_discs(terrain)
        tiles = self._coarse_way(start, target, terrain)
        if tiles is None:
            return None
        self._num_inside = open_way(corridor, self._num_inside, terrain.weights, tiles, REACH_TILES)
        self._promise = self._promise_of(tiles, terrain.discs)
        seeds = np.array([[target, 0]], dtype=np.int32)
        clear_queue(self._queue)
        self._grow(seeds, 0, start)
        cells = self._descend(start, terrain.discs)
        if cells is not None:
            return cells
        self._open_all(terrain)
        clear_queue(self._queue)
        self._grow(seeds, 0, start)
        return self._descend(start, terrain.discs)

    def _open_all(self, terrain: Terrain) -> None:
        """Take everything into the corridor."""
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

    def _coarse_way(self, start: int, target: int, terrain: Terrain) -> NDArray[np.int32] | None:
        """Return the tiles of the way over the coarse grid, None if there is none."""
        coarsen_into(self._coarse_weights, terrain.weights)
        retile(self._coarse_weights, self._corridor, self._num_inside)
        start_tile, tile_cols = self._tile(start), self._corridor.is_inside.shape[1]
        flat = self._coarse_weights.reshape(-1)
        self._final_coarse = cost_to_go_into(
            self._coarse_cost,
            flat,
            self._coarse_queue,
            np.array([[self._tile(target), 0]], dtype=np.int32),
            tile_cols,
            (start_tile, SLACK_CELLS * COST_OF_CELL // TILE),
        )
        if self._coarse_cost[start_tile] == UNREACHED:
            return None
        tiles = np.empty(self._coarse_cost.size, dtype=np.int32)
        count = descend_into(tiles, self._coarse_cost, flat, start_tile, tile_cols)
        return tiles[:count]

    def _descend(self, start: int, discs: NDArray[np.float64]) -> NDArray[np.int32] | None:
        """Return the way from a cell by the costs there are; None if a better one may be elsewhere.

        A way near the coarse one is compared with it, but for its ends inside the discs, where it
        may have to pay for squeezing out.
        """
        cost = self._flat_cost
        if cost[start] == UNREACHED:
            return None
        cells = np.empty(TILE * TILE * self._num_inside, dtype=np.int32)
        count = descend_into(cells, cost, self._flat_weights, start, self._shape[1])
        cells = cells[:count]
        skipped, left = _ends(discs)
        if self._has_all or count <= skipped + left:
            return cells
        first, last = int(cells[skipped]), int(cells[-1 - left])
        coarse_first = int(self._coarse_cost[self._tile(first)])
        coarse = coarse_first - int(self._coarse_cost[self._tile(last)])
        allowed = self._promise * TILE * coarse + DEARER_CELLS * COST_OF_CELL
        is_cheap = int(cost[first]) - int(cost[last]) <= allowed
        return cells if is_cheap and coarse_first < self._final_coarse else None

    def _grow(self, seeds: NDArray[np.int32], first: int, start: int) -> None:
        """Search on in the corridor until some way beyond the start."""
        self._final_cost = grow(
            self._corridor.cost.reshape(-1),
            self._flat_weights,
            self._queue,
            seeds,
            self._shape[1],
            first,
            (start, SLACK_CELLS * COST_OF_CELL),
        )

    def _open_discs(self, terrain: Terrain) -> int:
        """Take the tiles under the discs in; return up to which cost all costs are still right."""
        right = UNREACHED
        for x, y, radius in terrain.discs:
            box = (
                math.floor(y - radius) // TILE + 1,
                math.floor(y + radius) // TILE + 1,
                math.floor(x - radius) // TILE + 1,
                math.floor(x + radius) // TILE + 1,
            )
            self._num_inside, least = open_box(self._corridor, self._num_inside, terrain, box)
            right = min(right, least)
        return right

    def _promise_of(self, tiles: NDArray[np.int32], discs: NDArray[np.float64]) -> float:
        """Return how much dearer the way along tiles is by their mean weights than by the best."""
        skipped, left = (-(-cells // TILE) for cells in _ends(discs))
        way = tiles[skipped : len(tiles) - left]
        if len(way) < 2:
            return 1.0
        best = int(self._coarse_cost[way[0]]) - int(self._coarse_cost[way[-1]])
        return cost_of_way(self._corridor, way) / best

    def _tile(self, cell: int) -> int:
        """Return the tile of a cell."""
        row, col = divmod(cell, self._shape[1])
        return (row // TILE + 1) * self._corridor.is_inside.shape[1] + col // TILE + 1


def _ends(discs: NDArray[np.float64]) -> tuple[int, int]:
    """Return how many cells at the start and at the end of a way may lie inside the discs."""
    return math.ceil(1.5 * float(discs[0, 2])), math.ceil(1.5 * float(discs[-1, 2]))
