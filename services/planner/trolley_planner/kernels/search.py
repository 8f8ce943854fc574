"""Compiled shortest paths over grids of weights: cost-to-go with a bucket queue, and descent.

Costs are whole numbers: one straight step over free cells costs `STEP * 2 * WEIGHT_UNIT`. The
outermost cells of every grid are lethal, so that no neighbour has to be tested for the edge.

Source:
    Dial, Algorithm 360: Shortest-Path Forest with Topological Ordering (1969).
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel

STEP, DIAGONAL = 5, 7
"""Lengths of the two kinds of steps: 7 / 5 is 1 % less than the square root of 2."""
UNREACHED = 2**31 - 1
"""Cost-to-go of cells that were not reached."""
NUM_BUCKETS = 4096
"""More than the costliest step: DIAGONAL * (255 + 255)."""
NONE = -1


class Queue(NamedTuple):
    """A ring of buckets, each a doubly linked list of cells of one cost."""

    heads: NDArray[np.int32]
    """(NUM_BUCKETS,)."""
    nexts: NDArray[np.int32]
    """(cells,)."""
    previous: NDArray[np.int32]
    """(cells,)."""


@kernel
def push(
    heads: NDArray[np.int32],
    nexts: NDArray[np.int32],
    previous: NDArray[np.int32],
    cell: int,
    cost: int,
) -> None:
    """Put a cell at the head of the bucket of its cost."""
    bucket = cost & (NUM_BUCKETS - 1)
    head = heads[bucket]
    nexts[cell] = head
    previous[cell] = NONE
    if head != NONE:
        previous[head] = cell
    heads[bucket] = cell


@kernel
def unlink(
    heads: NDArray[np.int32],
    nexts: NDArray[np.int32],
    previous: NDArray[np.int32],
    cell: int,
    cost: int,
) -> None:
    """Take a cell out of the bucket of its cost."""
    before, after = previous[cell], nexts[cell]
    if before == NONE:
        heads[cost & (NUM_BUCKETS - 1)] = after
    else:
        nexts[before] = after
    if after != NONE:
        previous[after] = before


@kernel
def enter_seeds(
    out_cost: NDArray[np.int32],
    weights: NDArray[np.uint8],
    queue: Queue,
    seeds: NDArray[np.int32],
    first: int,
    cost: int,
) -> tuple[int, int]:
    """Put the seeds of at most this cost into the queue.

    Returns:
        The next seed, and how many more cells the queue holds.
    """
    entered = 0
    while first < seeds.shape[0] and seeds[first, 1] <= cost:
        cell = int(seeds[first, 0])
        if weights[cell] != 0 and out_cost[cell] > cost:
            if out_cost[cell] != UNREACHED:
                unlink(queue.heads, queue.nexts, queue.previous, cell, int(out_cost[cell]))
                entered -= 1
            out_cost[cell] = cost
            push(queue.heads, queue.nexts, queue.previous, cell, cost)
            entered += 1
        first += 1
    return first, entered


@kernel
def spread(  # noqa: C901 - see its docstring
    cost_to_go: NDArray[np.int32], weights: NDArray[np.uint8], queue: Queue, cols: int, cost: int
) -> tuple[int, int]:
    """Settle the cells of one cost; return how many, and how many came newly into the queue.

    Diagonal steps need both cells beside them: no corner is cut. All is written out in one loop,
    since calls for each cell or neighbour would triple the time of the search.
    """
    heads, nexts, previous = queue.heads, queue.nexts, queue.previous
    settled = new = 0
    bucket = cost & (NUM_BUCKETS - 1)
    cell = heads[bucket]
    while cell != NONE:
        heads[bucket] = nexts[cell]
        if nexts[cell] != NONE:
            previous[nexts[cell]] = NONE
        settled += 1
        here = np.int32(weights[cell])
        for row_step in (-cols, 0, cols):
            for col_step in (-1, 0, 1):
                other = cell + row_step + col_step
                there = np.int32(weights[other])
                if there == 0 or other == cell:
                    continue
                length = STEP
                if row_step != 0 and col_step != 0:
                    if weights[cell + row_step] == 0 or weights[cell + col_step] == 0:
                        continue
                    length = DIAGONAL
                through = cost + length * (here + there)
                known = cost_to_go[other]
                if through >= known:
                    continue
                if known == UNREACHED:
                    new += 1
                else:
                    before, after = previous[other], nexts[other]
                    if before == NONE:
                        heads[known & (NUM_BUCKETS - 1)] = after
                    else:
                        nexts[before] = after
                    if after != NONE:
                        previous[after] = before
                cost_to_go[other] = through
                head = heads[through & (NUM_BUCKETS - 1)]
                nexts[other], previous[other] = head, NONE
                if head != NONE:
                    previous[head] = other
                heads[through & (NUM_BUCKETS - 1)] = other
        cell = heads[bucket]
    return settled, new


@kernel
def cost_to_go_into(
    out_cost: NDArray[np.int32],
    weights: NDArray[np.uint8],
    queue: Queue,
    seeds: NDArray[np.int32],
    cols: int,
    stop: tuple[int, int],
) -> None:
    """Write the cost of the cheapest way from each cell to the seeds.

    Args:
        out_cost: (cells,), overwritten; UNREACHED where there is no way, or where it was not
            looked for.
        weights: (cells,) row-major, 0 = lethal; the outermost cells must be.
        queue: scratch.
        seeds: (n, 2) cell and its cost, in the order of rising cost; lethal ones are left out.
        cols: cells in a row.
        stop: a cell, and how far to go on after it was reached [cost]; cell -1: everywhere.
    """
    out_cost[:] = UNREACHED
    queue.heads[:] = NONE
    stop_cell, slack = stop
    limit = UNREACHED - 1
    waiting, seed, cost = 0, 0, 0
    while cost <= limit:
        if waiting == 0:
            if seed == seeds.shape[0]:
                break
            cost = max(cost, seeds[seed, 1])
        if seed < seeds.shape[0]:
            seed, entered = enter_seeds(out_cost, weights, queue, seeds, seed, cost)
            waiting += entered
        if queue.heads[cost & (NUM_BUCKETS - 1)] != NONE:
            settled, new = spread(out_cost, weights, queue, cols, cost)
            waiting += new - settled
            if stop_cell >= 0 and out_cost[stop_cell] <= cost:
                limit = min(limit, out_cost[stop_cell] + slack)
        cost += 1


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


@kernel
def segment_cost(weights: NDArray[np.uint8], x1: float, y1: float, x2: float, y2: float) -> float:
    """Return the cost of a straight line, in weights times cells; +inf if it meets a lethal cell.

    Args:
        weights: (rows, cols).
        x1: start [cells].
        y1: start [cells].
        x2: end [cells].
        y2: end [cells].
    """
    length = math.hypot(x2 - x1, y2 - y1)
    count = max(1, math.ceil(2.5 * length))
    total = 0.0
    for index in range(count):
        share = (index + 0.5) / count
        weight = weights[math.floor(y1 + share * (y2 - y1)), math.floor(x1 + share * (x2 - x1))]
        if weight == 0:
            return math.inf
        total += weight
    return total * length / count


@kernel
def polyline_cost(weights: NDArray[np.uint8], points: NDArray[np.float64], blocked: float) -> float:
    """Return the cost of a polyline (n, 2) [cells], in weights times cells.

    Args:
        weights: (rows, cols).
        points: (n, 2) x, y.
        blocked: cost of a cell's length over lethal cells; may be infinite.
    """
    total = 0.0
    for index in range(1, points.shape[0]):
        x1, y1, x2, y2 = (
            points[index - 1, 0],
            points[index - 1, 1],
            points[index, 0],
            points[index, 1],
        )
        part = segment_cost(weights, x1, y1, x2, y2)
        total += math.hypot(x2 - x1, y2 - y1) * blocked if math.isinf(part) else part
    return total


@kernel
def shortcut_into(
    out_kept: NDArray[np.int32],
    weights: NDArray[np.uint8],
    points: NDArray[np.float64],
    reach: int,
    allowance: float,
) -> int:
    """Write the points that are left when straight lines replace every detour that is no cheaper.

    Args:
        out_kept: (n,) indices of the points kept, first and last among them.
        weights: (rows, cols).
        points: (n, 2) x, y [cells].
        reach: a line replaces at most this many points.
        allowance: how much dearer a line may be than the points it replaces, as a factor.

    Returns:
        The number of points kept.
    """
    count = points.shape[0]
    along = np.zeros(count)
    for index in range(1, count):
        step = segment_cost(
            weights, points[index - 1, 0], points[index - 1, 1], points[index, 0], points[index, 1]
        )
        along[index] = along[index - 1] + step
    out_kept[0] = 0
    kept, anchor = 1, 0
    while anchor < count - 1:
        chosen = anchor + 1
        for index in range(min(count - 1, anchor + reach), anchor + 1, -1):
            line = segment_cost(
                weights, points[anchor, 0], points[anchor, 1], points[index, 0], points[index, 1]
            )
            if line <= allowance * (along[index] - along[anchor]):
                chosen = index
                break
        out_kept[kept] = chosen
        kept += 1
        anchor = chosen
    return kept


@kernel
def smooth(
    points: NDArray[np.float64], weights: NDArray[np.uint8], fixed: NDArray[np.uint8], rounds: int
) -> None:
    """Pull a path straight where that makes it cheaper: each point between its neighbours.

    Args:
        points: (n, 2) x, y [cells], changed in place; neighbours about evenly spaced.
        weights: (rows, cols); no point moves into a lethal cell or makes its two lines dearer
            by more than it makes them straighter.
        fixed: (n,) 1 where a point must stay; the first and the last always do.
        rounds: passes over all points.
    """
    for _ in range(rounds):
        for index in range(1, points.shape[0] - 1):
            if fixed[index]:
                continue
            x, y = points[index, 0], points[index, 1]
            ax, ay = points[index - 1, 0], points[index - 1, 1]
            bx, by = points[index + 1, 0], points[index + 1, 1]
            new_x, new_y = 0.5 * x + 0.25 * (ax + bx), 0.5 * y + 0.25 * (ay + by)
            before = segment_cost(weights, ax, ay, x, y) + segment_cost(weights, x, y, bx, by)
            after = segment_cost(weights, ax, ay, new_x, new_y)
            after += segment_cost(weights, new_x, new_y, bx, by)
            if after <= 1.02 * before:
                points[index, 0], points[index, 1] = new_x, new_y
