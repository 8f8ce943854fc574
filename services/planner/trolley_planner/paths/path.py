"""A path in frame `grid`: its points, and the straight lines over weights that it is made of.

Lines are followed from cell to cell, so that none passes through a corner of a lethal cell unseen.

Source:
    Amanatides and Woo, A Fast Voxel Traversal Algorithm for Ray Tracing (1987).
"""

import math
from dataclasses import dataclass, replace
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel, lean_kernel

SPACING_M = 0.05
"""Distance between neighbouring points of a path [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class PlannedPath:
    """A path to the goal.

    Attributes:
        points: (n, 2) x, y [m] in `grid`, from the robot to the goal.
        remaining_m: (n,) length of the path from each point on.
        vias: for each via point that it leads through, the index of its point.
        cost: of the whole, in metres of free floor.
        is_tight: whether it leads where the robot fits only with less clearance than usual.
    """

    points: NDArray[np.float64]
    remaining_m: NDArray[np.float64]
    vias: tuple[int, ...]
    cost: float
    is_tight: bool = False

    @classmethod
    def join(
        cls, legs: list[NDArray[np.float64]], cost: float, is_tight: bool = False
    ) -> "PlannedPath":
        """Make a path of legs (n, 2) [m], each of which begins where the one before ended."""
        points = legs[0]
        if len(legs) > 1:
            points = np.concatenate([points, *(leg[1:] for leg in legs[1:])])
        remaining = lengths_left(points)
        vias = tuple(accumulate(len(leg) - 1 for leg in legs[:-1]))
        return cls(points, remaining, vias, cost, is_tight)

    @property
    def length_m(self) -> float:
        """Length of the whole path [m]."""
        return float(self.remaining_m[0])

    def without_first_via(self) -> "PlannedPath":
        """Return the same path after its first via point was passed."""
        return replace(self, vias=self.vias[1:])

    def nearest(self, x: float, y: float, first: int, reach_m: float) -> int:
        """Return the index of the nearest point among those up to `reach_m` on from `first`."""
        last = self.ahead(first, reach_m)
        part = self.points[first : last + 1]
        return first + int(np.argmin(np.hypot(part[:, 0] - x, part[:, 1] - y)))

    def ahead(self, first: int, length_m: float) -> int:
        """Return the index of the last point at most `length_m` on from index `first`."""
        wanted = self.remaining_m[first] - length_m
        nearer = int(np.searchsorted(self.remaining_m[::-1], float(wanted)))  # from the end
        return max(first, len(self.remaining_m) - nearer - 1)

    def headings(self, goal_yaw: float) -> NDArray[np.float64]:
        """Return the direction of travel at each point [rad], at the end that of the goal."""
        if len(self.points) < 2:
            return np.array([goal_yaw])
        steps = np.diff(self.points, axis=0)
        return np.append(np.arctan2(steps[:, 1], steps[:, 0]), goal_yaw)


@kernel
def lengths_left(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the length of a polyline (n, 2) from each point on."""
    left = np.zeros(points.shape[0])
    for index in range(points.shape[0] - 2, -1, -1):
        dx, dy = points[index + 1, 0] - points[index, 0], points[index + 1, 1] - points[index, 1]
        left[index] = left[index + 1] + math.sqrt(dx * dx + dy * dy)
    return left


SAME_CELLS = 1e-6
"""Two borders that a line crosses within this distance are crossed in their corner."""
STRAIGHT_CELLS = 0.02
"""Points that would move less than this stay where they are."""
SHORTCUT_M, SHORTCUT_REACH = 0.4, 128
"""Distance of the points [m] and over how many of them a line is tried, then over half as many."""
SMOOTHING = ((1.6, 6), (0.8, 6), (0.4, 6), (0.15, 6))
"""Distance of the points [m] and passes over them, one after the other."""


@kernel
def through_cells(
    cells: NDArray[np.int32], cols: int, ends: tuple[float, float, float, float]
) -> NDArray[np.float64]:
    """Return points (n, 2) [cells] through the centres of flat cells, from one end to the other.

    Args:
        cells: (n,) flat.
        cols: cells in a row.
        ends: x, y of the start, in the first cell, and of the end, in the last one.
    """
    count = cells.shape[0]
    points = np.empty((max(count, 2), 2))
    for index in range(count):
        points[index, 0], points[index, 1] = cells[index] % cols + 0.5, cells[index] // cols + 0.5
    points[0, 0], points[0, 1] = ends[0], ends[1]
    points[-1, 0], points[-1, 1] = ends[2], ends[3]
    return points


@kernel
def smooth_line(
    cells: NDArray[np.int32],
    cols: int,
    ends: tuple[float, float, float, float],
    weights: NDArray[np.uint8],
    cells_per_m: float,
) -> NDArray[np.float64]:
    """Return a smooth path (m, 2) [m] in place of one along cells, see `through_cells`.

    It has no points where that one leads through a lethal cell.
    """
    points = through_cells(cells, cols, ends)
    if math.isinf(polyline_cost(weights, points, math.inf)):
        return np.empty((0, 2))
    smoothed = straighten(points, weights, cells_per_m)
    smoothed /= cells_per_m
    return smoothed


@kernel
def straighten(
    points: NDArray[np.float64], weights: NDArray[np.uint8], cells_per_m: float
) -> NDArray[np.float64]:
    """Return a smooth path (m, 2) in place of one along cells (n, 2), both in cells.

    No line of it touches a lethal cell where those along the cells do not.
    """
    path = subdivide(points, SHORTCUT_M * cells_per_m)
    kept = np.empty(len(path), dtype=np.int32)
    path = path[kept[: shortcut_into(kept, weights, path, SHORTCUT_REACH)]]
    # Far apart the points reach farther, close together they follow the bends.
    for spacing_m, rounds in SMOOTHING:
        path = subdivide(path, spacing_m * cells_per_m)
        smooth(path, weights, rounds)
    return subdivide(path, SPACING_M * cells_per_m)


@lean_kernel
def segment_cost(
    weights: NDArray[np.uint8], x1: float, y1: float, x2: float, y2: float, most: float
) -> float:
    """Return the cost of a straight line, in weights times cells.

    +inf if it meets a lethal cell, runs along the border of one, passes between two that touch with
    their corners, or costs more than `most`.

    Args:
        weights: (rows, cols).
        x1: start [cells].
        y1: start [cells].
        x2: end [cells].
        y2: end [cells].
        most: cost.
    """
    dx, dy = x2 - x1, y2 - y1
    length = math.sqrt(dx * dx + dy * dy)
    col, row = math.floor(x1), math.floor(y1)
    # Counted, since rounding may put the last border just before or behind the end of the line.
    cols_left, rows_left = abs(math.floor(x2) - col), abs(math.floor(y2) - row)
    col_step, row_step = 1 if dx > 0.0 else -1, 1 if dy > 0.0 else -1
    # Where on the line (0 to 1) the next border of a column and of a row is crossed.
    at_col = ((col + (dx > 0.0)) - x1) / dx if cols_left else math.inf
    at_row = ((row + (dy > 0.0)) - y1) / dy if rows_left else math.inf
    by_col, by_row = abs(1.0 / dx) if cols_left else 0.0, abs(1.0 / dy) if rows_left else 0.0
    # Along a border the cells on its other side count, too: rounding may put points there.
    row_beside = side_of_border(y1, dy)
    col_beside = side_of_border(x1, dx)
    total, at = 0.0, 0.0
    while True:
        weight = weights[row, col]
        if weight == 0 or weights[row + row_beside, col + col_beside] == 0:
            return math.inf
        until = min(at_col, at_row, 1.0)
        total += (until - at) * length * weight
        if total > most:
            return math.inf
        if cols_left == 0 and rows_left == 0:
            return total
        at = until
        is_corner = cols_left > 0 and rows_left > 0 and abs(at_col - at_row) * length < SAME_CELLS
        if is_corner and (weights[row, col + col_step] == 0 or weights[row + row_step, col] == 0):
            return math.inf
        crosses_col = is_corner or at_col < at_row
        if crosses_col:
            col, cols_left = col + col_step, cols_left - 1
            at_col = at_col + by_col if cols_left else math.inf
        if is_corner or not crosses_col:
            row, rows_left = row + row_step, rows_left - 1
            at_row = at_row + by_row if rows_left else math.inf


@lean_kernel
def side_of_border(value: float, change: float) -> int:
    """Return where the cells beside a line lie that runs along a border, -1 or 1; else 0."""
    off = value - math.floor(value)
    if abs(change) > SAME_CELLS or SAME_CELLS < off < 1.0 - SAME_CELLS:
        return 0
    return -1 if off <= SAME_CELLS else 1


@lean_kernel
def polyline_cost(weights: NDArray[np.uint8], points: NDArray[np.float64], blocked: float) -> float:
    """Return the cost of a polyline (n, 2) [cells], in weights times cells.

    Args:
        weights: (rows, cols).
        points: (n, 2) x, y.
        blocked: cost of a cell's length for lines over lethal cells; may be infinite.
    """
    total = 0.0
    for index in range(1, points.shape[0]):
        x1, y1 = points[index - 1, 0], points[index - 1, 1]
        x2, y2 = points[index, 0], points[index, 1]
        part = segment_cost(weights, x1, y1, x2, y2, math.inf)
        total += math.hypot(x2 - x1, y2 - y1) * blocked if math.isinf(part) else part
    return total


@kernel
def shortcut_into(
    out_kept: NDArray[np.int32],
    weights: NDArray[np.uint8],
    points: NDArray[np.float64],
    reach: int,
) -> int:
    """Write the points that are left when straight lines replace every detour that is no cheaper.

    Args:
        out_kept: (n,) indices of the points kept, first and last among them.
        weights: (rows, cols).
        points: (n, 2) x, y [cells].
        reach: a line replaces at most this many points.

    Returns:
        The number of points kept.
    """
    count = points.shape[0]
    along = np.zeros(count)
    for index in range(1, count):
        x1, y1 = points[index - 1, 0], points[index - 1, 1]
        x2, y2 = points[index, 0], points[index, 1]
        along[index] = along[index - 1] + segment_cost(weights, x1, y1, x2, y2, math.inf)
    out_kept[0] = 0
    kept, anchor = 1, 0
    while anchor < count - 1:
        chosen = anchor + 1
        x1, y1 = points[anchor, 0], points[anchor, 1]
        span = reach
        while span > 1:
            index = min(count - 1, anchor + span)
            most = along[index] - along[anchor]
            line = segment_cost(weights, x1, y1, points[index, 0], points[index, 1], most)
            if line != math.inf:
                chosen = index
                break
            span //= 2
        out_kept[kept] = chosen
        kept += 1
        anchor = chosen
    return kept


@kernel
def smooth(  # noqa: C901 - in one piece for its speed
    points: NDArray[np.float64], weights: NDArray[np.uint8], rounds: int
) -> None:
    """Pull a path straight where that makes it cheaper: each point between its neighbours.

    Args:
        points: (n, 2) x, y [cells], changed in place but for its ends; about evenly spaced.
        weights: (rows, cols); no line between two points comes to touch a lethal cell.
        rounds: passes over all points.
    """
    costs = np.full(points.shape[0], -1.0)  # of the line behind each point, once it is known
    is_settled = np.zeros(points.shape[0], np.bool_)  # where nothing moved since it was tried
    for _ in range(rounds):
        has_moved = False
        for index in range(1, points.shape[0] - 1):
            if is_settled[index]:
                continue
            is_settled[index] = True
            x, y = points[index, 0], points[index, 1]
            ax, ay = points[index - 1, 0], points[index - 1, 1]
            bx, by = points[index + 1, 0], points[index + 1, 1]
            new_x, new_y = 0.5 * x + 0.25 * (ax + bx), 0.5 * y + 0.25 * (ay + by)
            if abs(new_x - x) + abs(new_y - y) < STRAIGHT_CELLS:
                continue
            # A line may end in the corner of a lethal cell, but two of them would pass it.
            if side_of_border(new_x, 0.0) != 0 and side_of_border(new_y, 0.0) != 0:
                continue
            if costs[index - 1] < 0.0:
                costs[index - 1] = segment_cost(weights, ax, ay, x, y, math.inf)
            if costs[index] < 0.0:
                costs[index] = segment_cost(weights, x, y, bx, by, math.inf)
            most = costs[index - 1] + costs[index]
            first = segment_cost(weights, ax, ay, new_x, new_y, most)
            if first == math.inf:
                continue
            second = segment_cost(weights, new_x, new_y, bx, by, most - first)
            if first + second <= most:
                points[index, 0], points[index, 1] = new_x, new_y
                costs[index - 1], costs[index] = first, second
                is_settled[index - 1 : index + 2] = False
                has_moved = True
        if not has_moved:
            break


@kernel
def subdivide(points: NDArray[np.float64], spacing: float) -> NDArray[np.float64]:
    """Return points (m, 2) at most `spacing` apart along a polyline (n, 2), corners kept."""
    count = 1
    for index in range(1, points.shape[0]):
        dx, dy = points[index, 0] - points[index - 1, 0], points[index, 1] - points[index - 1, 1]
        count += math.ceil(math.hypot(dx, dy) / spacing)
    divided = np.empty((max(count, 2), 2))
    at = 0
    for index in range(1, points.shape[0]):
        x, y = points[index - 1, 0], points[index - 1, 1]
        dx, dy = points[index, 0] - x, points[index, 1] - y
        parts = math.ceil(math.hypot(dx, dy) / spacing)
        for part in range(parts):
            divided[at, 0], divided[at, 1] = x + dx * part / parts, y + dy * part / parts
            at += 1
    last = points.shape[0] - 1
    if at == 0:  # A path that leads nowhere still has two ends.
        divided[0] = points[last]
        at = 1
    divided[at] = points[last]
    return divided
