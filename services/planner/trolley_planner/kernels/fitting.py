"""Compiled checks of the footprint along a path, and a way through where it fits only by turning.

Poses are in frame `grid` [m]; distances are those of the costmap.

Source:
    Headings of lattice steps, so that every pose lies on a cell's centre: Pivtoraiko and Kelly,
    Generating near minimal spanning control sets for constrained motion planning in discrete
    state spaces (2005). Cheapest first: Dijkstra, A Note on Two Problems (1959).
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel
from trolley_planner.kernels.clearance import Body, Field, clearance_at
from trolley_planner.kernels.lines import segment_cost

HEADINGS = 16
STEPS = np.array(
    [
        *([1, 0], [2, 1], [1, 1], [1, 2], [0, 1], [-1, 2], [-1, 1], [-2, 1]),
        *([-1, 0], [-2, -1], [-1, -1], [-1, -2], [0, -1], [1, -2], [1, -1], [2, -1]),
    ],
    dtype=np.int64,
)
"""(HEADINGS, 2) columns and rows of the step in the direction of each heading."""
LEEWAY = 0.15
"""The robot need not look exactly along its path [rad]."""
TURN_CELLS = 3.0
"""A turn in place to the next heading costs as much as so many free cells."""
FITS, TOUCHES = 1, 2


class Box(NamedTuple):
    """The part of the grid that is searched [cells]."""

    row: int
    col: int
    rows: int
    cols: int


@kernel
def fits(field: Field, body: Body, x: float, y: float, yaw: float, give_m: float) -> bool:
    """Say whether nothing reaches more than `give_m` into the footprint at a pose."""
    return clearance_at(field, body, x, y, yaw, 0.01) >= -give_m


@kernel
def check_into(
    out_fits: NDArray[np.bool_],
    field: Field,
    body: Body,
    points: NDArray[np.float64],
    around: int,
    give_m: float,
) -> None:
    """Write at which points of a path the footprint fits, looking about along the path.

    Args:
        out_fits: (n,).
        field: distances of the whole costmap.
        body: the outline.
        points: (n, 2).
        around: the heading is that from so many points before to so many points after.
        give_m: see `fits`.
    """
    last = points.shape[0] - 1
    for index in range(last + 1):
        before, after = max(index - around, 0), min(index + around, last)
        x, y = points[index, 0], points[index, 1]
        row, col = math.floor(y / field.fine_m), math.floor(x / field.fine_m)
        if field.distance_m[row, col] > body.circumscribed_m + 2.0 * field.fine_m:
            out_fits[index] = True
            continue
        yaw = math.atan2(points[after, 1] - points[before, 1], points[after, 0] - points[before, 0])
        out_fits[index] = (
            fits(field, body, x, y, yaw, give_m)
            or fits(field, body, x, y, yaw + LEEWAY, give_m)
            or fits(field, body, x, y, yaw - LEEWAY, give_m)
        )


@kernel
def heading_of(yaw: float) -> int:
    """Return the heading nearest to a direction [rad]."""
    best, best_dot = 0, -2.0
    for heading in range(HEADINGS):
        dx, dy = float(STEPS[heading, 0]), float(STEPS[heading, 1])
        dot = (dx * math.cos(yaw) + dy * math.sin(yaw)) / math.hypot(dx, dy)
        if dot > best_dot:
            best, best_dot = heading, dot
    return best


@kernel
def sift_up(heap: NDArray[np.float64], at: int, key: float, state: int) -> None:
    """Put a state into a binary heap (n, 2) of keys and states, from its end `at` on."""
    while at > 0 and heap[(at - 1) // 2, 0] > key:
        heap[at] = heap[(at - 1) // 2]
        at = (at - 1) // 2
    heap[at, 0], heap[at, 1] = key, state


@kernel
def take_first(heap: NDArray[np.float64], size: int) -> int:
    """Take the state with the least key out of a heap of `size`; return it."""
    first = int(heap[0, 1])
    key, moved = heap[size - 1, 0], heap[size - 1, 1]
    at, last = 0, size - 1
    while 2 * at + 1 < last:
        below = 2 * at + 1
        if below + 1 < last and heap[below + 1, 0] < heap[below, 0]:
            below += 1
        if heap[below, 0] >= key:
            break
        heap[at] = heap[below]
        at = below
    heap[at, 0], heap[at, 1] = key, moved
    return first


@kernel
def can_be(
    known: NDArray[np.uint8],
    state: int,
    box: Box,
    field: Field,
    body: Body,
    give_m: float,
) -> bool:
    """Say whether the footprint fits in a state, and half a turn step from it to the left.

    Args:
        known: (states,) FITS or TOUCHES where it is known, else 0; changed.
        state: (row * cols + col) * 2 * HEADINGS + twice the heading, or one more for half-way.
        box: of the states.
        field: distances of the costmap.
        body: the outline.
        give_m: see `fits`.
    """
    if known[state] == 0:
        heading, cell = state % (2 * HEADINGS), state // (2 * HEADINGS)
        step = STEPS[heading // 2]
        yaw = math.atan2(step[1], step[0])
        if heading % 2:
            after = STEPS[(heading // 2 + 1) % HEADINGS]
            turn = math.atan2(after[1], after[0]) - yaw
            yaw += 0.5 * (turn if turn > 0.0 else turn + 2.0 * math.pi)
        x = field.x + (box.col + cell % box.cols + 0.5) * field.fine_m
        y = field.y + (box.row + cell // box.cols + 0.5) * field.fine_m
        known[state] = FITS if fits(field, body, x, y, yaw, give_m) else TOUCHES
    return known[state] == FITS


@kernel
def move(weights: NDArray[np.uint8], box: Box, state: int, turn: int) -> tuple[int, int, float]:
    """Return where one move leads: a step ahead, or a turn in place to a heading beside.

    Args:
        weights: (rows, cols) of the costmap.
        box: of the states.
        state: cell * HEADINGS + heading.
        turn: 0 for a step ahead, 1 to the left, -1 to the right.

    Returns:
        The next state, what must be free on the way besides (numbered as in `can_be`), and the
        cost, +inf where a lethal cell or the edge of the box is in the way.
    """
    cell, heading = state // HEADINGS, state % HEADINGS
    row, col = cell // box.cols, cell % box.cols
    if turn != 0:
        other = cell * HEADINGS + (heading + turn) % HEADINGS
        # Half-way between two headings is numbered with the one on the right.
        on_way = 2 * (state if turn > 0 else other) + 1
        return other, on_way, TURN_CELLS * weights[box.row + row, box.col + col]
    to_row, to_col = row + STEPS[heading, 1], col + STEPS[heading, 0]
    if not (0 <= to_row < box.rows and 0 <= to_col < box.cols):
        return state, 2 * state, math.inf
    x, y = box.col + col + 0.5, box.row + row + 0.5
    to_x, to_y = box.col + to_col + 0.5, box.row + to_row + 0.5
    other = (to_row * box.cols + to_col) * HEADINGS + heading
    return other, 2 * other, segment_cost(weights, x, y, to_x, to_y, math.inf)


@kernel
def trace_back(previous: NDArray[np.int64], last: int) -> NDArray[np.int64]:
    """Return the cells of the states that led to the last, from the first on."""
    length = 0
    state = last
    while state >= 0:
        length += 1
        state = previous[state]
    way = np.empty(length, dtype=np.int64)
    state = last
    for index in range(length - 1, -1, -1):
        way[index] = state // HEADINGS
        state = previous[state]
    return way


@kernel
def thread(
    weights: NDArray[np.uint8],
    field: Field,
    body: Body,
    box: Box,
    ends: tuple[int, int, int, int],
    give_m: float,
) -> NDArray[np.int64]:
    """Return the cheapest way through a box along which the footprint fits, driven forwards.

    Args:
        weights: (rows, cols) of the costmap.
        field: distances of the costmap.
        body: the outline.
        box: where the way may lead; must not hold the outermost cells of the grid.
        ends: cell of the box and heading at the start; the same at the end, where the heading
            may differ by one.
        give_m: see `fits`.

    Returns:
        (n,) cells of the box from start to end; none where there is no way.
    """
    count = box.rows * box.cols * HEADINGS
    known = np.zeros(2 * count, dtype=np.uint8)
    cost = np.full(count, np.inf)
    previous = np.full(count, -1, dtype=np.int64)
    heap = np.empty((3 * count + 1, 2))
    first = ends[0] * HEADINGS + ends[1]
    cost[first] = 0.0
    sift_up(heap, 0, 0.0, first)
    size = 1
    while size > 0:
        key = heap[0, 0]
        state = take_first(heap, size)
        size -= 1
        if key > cost[state]:
            continue
        off = abs(state % HEADINGS - ends[3])
        if state // HEADINGS == ends[2] and min(off, HEADINGS - off) <= 1:
            return trace_back(previous, state)
        for turn in range(-1, 2):
            other, on_way, price = move(weights, box, state, turn)
            if key + price >= cost[other]:
                continue
            if not can_be(known, 2 * other, box, field, body, give_m):
                continue
            if not can_be(known, on_way, box, field, body, give_m):
                continue
            cost[other], previous[other] = key + price, state
            sift_up(heap, size, key + price, other)
            size += 1
    return np.empty(0, dtype=np.int64)
