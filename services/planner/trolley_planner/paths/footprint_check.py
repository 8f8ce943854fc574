"""Whether the footprint fits along a path, and how else it may get through."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel
from trolley_planner.costmap.footprint import NO_LIMITS, Body, Field, Footprint, clearance_at
from trolley_planner.paths.heap import sift_up, take_first
from trolley_planner.paths.path import SPACING_M, segment_cost, subdivide


class FootprintCheckParams(NamedTuple):
    """How a footprint is led through narrow places; all by hand."""

    around: int = 2
    """The heading at a point is that between the points this many before and after it."""
    start_m: float = 0.5
    """Places this near to the start"""
    end_m: float = 0.4
    """and this near to the end may be tight and still be right [m]."""
    lead_m: float = 1.0
    """A passage is looked for from this far before a tight place to this far behind it [m],"""
    margin_m: float = 0.8
    """and this far to the sides of the path [m]."""
    give_cells: float = 0.25
    """Obstacles may reach this far into the footprint: what is seen lies anywhere in its
    cell."""
    leeway_rad: float = 0.15
    """The robot need not look exactly along its path."""
    turn_cells: float = 3.0
    """A turn in place to the next heading costs as much as this many free cells."""


CHECK = FootprintCheckParams()
HEADINGS = 16
STEPS = np.array(
    [
        *([1, 0], [2, 1], [1, 1], [1, 2], [0, 1], [-1, 2], [-1, 1], [-2, 1]),
        *([-1, 0], [-2, -1], [-1, -1], [-1, -2], [0, -1], [1, -2], [1, -1], [2, -1]),
    ],
    dtype=np.int64,
)
"""(HEADINGS, 2) columns and rows of the step in the direction of each heading."""
FITS, TOUCHES = 1, 2


class Box(NamedTuple):
    """The part of the grid that is searched [cells]."""

    row: int
    col: int
    rows: int
    cols: int


@dataclass(frozen=True, slots=True, eq=False)
class CheckedPath:
    """What became of a path.

    Attributes:
        points: (n, 2) [m] the path, changed where the footprint fits only in another way.
        narrow: a point [m] where it does not get through at all, None if it does everywhere.
    """

    points: NDArray[np.float64]
    narrow: tuple[float, float] | None


class FootprintCheck:
    """Checks paths for one footprint.

    Args:
        footprint: of the robot.
        resolution_m: edge of a cell of the costmap.
    """

    def __init__(self, footprint: Footprint, resolution_m: float) -> None:
        self._body = footprint.body
        self._edge_m = resolution_m
        self._is_round = footprint.circumscribed_m <= footprint.inscribed_m + resolution_m

    def check(
        self,
        points: NDArray[np.float64],
        weights: NDArray[np.uint8],
        distance_m: NDArray[np.float32],
        give_cells: float = CHECK.give_cells,
    ) -> CheckedPath:
        """Lead a path through where the footprint fits.

        Args:
            points: (n, 2) [m].
            weights: (rows, cols) of the costmap.
            distance_m: (rows, cols) to the nearest obstacle.
            give_cells: how far obstacles may reach into the footprint; what is seen lies anywhere
                in its cell.
        """
        if self._is_round:
            return CheckedPath(points, None)
        edge = self._edge_m
        field = Field(distance_m, NO_LIMITS, NO_LIMITS, 0.0, 0.0, edge, edge, edge)
        done = 0
        while True:
            wrong = self._first_misfit(points, field, done, give_cells * edge)
            if wrong is None:
                return CheckedPath(points, None)
            first, last = wrong
            start, end = self._turning_places(points, field, first, last)
            passage = self._find_passage(points, weights, field, (start, end), give_cells * edge)
            if passage is None:
                x, y = points[(first + last) // 2]
                return CheckedPath(points, (float(x), float(y)))
            points = np.concatenate([points[: start + 1], passage, points[end:]])
            done = start + 1 + len(passage)

    def _first_misfit(
        self, points: NDArray[np.float64], field: Field, done: int, give_m: float
    ) -> tuple[int, int] | None:
        """Return the first and last point of the next stretch where the footprint does not fit."""
        steps = np.diff(points, axis=0)
        along = np.append(0.0, np.cumsum(np.hypot(steps[:, 0], steps[:, 1])))
        fits = np.ones(len(points), dtype=np.bool_)
        check_into(fits, field, self._body, points, CHECK.around, give_m)
        fits |= (along < CHECK.start_m) | (along > along[-1] - CHECK.end_m)
        fits[:done] = True
        misfits = np.flatnonzero(~fits)
        if misfits.size == 0:
            return None
        first = int(misfits[0])
        after = np.flatnonzero(fits[first:])
        return first, first + int(after[0]) - 1

    def _turning_places(
        self, points: NDArray[np.float64], field: Field, first: int, last: int
    ) -> tuple[int, int]:
        """Return the points before and behind a stretch between which to look for a passage."""
        lead = math.ceil(CHECK.lead_m / SPACING_M)
        start, end = max(first - 1, 0), min(last + 1, len(points) - 1)
        while start > max(0, first - lead) and not self._can_turn(points[start], field):
            start -= 1
        while end < min(len(points) - 1, last + lead) and not self._can_turn(points[end], field):
            end += 1
        return start, end

    def _can_turn(self, point: NDArray[np.float64], field: Field) -> bool:
        """Say whether the robot can turn around at a point."""
        row, col = int(point[1] / self._edge_m), int(point[0] / self._edge_m)
        return float(field.distance_m[row, col]) > self._body.circumscribed_m + self._edge_m

    def _find_passage(
        self,
        points: NDArray[np.float64],
        weights: NDArray[np.uint8],
        field: Field,
        stretch: tuple[int, int],
        give_m: float,
    ) -> NDArray[np.float64] | None:
        """Return points (n, 2) in place of a stretch of the path, None if there is no passage."""
        start, end = stretch
        edge = self._edge_m
        rows, cols = weights.shape
        cells = np.floor(points[start : end + 1] / edge).astype(np.int64)
        margin = round(CHECK.margin_m / edge)
        low = np.maximum(cells.min(axis=0) - margin, 1)
        high = np.minimum(cells.max(axis=0) + margin, (cols - 2, rows - 2))
        box = Box(int(low[1]), int(low[0]), int(high[1] - low[1]) + 1, int(high[0] - low[0]) + 1)
        in_box = cells - low
        ends = (
            int(in_box[0, 1]) * box.cols + int(in_box[0, 0]),
            self._heading(points, start),
            int(in_box[-1, 1]) * box.cols + int(in_box[-1, 0]),
            self._heading(points, end),
        )
        passage = find_passage(weights, field, self._body, box, ends, give_m)
        if passage.size == 0:
            return None
        moved = np.append(True, passage[1:] != passage[:-1])
        passage = passage[moved]
        xs, ys = box.col + passage % box.cols, box.row + passage // box.cols
        centres = np.stack([xs, ys], axis=1).astype(np.float64) + 0.5
        return subdivide(centres * edge, SPACING_M)

    def _heading(self, points: NDArray[np.float64], index: int) -> int:
        before = points[max(index - CHECK.around, 0)]
        after = points[min(index + CHECK.around, len(points) - 1)]
        return heading_of(math.atan2(float(after[1] - before[1]), float(after[0] - before[0])))


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
        around: the heading is that from this many points before to this many points after.
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
            or fits(field, body, x, y, yaw + CHECK.leeway_rad, give_m)
            or fits(field, body, x, y, yaw - CHECK.leeway_rad, give_m)
        )


@kernel
def tight_into(
    out_tight: NDArray[np.bool_],
    field: Field,
    body: Body,
    points: NDArray[np.float64],
    room: tuple[float, float],
) -> None:
    """Write at which points of a path there is little room, and none a little beside it.

    Args:
        out_tight: (n,), overwritten.
        field: distances.
        body: the outline; it looks along the path.
        points: (n, 2).
        room: clearance with which a place is not tight; how far beside the path it counts, too [m].
    """
    room_m, aside_m = room
    last = points.shape[0] - 1
    for index in range(last + 1):
        before, after = max(index - CHECK.around, 0), min(index + CHECK.around, last)
        yaw = math.atan2(points[after, 1] - points[before, 1], points[after, 0] - points[before, 0])
        out_tight[index] = True
        for side in range(3):
            by = aside_m * (0.0 if side == 0 else 2.0 * side - 3.0)
            x, y = points[index, 0] - by * math.sin(yaw), points[index, 1] + by * math.cos(yaw)
            if clearance_at(field, body, x, y, yaw, room_m) >= room_m:
                out_tight[index] = False
                break


@kernel
def least_clearance(
    field: Field, body: Body, poses: NDArray[np.float64], enough_m: float
) -> float:
    """Return the smallest clearance at some poses (n, 3) [m], at most `enough_m`."""
    least = enough_m
    for index in range(poses.shape[0]):
        x, y, yaw = poses[index, 0], poses[index, 1], poses[index, 2]
        least = min(least, clearance_at(field, body, x, y, yaw, enough_m))
    return least


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
        The next state, what else must be free on the way there (numbered as in `can_be`), and the
        cost, +inf where a lethal cell or the edge of the box is in the way.
    """
    cell, heading = state // HEADINGS, state % HEADINGS
    row, col = cell // box.cols, cell % box.cols
    if turn != 0:
        other = cell * HEADINGS + (heading + turn) % HEADINGS
        # Half-way between two headings is numbered with the one on the right.
        on_way = 2 * (state if turn > 0 else other) + 1
        return other, on_way, CHECK.turn_cells * weights[box.row + row, box.col + col]
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
    passage = np.empty(length, dtype=np.int64)
    state = last
    for index in range(length - 1, -1, -1):
        passage[index] = state // HEADINGS
        state = previous[state]
    return passage


@kernel
def find_passage(
    weights: NDArray[np.uint8],
    field: Field,
    body: Body,
    box: Box,
    ends: tuple[int, int, int, int],
    give_m: float,
) -> NDArray[np.int64]:
    """Return the cheapest path through a box along which the footprint fits, driven forwards.

    Args:
        weights: (rows, cols) of the costmap.
        field: distances of the costmap.
        body: the outline.
        box: where the path may lead; must not hold the outermost cells of the grid.
        ends: cell of the box and heading at the start; the same at the end, where the heading
            may differ by one.
        give_m: see `fits`.

    Returns:
        (n,) cells of the box from start to end; none where there is no path.
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
