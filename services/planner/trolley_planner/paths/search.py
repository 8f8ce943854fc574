"""Compiled shortest paths over grids of weights: cost-to-go with a bucket queue, and descent.

Costs are whole numbers: one straight step over free cells costs `STEP * 2 * WEIGHT_UNIT`. Every
weight is `LETHAL` or at least `WEIGHT_UNIT`, and the outermost cells of every grid are lethal, so
that no neighbour has to be tested for the edge.

Paths keep to 8 or to 16 directions. The 8 more are the moves of a knight; along 8 directions a
path may be 8 % longer than a straight line, and so lead around the wrong side of an obstacle; along
16 it is 3 %. 16 take nearly twice as long.

Source:
    Dial, Algorithm 360: Shortest-Path Forest with Topological Ordering (1969). Buckets no wider
    than the cheapest step, so that the order inside one does not matter: Denardo and Fox,
    Shortest-Route Methods: 1. Reaching, Pruning, and Buckets (1979).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel, lean_kernel

STEP, DIAGONAL, KNIGHT = 17, 24, 19
"""Cost of steps, times the weights of the cells on the way: 2, 2, and 4 cells for a knight.

24 / 17 is 0.17 % less than the square root of 2, 2 * 19 / 17 is 0.04 % less than that of 5.
"""
MOST_DIRECTIONS = 16
UNREACHED = 2**31 - 1
"""Cost-to-go of cells that were not reached."""
COSTLIEST_STEP = KNIGHT * 4 * 255
FARTHEST = UNREACHED - COSTLIEST_STEP
"""Searches end here: after 780 km of free floor in cells of 5 cm, 80 km beside walls."""
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
    """Return a queue for a grid of this many cells.

    Each of its neighbours and a seed can give a cell one entry, so that there is always room. Few
    are ever touched, and the system gives memory only for those.
    """
    entries = (MOST_DIRECTIONS + 1) * num_cells
    sizes = (NUM_BUCKETS, entries, entries, 3)
    return Queue(*(np.empty(size, dtype=np.int32) for size in sizes))


@lean_kernel
def clear_queue(queue: Queue) -> None:
    """Empty a queue."""
    queue.heads[:] = NONE
    queue.state[FREE_ENTRY], queue.state[NUM_WAITING], queue.state[NUM_TOUCHED] = NONE, 0, 0


@lean_kernel
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


@lean_kernel
def spread(  # noqa: C901, PLR0915 - see its docstring
    cost: NDArray[np.int32], weights: NDArray[np.uint8], queue: Queue, cols: int, bucket: int
) -> None:
    """Settle the cells of one bucket: offer each neighbour the path through them.

    Diagonal steps need both cells beside them: no corner is cut. The loop over the neighbours is
    unrolled by the compiler; with a call of `push` inside it the search takes three times as long.
    Indices have no sign, so that none is tested for counting from the end: a quarter of the time.
    """
    heads, cells, nexts = queue.heads, queue.cells, queue.nexts
    free, waiting = queue.state[FREE_ENTRY], queue.state[NUM_WAITING]
    touched = queue.state[NUM_TOUCHED]
    ring = np.uintp(bucket & (NUM_BUCKETS - 1))
    entry = heads[ring]
    heads[ring] = NONE
    wide, one = np.uintp(cols), np.uintp(1)
    while entry != NONE:
        at = np.uintp(entry)
        cell, after = np.uintp(cells[at]), nexts[at]
        nexts[at], free = free, entry
        entry, waiting = after, waiting - 1
        cost_here = cost[cell]
        if cost_here >> BUCKET_SHIFT != bucket:
            continue
        here = np.int32(weights[cell])
        above, below = cell - wide, cell + wide
        north, south = weights[above], weights[below]
        west, east = weights[cell - one], weights[cell + one]
        for direction in range(8):
            if direction == 0:
                other, there = above, north
            elif direction == 1:
                other, there = below, south
            elif direction == 2:
                other, there = cell - one, west
            elif direction == 3:
                other, there = cell + one, east
            else:
                row = above if direction < 6 else below
                other = row - one if direction % 2 == 0 else row + one
                ahead = weights[other]
                beside = north if direction < 6 else south
                is_free = (beside != 0) & ((west if direction % 2 == 0 else east) != 0)
                there = ahead if is_free else np.uint8(0)
            length = np.int32(STEP if direction < 4 else DIAGONAL)
            through = np.int32(cost_here + length * (here + np.int32(there)))
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
                free = nexts[np.uintp(fresh)]
            slot = np.uintp((through >> BUCKET_SHIFT) & (NUM_BUCKETS - 1))
            cells[np.uintp(fresh)], nexts[np.uintp(fresh)] = other, heads[slot]
            heads[slot] = fresh
            waiting += 1
    queue.state[FREE_ENTRY], queue.state[NUM_WAITING] = free, waiting
    queue.state[NUM_TOUCHED] = touched


@lean_kernel
def leap(  # noqa: C901 - in one piece for its speed, as `spread`
    cost: NDArray[np.int32], weights: NDArray[np.uint8], queue: Queue, cols: int, bucket: int
) -> None:
    """Offer the cells that a knight reaches from those of one bucket the path through them.

    A knight passes through the cell beside it and the one across. It leaps over even ground only,
    where these weigh the same, and does not go past cells that were reached before, since these
    reach what lies behind them by themselves. The bucket itself stays as it is: no move ends in it.
    """
    heads, cells, nexts = queue.heads, queue.cells, queue.nexts
    free, waiting = queue.state[FREE_ENTRY], queue.state[NUM_WAITING]
    touched = queue.state[NUM_TOUCHED]
    entry = heads[bucket & (NUM_BUCKETS - 1)]
    while entry != NONE:
        cell = cells[entry]
        entry = nexts[entry]
        cost_here = cost[cell]
        if cost_here >> BUCKET_SHIFT != bucket:
            continue
        here = np.int32(weights[cell])
        for side in range(4):
            if side == 0:
                forth, across_by = -cols, 1
            elif side == 1:
                forth, across_by = cols, 1
            elif side == 2:
                forth, across_by = -1, cols
            else:
                forth, across_by = 1, cols
            beside = weights[cell + forth]
            if beside != here or cost[cell + forth] < cost_here:
                continue
            ends = here + np.int32(beside)
            for turn in range(2):
                aside = across_by if turn == 0 else -across_by
                across = weights[cell + forth + aside]
                if across != here or cost[cell + forth + aside] < cost_here:
                    continue
                other = cell + 2 * forth + aside
                there = weights[other]
                price = np.int32(KNIGHT) * (ends + np.int32(across) + np.int32(there))
                through, known = cost_here + price, cost[other]
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
    directions: int,
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
        directions: 8 or 16.

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
        if directions == MOST_DIRECTIONS:
            leap(cost, weights, queue, cols, bucket)
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
    directions: int,
) -> int:
    """Write the cost of the cheapest path from each cell to the seeds.

    Args:
        out_cost: (cells,), overwritten; UNREACHED where there is no path, or where it was not
            looked for.
        weights: (cells,) row-major.
        queue: scratch.
        seeds: (n, 2) cell and its cost, in the order of rising cost; lethal ones are left out.
        cols: cells in a row.
        stop: a cell, and how far to go on after it was reached [cost]; cell -1: everywhere.
        directions: 8 or 16.

    Returns:
        All costs below this are final.
    """
    out_cost[:] = UNREACHED
    clear_queue(queue)
    return grow(out_cost, weights, queue, seeds, cols, 0, stop, directions)


@kernel
def descend_into(
    out_cells: NDArray[np.int32],
    cost: NDArray[np.int32],
    weights: NDArray[np.uint8],
    start: int,
    cols: int,
    directions: int,
) -> int:
    """Write the cells of the cheapest path from a cell to the seeds; return how many.

    Args:
        out_cells: (n,) written from index 0; the path ends where it is full.
        cost: (cells,) from `cost_to_go_into`.
        weights: (cells,) as given there.
        start: cell; must have been reached.
        cols: cells in a row.
        directions: as given there.
    """
    cell, count = start, 0
    reach = 1 if directions == 8 else 2
    while count < out_cells.shape[0]:
        out_cells[count] = cell
        count += 1
        best, best_cost = cell, cost[cell]
        for row_step in range(-reach, reach + 1):
            for col_step in range(-reach, reach + 1):
                price = price_of_step(weights, cell, row_step, col_step, cols)
                if price == 0:
                    continue
                other = cell + row_step * cols + col_step
                through = cost[other] + price
                # Strictly downhill, so that the path ends.
                if cost[other] < cost[cell] and through <= best_cost:
                    best, best_cost = other, through
        if best == cell:
            break
        cell = best
    return count


@lean_kernel
def price_of_step(
    weights: NDArray[np.uint8], cell: int, row_step: int, col_step: int, cols: int
) -> int:
    """Return what one of the 16 steps from a cell costs, 0 if it is none of them or blocked."""
    rows_apart, cols_apart = abs(row_step), abs(col_step)
    here, other = int(weights[cell]), cell + row_step * cols + col_step
    if rows_apart + cols_apart == 1:
        return STEP * (here + int(weights[other])) if weights[other] else 0
    if rows_apart == 0 or cols_apart == 0 or rows_apart + cols_apart == 4:
        return 0
    row_sign, col_sign = row_step // rows_apart, col_step // cols_apart
    tall, wide = int(weights[cell + row_sign * cols]), int(weights[cell + col_sign])
    if rows_apart == cols_apart:
        passes = weights[other] and tall and wide
        return DIAGONAL * (here + int(weights[other])) if passes else 0
    beside = tall if rows_apart == 2 else wide
    across = int(weights[cell + row_sign * cols + col_sign])
    # The last cell may lie outside the grid where these two are lethal.
    if beside == 0 or across == 0 or weights[other] == 0:
        return 0
    return KNIGHT * (here + beside + across + int(weights[other]))
