"""Compiled shortest paths over grids of weights: cost-to-go with a bucket queue, and descent.

Costs are whole numbers: one straight step over free cells costs `STEP * 2 * WEIGHT_UNIT`. Every
weight is `LETHAL` or at least `WEIGHT_UNIT`, and the outermost cells of every grid are lethal, so
that no neighbour has to be tested for the edge.

Source:
    Dial, Algorithm 360: Shortest-Path Forest with Topological Ordering (1969). Buckets no wider
    than the cheapest step, so that the order inside one does not matter: Denardo and Fox,
    Shortest-Route Methods: 1. Reaching, Pruning, and Buckets (1979).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel

STEP, DIAGONAL = 29, 41
"""Lengths of the two kinds of steps: 41 / 29 is 0.03 % less than the square root of 2."""
UNREACHED = 2**31 - 1
"""Cost-to-go of cells that were not reached."""
COSTLIEST_STEP = DIAGONAL * (255 + 255)
FARTHEST = UNREACHED - COSTLIEST_STEP
"""Searches end here: after 460 km of free floor in cells of 5 cm, 50 km beside walls."""
BUCKET_SHIFT = 7
"""A bucket holds costs that differ in their last 7 bits only; the cheapest step costs more."""
NUM_BUCKETS = 256
"""More than the costliest step spans."""
NONE = -1
FREE_ENTRY, NUM_WAITING, NUM_TOUCHED = 0, 1, 2


class Queue(NamedTuple):
    """A ring of buckets, each a list of cells.

    A cell whose cost falls gets one more entry; the old one is void and found to be so by its
    bucket not being that of the cell's cost. A cell has one entry at most in each bucket.
    """

    heads: NDArray[np.int32]
    """(NUM_BUCKETS,) first entry of each bucket."""
    cells: NDArray[np.int32]
    """(entries,) cell of each entry."""
    nexts: NDArray[np.int32]
    """(entries,) the entry after it, of its bucket or of those not in use."""
    state: NDArray[np.int32]
    """(3,) first entry not in use any more, number in use, number ever used."""


def make_queue(num_cells: int) -> Queue:
    """Return a queue for a grid of so many cells.

    Each of its neighbours and a seed can give a cell one entry, so that there is always room. Few
    are ever touched, and the system gives memory only for those.
    """
    entries = 9 * num_cells
    sizes = (NUM_BUCKETS, entries, entries, 3)
    return Queue(*(np.empty(size, dtype=np.int32) for size in sizes))


@kernel
def clear_queue(queue: Queue) -> None:
    """Empty a queue."""
    queue.heads[:] = NONE
    queue.state[FREE_ENTRY], queue.state[NUM_WAITING], queue.state[NUM_TOUCHED] = NONE, 0, 0


@kernel
def push(queue: Queue, cost: NDArray[np.int32], cell: int, new_cost: int) -> None:
    """Lower the cost of a cell, and put it into the bucket of that."""
    known = cost[cell]
    cost[cell] = new_cost
    if known != UNREACHED and known >> BUCKET_SHIFT == new_cost >> BUCKET_SHIFT:
        return
    state = queue.state
    entry = state[FREE_ENTRY]
    if entry == NONE:
        entry = state[NUM_TOUCHED]
        state[NUM_TOUCHED] += 1
    else:
        state[FREE_ENTRY] = queue.nexts[entry]
    slot = (new_cost >> BUCKET_SHIFT) & (NUM_BUCKETS - 1)
    queue.cells[entry], queue.nexts[entry] = cell, queue.heads[slot]
    queue.heads[slot] = entry
    state[NUM_WAITING] += 1


@kernel
def spread(  # noqa: C901, PLR0915 - see its docstring
    cost: NDArray[np.int32], weights: NDArray[np.uint8], queue: Queue, cols: int, bucket: int
) -> None:
    """Settle the cells of one bucket: offer each neighbour the way through them.

    Diagonal steps need both cells beside them: no corner is cut. The loop over the neighbours is
    unrolled by the compiler; with a call of `push` inside it the search takes three times as long.
    """
    heads, cells, nexts = queue.heads, queue.cells, queue.nexts
    free, waiting = queue.state[FREE_ENTRY], queue.state[NUM_WAITING]
    touched = queue.state[NUM_TOUCHED]
    entry = heads[bucket & (NUM_BUCKETS - 1)]
    heads[bucket & (NUM_BUCKETS - 1)] = NONE
    while entry != NONE:
        cell, after = cells[entry], nexts[entry]
        nexts[entry], free = free, entry
        entry, waiting = after, waiting - 1
        cost_here = cost[cell]
        if cost_here >> BUCKET_SHIFT != bucket:
            continue
        here = np.int32(weights[cell])
        north, south = weights[cell - cols], weights[cell + cols]
        west, east = weights[cell - 1], weights[cell + 1]
        for direction in range(8):
            if direction == 0:
                other, there = cell - cols, north
            elif direction == 1:
                other, there = cell + cols, south
            elif direction == 2:
                other, there = cell - 1, west
            elif direction == 3:
                other, there = cell + 1, east
            else:
                other = cell + (-cols if direction < 6 else cols)
                other += -1 if direction % 2 == 0 else 1
                # Read whether it counts or not: that spares a branch.
                ahead = weights[other]
                beside = north if direction < 6 else south
                is_free = beside != 0 and (west if direction % 2 == 0 else east) != 0
                there = ahead if is_free else np.uint8(0)
            length = np.int32(STEP if direction < 4 else DIAGONAL)
            through = cost_here + length * (here + np.int32(there))
            known = cost[other]
            if (through >= known) | (there == 0):
                continue
            cost[other] = through
            if known >> BUCKET_SHIFT == through >> BUCKET_SHIFT:
                continue
            fresh = free
            if fresh == NONE:
                fresh = touched
                touched += 1
            else:
                free = nexts[fresh]
            slot = (through >> BUCKET_SHIFT) & (NUM_BUCKETS - 1)
            cells[fresh], nexts[fresh] = other, heads[slot]
            heads[slot] = fresh
            waiting += 1
    queue.state[FREE_ENTRY], queue.state[NUM_WAITING] = free, waiting
    queue.state[NUM_TOUCHED] = touched


@kernel
def grow(
    cost: NDArray[np.int32],
    weights: NDArray[np.uint8],
    queue: Queue,
    seeds: NDArray[np.int32],
    cols: int,
    first: int,
    stop: tuple[int, int],
) -> int:
    """Go on with a search from what waits in the queue, and from seeds.

    Args:
        cost: (cells,), changed in place; those that wait are in it.
        weights: (cells,) row-major.
        queue: what waits; spans no more than the costliest step.
        seeds: (n, 2) cell and its cost, in the order of rising cost; lethal ones are left out.
        cols: cells in a row.
        first: no cell costs less that waits.
        stop: a cell, and how far to go on after it was reached [cost]; cell -1: everywhere.

    Returns:
        All costs below this are final.
    """
    stop_cell, slack = stop
    last = FARTHEST >> BUCKET_SHIFT
    seed, bucket = 0, first >> BUCKET_SHIFT
    while bucket <= last:
        if queue.state[NUM_WAITING] == 0:
            if seed == seeds.shape[0]:
                return UNREACHED
            bucket = max(bucket, seeds[seed, 1] >> BUCKET_SHIFT)
        while seed < seeds.shape[0] and seeds[seed, 1] >> BUCKET_SHIFT <= bucket:
            cell, price = seeds[seed, 0], seeds[seed, 1]
            if weights[cell] != 0 and price < cost[cell]:
                push(queue, cost, cell, price)
            seed += 1
        spread(cost, weights, queue, cols, bucket)
        if stop_cell >= 0 and cost[stop_cell] >> BUCKET_SHIFT <= bucket:
            last = min(last, (cost[stop_cell] + slack) >> BUCKET_SHIFT)
        bucket += 1
    return bucket << BUCKET_SHIFT


@kernel
def cost_to_go_into(
    out_cost: NDArray[np.int32],
    weights: NDArray[np.uint8],
    queue: Queue,
    seeds: NDArray[np.int32],
    cols: int,
    stop: tuple[int, int],
) -> int:
    """Write the cost of the cheapest way from each cell to the seeds.

    Args:
        out_cost: (cells,), overwritten; UNREACHED where there is no way, or where it was not
            looked for.
        weights: (cells,) row-major.
        queue: scratch.
        seeds: (n, 2) cell and its cost, in the order of rising cost; lethal ones are left out.
        cols: cells in a row.
        stop: a cell, and how far to go on after it was reached [cost]; cell -1: everywhere.

    Returns:
        All costs below this are final.
    """
    out_cost[:] = UNREACHED
    clear_queue(queue)
    return grow(out_cost, weights, queue, seeds, cols, 0, stop)


@kernel
def descend_into(
    out_cells: NDArray[np.int32],
    cost: NDArray[np.int32],
    weights: NDArray[np.uint8],
    start: int,
    cols: int,
) -> int:
    """Write the cells of the cheapest way from a cell to the seeds; return how many.

    Args:
        out_cells: (n,) written from index 0; the way ends where it is full.
        cost: (cells,) from `cost_to_go_into`.
        weights: (cells,) as given there.
        start: cell; must have been reached.
        cols: cells in a row.
    """
    cell, count = start, 0
    while count < out_cells.shape[0]:
        out_cells[count] = cell
        count += 1
        best, best_cost = cell, cost[cell]
        here = int(weights[cell])
        for row_step in (-1, 0, 1):
            for col_step in (-1, 0, 1):
                other = cell + row_step * cols + col_step
                if weights[other] == 0 or cost[other] == UNREACHED or other == cell:
                    continue
                length = STEP
                if row_step != 0 and col_step != 0:
                    if weights[cell + row_step * cols] == 0 or weights[cell + col_step] == 0:
                        continue
                    length = DIAGONAL
                through = cost[other] + length * (here + int(weights[other]))
                # Strictly downhill, so that the way ends.
                if cost[other] < cost[cell] and through <= best_cost:
                    best, best_cost = other, through
        if best == cell:
            break
        cell = best
    return count
