"""Whether the footprint fits along a path, and detours where it does not."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.jit import kernel, lean_kernel
from trolley_planner.costmap.costmap import Costmap
from trolley_planner.costmap.fine_grid import FINE, FineGrid
from trolley_planner.costmap.footprint import NO_LIMITS, Body, Field, clearance_at
from trolley_planner.costmap.inflation import LETHAL
from trolley_planner.paths.hybrid_astar.pose_search import PoseSearch, Task
from trolley_planner.paths.hybrid_astar.pull_out import pulled_aside
from trolley_planner.paths.path import SPACING_M


class FootprintCheckParams(NamedTuple):
    """How a footprint is led through narrow places; all by hand."""

    around: int = 2
    """The heading at a point is that between the points this many before and after it."""
    start_m: float = 0.5
    """Distance from the start within which the path may be tight [m]."""
    end_m: float = 0.4
    """Distance from the end within which the path may be tight [m]."""
    lead_m: float = 3.0
    """Length of path before and behind a tight place that a detour may replace, unless the robot
    can turn only farther away [m]."""
    margin_m: float = 0.8
    """Distance from the path's outline to the edge of the area in which the detour is searched [m].
    """
    give_cells: float = 0.25
    """Depth by which obstacles may reach into the footprint in a first check, since they lie
    anywhere in their cells."""
    leeway_rad: float = 0.15
    """Angle by which the robot's heading may differ from its path's."""
    end_xy_m: float = 0.1
    """Distance from the path at which a detour may end [m]."""
    end_rad: float = 0.3
    """Angle between the path and the heading at the end of a detour."""
    exact_m: float = 0.03
    """Distance from the goal at which a detour may end there [m]."""
    exact_rad: float = 0.05
    """Angle between the goal's heading and the heading at the end of a detour there."""
    wanted_m: float = 0.05
    """Clearance that it keeps where there is room [m]."""


CHECK = FootprintCheckParams()
Yaws = tuple[float | None, float | None]


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
    """Checks paths on one costmap.

    Args:
        costmap: what stands where, and the footprint.
    """

    def __init__(self, costmap: Costmap) -> None:
        self._costmap = costmap
        self._body = costmap.footprint.body
        self._edge_m = costmap.resolution_m
        reach_m = costmap.footprint.circumscribed_m + CHECK.margin_m
        self._margin = math.ceil(reach_m / costmap.resolution_m)
        self._fine_grid = FineGrid(costmap, FINE.finest_m, reach_m)
        self.pose_search = PoseSearch(costmap.footprint, self._fine_grid.fine_m)
        """Finds ways through where the footprint does not fit along a path."""
        radii = costmap.footprint.circumscribed_m, costmap.footprint.inscribed_m
        self._is_round = radii[0] <= radii[1] + costmap.resolution_m

    def check(
        self,
        points: NDArray[np.float64],
        weights: NDArray[np.uint8],
        distance_m: NDArray[np.float32],
        yaws: Yaws = (None, None),
    ) -> CheckedPath:
        """Replace the parts of a path where the footprint does not fit.

        Args:
            points: (n, 2) [m].
            weights: (rows, cols) of the costmap.
            distance_m: (rows, cols) to the nearest obstacle: the costmap's, or that of its map
                and zones alone.
            yaws: of the robot at the start and at the end [rad], None where any will do.
        """
        if self._is_round:
            return CheckedPath(points, None)
        edge = self._edge_m
        field = Field(distance_m, NO_LIMITS, NO_LIMITS, 0.0, 0.0, edge, edge, edge)
        done = 0
        while True:
            wrong = self._first_misfit(points, field, done, yaws)
            if wrong is None:
                return CheckedPath(points, None)
            first, last = wrong
            start, end = self._turning_places(points, field, first, last)
            passage = self._find_passage(points, weights, field, (start, end), yaws)
            if passage is None:
                x, y = points[(first + last) // 2]
                return CheckedPath(points, (float(x), float(y)))
            points = np.concatenate([points[: start + 1], passage, points[end:]])
            done = start + len(passage) + 2

    def _first_misfit(
        self, points: NDArray[np.float64], field: Field, done: int, yaws: Yaws
    ) -> tuple[int, int] | None:
        """Return the first and last point of the next stretch where the footprint does not fit."""
        known = [math.nan if yaw is None else yaw for yaw in yaws]
        first, last = first_misfit(points, field, self._body, done, (known[0], known[1]))
        return None if first < 0 else (first, last)

    def _turning_places(
        self, points: NDArray[np.float64], field: Field, first: int, last: int
    ) -> tuple[int, int]:
        """Return the points before and behind a stretch between which to look for a passage."""
        lead = math.ceil(CHECK.lead_m / SPACING_M)
        start, end = max(first - 1, 0), min(last + 1, len(points) - 1)
        while start > max(0, first - lead) and not can_turn(field, self._body, points[start]):
            start -= 1
        while end < min(len(points) - 1, last + lead) and not can_turn(
            field, self._body, points[end]
        ):
            end += 1
        return start, end

    def _find_passage(
        self,
        points: NDArray[np.float64],
        weights: NDArray[np.uint8],
        field: Field,
        stretch: tuple[int, int],
        yaws: Yaws,
    ) -> NDArray[np.float64] | None:
        """Return points (n, 2) in place of a stretch of the path, None if there is no passage."""
        start, end = stretch
        grid = self._fine_grid
        cells = np.floor(points[start : end + 1, ::-1] / self._edge_m).astype(np.int64)
        low = cells.min(axis=0) - self._margin
        size = cells.max(axis=0) + self._margin + 1 - low
        has_seen = field.distance_m is not self._costmap.static.distance_m
        grid.update((int(low[0]), int(low[1])), (int(size[0]), int(size[1])), has_seen)
        closed = grid.divided(_box_of(weights == LETHAL, low, size))
        unknown = np.zeros_like(closed)
        yaw, to_yaw = heading_along(points, start), heading_along(points, end)
        if start == 0 and yaws[0] is not None:
            yaw = yaws[0]
        is_end = end == len(points) - 1 and yaws[1] is not None
        if is_end and yaws[1] is not None:
            to_yaw = yaws[1]
        any_heading = not is_end and can_turn(field, self._body, points[end])
        missed = (CHECK.exact_m, CHECK.exact_rad) if is_end else (CHECK.end_xy_m, CHECK.end_rad)
        (x, y), (to_x, to_y) = points[start].tolist(), points[end].tolist()
        ends = Pose2D(x, y, yaw), Pose2D(to_x, to_y, to_yaw)
        task = Task(*ends, any_heading, *missed, CHECK.wanted_m, else_any=not is_end)
        found = self.pose_search.find(grid, unknown, closed, task)
        if found is None and start == 0 and yaws[0] is not None:
            # A robot that stands right beside a wall pulls out as it drives.
            aside = pulled_aside(ends[0], grid, unknown, self._body)
            if aside is not None:
                found = self.pose_search.find(grid, unknown, closed, task._replace(start=aside))
        return None if found is None else found.poses[1:, :2]


def _box_of(
    mask: NDArray[np.bool_], low: NDArray[np.int64], size: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Return a box of cells, set outside the grid."""
    box = np.ones((int(size[0]), int(size[1])), dtype=np.bool_)
    inside = [slice(max(-int(at), 0), None) for at in low]
    part = mask[
        max(int(low[0]), 0) : int(low[0] + size[0]), max(int(low[1]), 0) : int(low[1] + size[1])
    ]
    box[inside[0], inside[1]][: part.shape[0], : part.shape[1]] = part
    return box


@lean_kernel
def fits(field: Field, body: Body, x: float, y: float, yaw: float, give_m: float) -> bool:
    """Say whether no obstacle reaches more than `give_m` into the footprint at a pose."""
    return clearance_at(field, body, x, y, yaw, 0.01) >= -give_m


@kernel
def first_misfit(
    points: NDArray[np.float64],
    field: Field,
    body: Body,
    done: int,
    yaws: tuple[float, float],
) -> tuple[int, int]:
    """Return the first and last point of the next stretch where the footprint does not fit.

    At the ends of the path it fits where the robot can turn, or looks along the path.

    Args:
        points: (n, 2).
        field: distances of the whole costmap.
        body: the outline.
        done: points before this one are not looked at.
        yaws: of the robot at the start and at the end [rad], NaN where any will do.

    Returns:
        -1 and the last point if there is none.
    """
    last = points.shape[0] - 1
    left_m, along_m, first = 0.0, 0.0, -1
    for index in range(last):
        left_m += step_m(points, index)
    for index in range(last + 1):
        fits_here = (
            along_m < CHECK.start_m
            or left_m < CHECK.end_m
            or fits_along(points, index, field, body)
        )
        if index == 0 or index == last:
            yaw = yaws[0] if index == 0 else yaws[1]
            if not math.isnan(yaw) and not can_turn(field, body, points[index]):
                off = yaw - heading_along(points, index)
                fits_here = math.cos(off) > math.cos(CHECK.end_rad)
        if index >= done:
            if not fits_here and first < 0:
                first = index
            if fits_here and first >= 0:
                return first, index - 1
        if index < last:
            along_m += step_m(points, index)
            left_m -= step_m(points, index)
    return first, last


@lean_kernel
def step_m(points: NDArray[np.float64], index: int) -> float:
    """Return how far it is from a point of a path to the next [m]."""
    dx, dy = points[index + 1, 0] - points[index, 0], points[index + 1, 1] - points[index, 1]
    return math.sqrt(dx * dx + dy * dy)


@lean_kernel
def heading_along(points: NDArray[np.float64], index: int) -> float:
    """Return the heading at a point of a path (n, 2) [rad]."""
    before, after = max(index - CHECK.around, 0), min(index + CHECK.around, points.shape[0] - 1)
    return math.atan2(points[after, 1] - points[before, 1], points[after, 0] - points[before, 0])


@lean_kernel
def can_turn(field: Field, body: Body, point: NDArray[np.float64]) -> bool:
    """Say whether the robot can turn around at a point (2,)."""
    row, col = math.floor(point[1] / field.fine_m), math.floor(point[0] / field.fine_m)
    return bool(field.distance_m[row, col] > body.circumscribed_m + field.fine_m)


@lean_kernel
def fits_along(points: NDArray[np.float64], index: int, field: Field, body: Body) -> bool:
    """Say whether the footprint fits at a point of a path (n, 2), headed roughly along it."""
    x, y = points[index, 0], points[index, 1]
    row, col = math.floor(y / field.fine_m), math.floor(x / field.fine_m)
    if field.distance_m[row, col] > body.circumscribed_m + 2.0 * field.fine_m:
        return True
    yaw, give_m = heading_along(points, index), CHECK.give_cells * field.fine_m
    return (
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
    """Write at which points of a path, and just beside it, the clearance is small.

    Args:
        out_tight: (n,), overwritten.
        field: distances.
        body: the outline; it looks along the path.
        points: (n, 2).
        room: clearance with which a place is not tight; how far beside the path it counts, too [m].
    """
    room_m, aside_m = room
    for index in range(points.shape[0]):
        yaw = heading_along(points, index)
        out_tight[index] = True
        for side in range(3):
            by = aside_m * (0.0 if side == 0 else 2.0 * side - 3.0)
            x, y = points[index, 0] - by * math.sin(yaw), points[index, 1] + by * math.cos(yaw)
            if clearance_at(field, body, x, y, yaw, room_m) >= room_m:
                out_tight[index] = False
                break


@kernel
def least_clearance(field: Field, body: Body, poses: NDArray[np.float64], enough_m: float) -> float:
    """Return the smallest clearance at some poses (n, 3) [m], at most `enough_m`."""
    least = enough_m
    for index in range(poses.shape[0]):
        x, y, yaw = poses[index, 0], poses[index, 1], poses[index, 2]
        least = min(least, clearance_at(field, body, x, y, yaw, enough_m))
    return least
