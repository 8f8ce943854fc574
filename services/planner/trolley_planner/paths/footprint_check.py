"""Whether the footprint fits along a path, and how else it may get through."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley_planner.costmap.footprint import Footprint
from trolley_planner.kernels.clearance import NO_LIMITS, Field
from trolley_planner.kernels.fitting import Box, check_into, heading_of, thread
from trolley_planner.kernels.lines import subdivide
from trolley_planner.paths.path import SPACING_M

AROUND = 2
"""The heading at a point is that between the points so many before and after it."""
START_M, END_M = 0.5, 0.4
"""Places this near to the ends of the way may be tight and still be right."""
LEAD_M = 1.0
"""A way through is looked for from so far before a tight place to so far behind it."""
MARGIN_M = 0.8
"""and so far to the sides of the path."""
GIVE_CELLS = 0.25
"""Obstacles may reach so far into the footprint: what is seen lies anywhere in its cell."""


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """What became of a path.

    Attributes:
        points: (n, 2) [m] the path, changed where the footprint fits only another way.
        narrow: a point [m] where it does not get through at all, None if it does everywhere.
    """

    points: NDArray[np.float64]
    narrow: tuple[float, float] | None


class Fitting:
    """Checks paths for one footprint.

    Args:
        footprint: of the robot.
        resolution_m: edge of a cell of the costmap.
    """

    def __init__(self, footprint: Footprint, resolution_m: float) -> None:
        self._body = footprint.body
        self._edge_m = resolution_m
        self._is_round = footprint.circumscribed_m <= footprint.inscribed_m + resolution_m

    def fit(
        self,
        points: NDArray[np.float64],
        weights: NDArray[np.uint8],
        distance_m: NDArray[np.float32],
        give_cells: float = GIVE_CELLS,
    ) -> Fitted:
        """Lead a path through where the footprint fits.

        Args:
            points: (n, 2) [m].
            weights: (rows, cols) of the costmap.
            distance_m: (rows, cols) to the nearest obstacle.
            give_cells: how far obstacles may reach into the footprint; what is seen lies anywhere
                in its cell.
        """
        if self._is_round:
            return Fitted(points, None)
        edge = self._edge_m
        field = Field(distance_m, NO_LIMITS, NO_LIMITS, 0.0, 0.0, edge, edge, edge)
        done = 0
        while True:
            wrong = self._first_misfit(points, field, done, give_cells * edge)
            if wrong is None:
                return Fitted(points, None)
            first, last = wrong
            start, end = self._turning_places(points, field, first, last)
            way = self._thread(points, weights, field, (start, end), give_cells * edge)
            if way is None:
                x, y = points[(first + last) // 2]
                return Fitted(points, (float(x), float(y)))
            points = np.concatenate([points[: start + 1], way, points[end:]])
            done = start + 1 + len(way)

    def _first_misfit(
        self, points: NDArray[np.float64], field: Field, done: int, give_m: float
    ) -> tuple[int, int] | None:
        """Return the first and last point of the next stretch where the footprint does not fit."""
        steps = np.diff(points, axis=0)
        along = np.append(0.0, np.cumsum(np.hypot(steps[:, 0], steps[:, 1])))
        fits = np.ones(len(points), dtype=np.bool_)
        check_into(fits, field, self._body, points, AROUND, give_m)
        fits |= (along < START_M) | (along > along[-1] - END_M)
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
        """Return the points before and behind a stretch between which to look for a way."""
        lead = math.ceil(LEAD_M / SPACING_M)
        start, end = max(first - 1, 0), min(last + 1, len(points) - 1)
        while start > max(0, first - lead) and not self._can_turn(points[start], field):
            start -= 1
        while end < min(len(points) - 1, last + lead) and not self._can_turn(points[end], field):
            end += 1
        return start, end

    def _can_turn(self, point: NDArray[np.float64], field: Field) -> bool:
        """Say whether the robot can turn round at a point."""
        row, col = int(point[1] / self._edge_m), int(point[0] / self._edge_m)
        return float(field.distance_m[row, col]) > self._body.circumscribed_m + self._edge_m

    def _thread(
        self,
        points: NDArray[np.float64],
        weights: NDArray[np.uint8],
        field: Field,
        stretch: tuple[int, int],
        give_m: float,
    ) -> NDArray[np.float64] | None:
        """Return points (n, 2) in place of a stretch of the path, None if there is no way."""
        start, end = stretch
        edge = self._edge_m
        rows, cols = weights.shape
        cells = np.floor(points[start : end + 1] / edge).astype(np.int64)
        margin = round(MARGIN_M / edge)
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
        way = thread(weights, field, self._body, box, ends, give_m)
        if way.size == 0:
            return None
        moved = np.append(True, way[1:] != way[:-1])
        way = way[moved]
        xs, ys = box.col + way % box.cols, box.row + way // box.cols
        centres = np.stack([xs, ys], axis=1).astype(np.float64) + 0.5
        return subdivide(centres * edge, SPACING_M)

    def _heading(self, points: NDArray[np.float64], index: int) -> int:
        before = points[max(index - AROUND, 0)]
        after = points[min(index + AROUND, len(points) - 1)]
        return heading_of(math.atan2(float(after[1] - before[1]), float(after[0] - before[0])))
