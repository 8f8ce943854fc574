"""Compiled loops of exploring: connected cells, ways over cells, and what a place would show.

Grids are (rows, cols) uint8, row-major; cells are numbered row * cols + col where one number is
needed. Kinds of cells: `FREE`, `UNKNOWN`, `BLOCKED`.
"""

import math

import numpy as np
from numpy.typing import NDArray

from trolley.gridmap.kernels import interpolate
from trolley.jit import kernel

FREE, UNKNOWN, BLOCKED = 0, 1, 2
STRAIGHT, DIAGONAL = 5, 7
"""Cost of a step; 7 / 5 is 1 % less than the square root of 2."""
NUM_BUCKETS = DIAGONAL + 1
UNREACHED = 2**31 - 1
NONE = -1
TOUCHES = 0.499
"""Distance from the centre of a cell that is not free within which it is touched [cells]."""


@kernel
def edge_into(out: NDArray[np.uint8], free: NDArray[np.uint8], beside: NDArray[np.uint8]) -> None:
    """Set the cells that are `free` and share an edge with one of `beside`.

    Args:
        out: (rows, cols), overwritten with 0 and 1.
        free: (rows, cols), set where not 0.
        beside: (rows, cols), set where not 0.

    Source:
        Yamauchi, A Frontier-Based Approach for Autonomous Exploration (1997), section 2.1.
    """
    rows, cols = free.shape
    for row in range(rows):
        for col in range(cols):
            out[row, col] = 0
            if free[row, col] and (
                (row > 0 and beside[row - 1, col])
                or (row + 1 < rows and beside[row + 1, col])
                or (col > 0 and beside[row, col - 1])
                or (col + 1 < cols and beside[row, col + 1])
            ):
                out[row, col] = 1


@kernel
def spread_into(
    out_cost: NDArray[np.int32],
    out_seed: NDArray[np.int32],
    passable: NDArray[np.uint8],
    seeds: NDArray[np.int32],
    limit: int,
) -> None:
    """Write the cost of the shortest way from the nearest seed to each cell, and that seed.

    A seed need not be passable itself.

    Args:
        out_cost: (rows, cols), overwritten; `STRAIGHT` a cell, `UNREACHED` where there is no way.
        out_seed: (rows, cols), overwritten; the number of the seed's cell, `NONE` if unreached.
        passable: (rows, cols), set where not 0.
        seeds: (n,) numbers of cells.
        limit: costlier ways are left out, below `UNREACHED - DIAGONAL`.

    Source:
        Dial, Algorithm 360: Shortest-Path Forest with Topological Ordering (1969), with the
        buckets as doubly linked lists, so that a cell has one entry only.
    """
    rows, cols = passable.shape
    size = passable.size
    heads = np.full(NUM_BUCKETS, NONE, np.int32)
    after = np.full(size, NONE, np.int32)
    before = np.full(size, NONE, np.int32)
    out_cost[:, :] = UNREACHED
    out_seed[:, :] = NONE
    waiting = 0
    for seed in seeds:
        if out_cost[seed // cols, seed % cols] != 0:
            out_cost[seed // cols, seed % cols] = 0
            out_seed[seed // cols, seed % cols] = seed
            _link(heads, after, before, 0, seed)
            waiting += 1
    cost = 0
    while waiting > 0:
        cell = heads[cost % NUM_BUCKETS]
        if cell == NONE:
            cost += 1
            continue
        _unlink(heads, after, before, cost % NUM_BUCKETS, cell)
        waiting -= 1
        row, col = cell // cols, cell % cols
        for r in range(max(row - 1, 0), min(row + 2, rows)):
            for c in range(max(col - 1, 0), min(col + 2, cols)):
                longer = cost + (STRAIGHT if r == row or c == col else DIAGONAL)
                known = out_cost[r, c]
                if passable[r, c] and longer < known and longer <= limit:
                    if known == UNREACHED:
                        waiting += 1
                    else:
                        _unlink(heads, after, before, known % NUM_BUCKETS, r * cols + c)
                    out_cost[r, c] = longer
                    out_seed[r, c] = out_seed[row, col]
                    _link(heads, after, before, longer % NUM_BUCKETS, r * cols + c)


@kernel
def _link(
    heads: NDArray[np.int32],
    after: NDArray[np.int32],
    before: NDArray[np.int32],
    bucket: int,
    cell: int,
) -> None:
    """Put a cell at the head of a bucket."""
    old = heads[bucket]
    after[cell], before[cell] = old, NONE
    if old != NONE:
        before[old] = cell
    heads[bucket] = cell


@kernel
def _unlink(
    heads: NDArray[np.int32],
    after: NDArray[np.int32],
    before: NDArray[np.int32],
    bucket: int,
    cell: int,
) -> None:
    """Take a cell out of its bucket."""
    left, right = before[cell], after[cell]
    if left == NONE:
        heads[bucket] = right
    else:
        after[left] = right
    if right != NONE:
        before[right] = left


@kernel
def unseen_from(
    kinds: NDArray[np.uint8], x: float, y: float, reach: float, rays: int, beyond: bool
) -> tuple[float, float, float]:
    """Return how much unknown floor a place would show if nothing stood in it, and where.

    Rays end at the first blocked cell, and at the edge of the grid unless they count beyond it.

    Args:
        kinds: (rows, cols).
        x: of the place, along the columns [cells].
        y: of the place, along the rows [cells].
        reach: length of the rays [cells].
        rays: number of them, all round.
        beyond: whether what lies off the grid counts as unknown, too.

    Returns:
        The area [cells], and the sum of its parts' directions along x and y, weighed by area.

    Source:
        González-Baños, Latombe, Navigation Strategies for Exploring Indoor Environments (2002),
        section 4.2: the area visible through the frontier.
    """
    rows, cols = kinds.shape
    step = 0.5
    wedge = 2.0 * math.pi / rays
    area, along_x, along_y = 0.0, 0.0, 0.0
    for ray in range(rays):
        dx, dy = math.cos(ray * wedge), math.sin(ray * wedge)
        seen, r = 0.0, step
        while r <= reach:
            col, row = math.floor(x + r * dx), math.floor(y + r * dy)
            is_on_grid = 0 <= row < rows and 0 <= col < cols
            if kinds[row, col] == BLOCKED if is_on_grid else not beyond:
                break
            if not is_on_grid or kinds[row, col] == UNKNOWN:
                seen += r * step * wedge
            r += step
        area += seen
        along_x += seen * dx
        along_y += seen * dy
    return area, along_x, along_y


@kernel
def fits_into(
    out: NDArray[np.bool_],
    room: NDArray[np.float32],
    places: NDArray[np.int32],
    outline: NDArray[np.float64],
    turns: int,
) -> None:
    """Say of each place whether a robot that stands there covers free cells only, however turned.

    Args:
        out: (n,), overwritten.
        room: (rows, cols) how far each cell is from the nearest that is not free [cells].
        places: (n,) numbers of cells.
        outline: (m, 2) points on the robot's outline, less than a cell apart [cells].
        turns: number of headings, all round, that are tried.
    """
    for index in range(len(places)):
        out[index] = not math.isnan(fitting_yaw(room, places[index], 0.0, outline, turns))


@kernel
def fitting_yaw(
    room: NDArray[np.float32],
    place: int,
    yaw: float,
    outline: NDArray[np.float64],
    turns: int,
) -> float:
    """Return the heading nearest to one wanted in which a robot covers free cells only, or NaN.

    Args:
        room: (rows, cols) how far each cell is from the nearest that is not free [cells].
        place: number of the cell in whose middle the robot stands.
        yaw: the heading that is wanted [rad].
        outline: (m, 2) points on the robot's outline, less than a cell apart [cells].
        turns: number of headings, all round, that are tried.
    """
    x, y = place % room.shape[1] + 0.5, place // room.shape[1] + 0.5
    step = 2.0 * math.pi / turns
    nearest = round(yaw / step)
    for turn in range(turns):
        aside = (turn + 1) // 2 if turn % 2 else -(turn // 2)
        tried = step * ((nearest + aside) % turns)
        cos, sin = math.cos(tried), math.sin(tried)
        does_fit = True
        for index in range(outline.shape[0]):
            ahead, left = outline[index, 0], outline[index, 1]
            at_x, at_y = x + cos * ahead - sin * left, y + sin * ahead + cos * left
            if interpolate(room, at_x - 0.5, at_y - 0.5) < TOUCHES:
                does_fit = False
                break
        if does_fit:
            return tried
    return math.nan
