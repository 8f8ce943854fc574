"""Where people will meet the robot, and a place that it reaches in time and they do not touch.

Who walks is taken to walk on as now, along walls and not into them.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.jit import kernel
from trolley_planner.context.planning_context import PlanningContext
from trolley_planner.control.controller import HURRIED_REVERSE
from trolley_planner.costmap.footprint import NOBODY
from trolley_planner.costmap.inflation import LETHAL
from trolley_planner.driving.goal_execution import GoalExecution
from trolley_planner.fleet.right_of_way import Passages
from trolley_planner.paths.heap import sift_up, take_first
from trolley_planner.paths.path import SPACING_M
from trolley_planner.sensing.beams import wrapped


class RefugeParams(NamedTuple):
    """How people are predicted, and where the robot may wait for them; all by hand."""

    half_m: float = 7.0
    """Half the edge of the square around the robot in which people and waiting places count."""
    ahead_m: float = 5.0
    """Length of the route that is checked."""
    ahead_s: float = 12.0
    """Time for which people are predicted to walk on."""
    step_s: float = 0.1
    """Time between two predicted positions."""
    wall_m: float = 0.2
    """Least distance from a predicted position to a wall."""
    person_m: float = 0.25
    """Radius of a person."""
    narrow_m: float = 1.5
    """Length of route before and behind the meeting point that must be wide enough for the
    controller to pass."""
    beside_m: float = 0.05
    """Clearance beside a person with which the controller passes them elsewhere."""
    room_m: float = 0.5
    """Distance from the meeting point within which free floor beside the route is room to pass."""
    before_m: float = 1.0
    """Length of route before the meeting point along which there must be room to pass."""
    behind_m: float = 0.5
    """Length of route behind the meeting point along which there must be room to pass."""
    keep_m: float = 0.12
    """Least distance between people and the waiting robot; with less it looks for another place."""
    pace: float = 0.85
    """Share of its speed at which the robot is predicted to drive."""
    turn_radps: float = 1.2
    """Rate at which the robot is predicted to turn before it sets off [rad/s]."""
    early_s: float = 0.3
    """Time by which the robot must be at a place before people are."""


REFUGE = RefugeParams()
Floats = NDArray[np.float64]


class Surroundings:
    """The floor around the robot, and where people will walk on it.

    Args:
        context: costmap and people.
        pose: of the robot in `grid`.
        others: (n, 7) who may come besides those who walk, see `Field.walkers`.
    """

    def __init__(self, context: PlanningContext, pose: Pose2D, others: Floats = NOBODY) -> None:
        costmap = context.costmap
        edge = self._edge_m = costmap.resolution_m
        half = math.ceil(REFUGE.half_m / edge)
        row, col = math.floor(pose.y / edge), math.floor(pose.x / edge)
        self._first = max(row - half, 0), max(col - half, 0)
        part = np.s_[self._first[0] : row + half + 1, self._first[1] : col + half + 1]
        self._looks_all_round = costmap.obstacle_layer.looks_all_round
        self._is_free = np.ascontiguousarray(costmap.weights[part] != LETHAL)
        walls_m = np.ascontiguousarray(costmap.static.distance_m[part])
        walkers = np.concatenate([context.local_costmap.walkers_now(), others])
        walkers[:, :2] -= edge * np.array([self._first[1], self._first[0]])
        self._radii_m = walkers[:, 4]
        self._tracks = np.empty((len(walkers), round(REFUGE.ahead_s / REFUGE.step_s), 2))
        walk_into(self._tracks, walls_m, walkers, edge)

    def closes_s(self, keep_m: float) -> Floats:
        """Return from when on somebody is near each cell (rows, cols) [s], infinite if nobody is.

        Args:
            keep_m: near is this far from their outline.
        """
        closes_s = np.full(self._is_free.shape, np.inf)
        close_cells(closes_s, self._tracks, self._radii_m + keep_m, self._edge_m)
        return closes_s

    def cell_of(self, x: float, y: float) -> tuple[int, int] | None:
        """Return row and column of a point of `grid` [m], None outside."""
        row = math.floor(y / self._edge_m) - self._first[0]
        col = math.floor(x / self._edge_m) - self._first[1]
        rows, cols = self._is_free.shape[0], self._is_free.shape[1]
        return (row, col) if 0 <= row < rows and 0 <= col < cols else None

    def cells_of(self, points: Floats) -> NDArray[np.int64]:
        """Return rows and columns (2, n) of points (n, 2) as far as they are inside, in order."""
        cells = np.floor(points / self._edge_m).astype(np.int64)[:, ::-1] - self._first
        outside = ((cells < 0) | (cells >= np.array(self._is_free.shape))).any(axis=1)
        end = int(np.argmax(outside)) if outside.any() else len(cells)
        return cells[:end].T

    def points_of(self, rows: NDArray[np.int64], cols: NDArray[np.int64]) -> Floats:
        """Return the middles (n, 2) of cells."""
        corner = self._edge_m * np.array([self._first[1], self._first[0]])
        return corner + self._edge_m * (np.column_stack([cols, rows]) + 0.5)

    def arrivals(
        self,
        closes_s: Floats,
        pose: Pose2D,
        speed: float,
        meeting: tuple[float, float] = (math.nan, math.nan),
    ) -> Floats:
        """Return when the robot can be in each cell (rows, cols) [s] before somebody is there.

        It turns to where it drives first, or to look away from there and backs, if its lidar
        looks that way.

        Args:
            closes_s: see `closes_s`.
            pose: of the robot in `grid`.
            speed: that it may have [m/s].
            meeting: x, y [m] of where it drives on to. If given, places are left out that are
                reached later than it is back there from another refuge.
        """
        here = self.cell_of(pose.x, pose.y)
        found = np.full(closes_s.shape, np.inf)
        if here is None:
            return found
        edge_m, (row, col) = self._edge_m, self._first
        back_to = meeting[1] / edge_m - row - 0.5, meeting[0] / edge_m - col - 0.5
        facing = (0.0, speed), (math.pi, min(speed, HURRIED_REVERSE))
        for turned, fastest in facing if self._looks_all_round else facing[:1]:
            one = np.full(closes_s.shape, np.inf)
            pace = pose.yaw + turned, edge_m / predicted_mps(fastest)
            arrive(one, self._is_free, closes_s, here, pace, back_to)
            np.minimum(found, one, out=found)
        return found

    def is_refuge(self, closes_s: Floats) -> NDArray[np.bool_]:
        """Say for cells (rows, cols) whether the robot fits there and nobody comes."""
        return self._is_free & np.isinf(closes_s)

    def has_room_beside(self, points: Floats, closes_s: Floats) -> bool:
        """Say whether there is a place where nobody comes beside each of some points (n, 2)."""
        room = self.points_of(*np.nonzero(self.is_refuge(closes_s)))
        reach_m = REFUGE.room_m
        return all(
            bool((np.hypot(room[:, 0] - x, room[:, 1] - y) < reach_m).any())
            for x, y in points.tolist()
        )


def predicted_mps(speed: float) -> float:
    """Return how fast the robot is predicted to drive that may have this speed [m/s]."""
    return max(REFUGE.pace * speed, 0.05)


class Meeting(NamedTuple):
    """Where the robot and somebody come upon each other on its route."""

    around: Surroundings
    place: tuple[float, float]
    """x, y in `grid` [m]."""
    has_room: bool
    """Whether the controller can pass them there."""

    def find_refuge(
        self, context: PlanningContext, pose: Pose2D, speed: float
    ) -> tuple[tuple[float, float], float] | None:
        """Return where to yield, and when people have passed there [s]; None if it gets nowhere.

        Args:
            context: costmap and people.
            pose: of the robot in `grid`.
            speed: that it may have [m/s].
        """
        around = self.around
        # A robot that waits may look anywhere.
        wide_s = around.closes_s(context.footprint.circumscribed_m + REFUGE.keep_m)
        arrival = around.arrivals(wide_s, pose, speed, self.place)
        rows, cols = np.nonzero(around.is_refuge(wide_s) & np.isfinite(arrival))
        if len(rows) == 0:
            return None
        places = around.points_of(rows, cols)
        to_go_m = np.hypot(*(places - self.place).T)
        best = int((arrival[rows, cols] + to_go_m / predicted_mps(speed)).argmin())
        walkers = context.local_costmap.walkers_now()
        away = places[best] - walkers[:, :2]
        speeds = np.maximum(np.hypot(walkers[:, 2], walkers[:, 3]), 0.2)
        is_coming = (away * walkers[:, 2:4]).sum(axis=1) > 0.0
        passed_s = float(np.max(np.where(is_coming, np.hypot(*away.T) / speeds, 0.0), initial=0.0))
        x, y = places[best].tolist()
        return (x, y), min(passed_s, REFUGE.ahead_s)


def find_meeting(
    driven: GoalExecution, pose: Pose2D, speed: float, passages: Passages, now_ns: int
) -> Meeting | None:
    """Return where somebody comes upon the robot first, None if nobody does.

    Args:
        driven: how the goal is driven to.
        pose: of the robot in `grid`.
        speed: that it may have [m/s].
        passages: where the two do not fit side by side.
        now_ns: robot time.
    """
    context, route = driven.context, driven.route
    context.local_costmap.update_moving(now_ns)
    if not context.local_costmap.is_anyone_near(pose, REFUGE.half_m):
        return None
    last = route.path.ahead(route.index, REFUGE.ahead_m)
    points = route.path.points[route.index : last + 1]
    around = Surroundings(context, pose)
    slim_s = around.closes_s(context.footprint.inscribed_m + REFUGE.beside_m)
    rows, cols = around.cells_of(points)
    times_s = SPACING_M * np.arange(len(rows)) / predicted_mps(speed)
    meets = np.flatnonzero(slim_s[rows, cols] <= times_s + REFUGE.early_s)
    if len(meets) == 0:
        return None
    first = int(meets[0])
    before = max(first - round(REFUGE.before_m / SPACING_M), 0)
    behind = first + round(REFUGE.behind_m / SPACING_M)
    near = round(REFUGE.narrow_m / SPACING_M)
    is_narrow = passages.hold(points[max(first - near, 0) : first + near + 1]).any()
    has_room = not is_narrow or around.has_room_beside(points[before : behind + 1 : 4], slim_s)
    x, y = points[first].tolist()
    return Meeting(around, (x, y), bool(has_room))


@kernel
def walk_into(
    out_tracks: Floats, walls_m: NDArray[np.float32], walkers: Floats, edge_m: float
) -> None:
    """Write where people will be, if all walk on along the walls.

    Args:
        out_tracks: (n, steps, 2) x, y [m] every `REFUGE.step_s`, NaN outside the cells; written.
        walls_m: (rows, cols) distance to the nearest wall.
        walkers: (n, 7) see `Field.walkers`, from the corner of the cells on.
        edge_m: of a cell.
    """
    rows, cols = walls_m.shape
    for index in range(walkers.shape[0]):
        x, y = walkers[index, 0], walkers[index, 1]
        for step in range(out_tracks.shape[1]):
            row, col = math.floor(y / edge_m), math.floor(x / edge_m)
            out_tracks[index, step, :] = np.nan
            # Whoever is beyond the edge may still come in.
            if 0 < row < rows - 1 and 0 < col < cols - 1:
                if step > 0 and walls_m[row, col] < REFUGE.wall_m:
                    off_x, off_y = off_wall(walls_m, row, col, edge_m)
                    x, y = x + off_x, y + off_y
                out_tracks[index, step, 0], out_tracks[index, step, 1] = x, y
            x += REFUGE.step_s * walkers[index, 2]
            y += REFUGE.step_s * walkers[index, 3]


@kernel
def close_cells(out_closes_s: Floats, tracks: Floats, reaches_m: Floats, edge_m: float) -> None:
    """Write from when on somebody is near each cell.

    Args:
        out_closes_s: (rows, cols), lowered.
        tracks: (n, steps, 2) see `walk_into`.
        reaches_m: (n,) how near is near, from their middle.
        edge_m: of a cell.
    """
    for index in range(tracks.shape[0]):
        for step in range(tracks.shape[1]):
            x, y = tracks[index, step, 0], tracks[index, step, 1]
            if not math.isnan(x):
                reach = reaches_m[index] / edge_m
                lower_disc(out_closes_s, (x / edge_m, y / edge_m), reach, step * REFUGE.step_s)


@kernel
def off_wall(
    walls_m: NDArray[np.float32], row: int, col: int, edge_m: float
) -> tuple[float, float]:
    """Return the step x, y [m] away from the wall of who walks too close to it."""
    right = float(walls_m[row, col + 1] - walls_m[row, col - 1])
    up = float(walls_m[row + 1, col] - walls_m[row - 1, col])
    slope = math.hypot(right, up)
    if slope == 0.0:
        return 0.0, 0.0
    push = min(REFUGE.wall_m - walls_m[row, col], edge_m) / slope
    return push * right, push * up


@kernel
def lower_disc(
    values: Floats, middle_cells: tuple[float, float], reach_cells: float, value: float
) -> None:
    """Lower the values (rows, cols) of cells around a place x, y [cells]."""
    rows, cols = values.shape
    x, y = middle_cells[0] - 0.5, middle_cells[1] - 0.5
    for row in range(
        max(math.ceil(y - reach_cells), 0), min(math.floor(y + reach_cells) + 1, rows)
    ):
        half = math.sqrt(max(reach_cells * reach_cells - (row - y) ** 2, 0.0))
        for col in range(max(math.ceil(x - half), 0), min(math.floor(x + half) + 1, cols)):
            values[row, col] = min(values[row, col], value)


@kernel
def arrive(  # noqa: C901 - Dijkstra in one piece
    out_arrival_s: Floats,
    is_free: NDArray[np.bool_],
    closes_s: Floats,
    here: tuple[int, int],
    pace: tuple[float, float],
    back_to: tuple[float, float],
) -> None:
    """Write when the robot can be in each cell, never where somebody is by then (Dijkstra).

    What is reached later than people are predicted for stays infinite.

    Args:
        out_arrival_s: (rows, cols), infinite everywhere.
        is_free: (rows, cols) where the robot fits.
        closes_s: (rows, cols) from when on somebody is there.
        here: row and column of the robot; it may be anywhere.
        pace: the heading that it sets off in without a turn [rad], and how long a cell takes [s].
        back_to: row and column that it drives on to; NaN: all cells are wanted.
    """
    rows, cols = is_free.shape
    yaw, cell_s = pace
    until_s = REFUGE.ahead_s
    heap = np.empty((8 * rows * cols + 1, 2))
    out_arrival_s[here] = 0.0
    heap[0, 0], heap[0, 1] = 0.0, here[0] * cols + here[1]
    size = 1
    while size > 0:
        now_s = heap[0, 0]
        cell = take_first(heap, size)
        size -= 1
        row, col = cell // cols, cell % cols
        if now_s > until_s:
            break
        if now_s > out_arrival_s[row, col]:
            continue
        if math.isinf(closes_s[row, col]) and is_free[row, col]:
            back_s = now_s + cell_s * math.hypot(row - back_to[0], col - back_to[1])
            if back_s < until_s:
                until_s = back_s
        for by_row in range(-1, 2):
            for by_col in range(-1, 2):
                r, c = row + by_row, col + by_col
                if r < 0 or c < 0 or r >= rows or c >= cols or not is_free[r, c]:
                    continue
                then_s = now_s + cell_s * math.hypot(by_row, by_col)
                if (row, col) == here:
                    turn = abs(wrapped(math.atan2(by_row, by_col) - yaw))
                    then_s += turn / REFUGE.turn_radps
                is_open = then_s + REFUGE.early_s < closes_s[r, c]
                if is_open and then_s < out_arrival_s[r, c]:
                    out_arrival_s[r, c] = then_s
                    sift_up(heap, size, then_s, r * cols + c)
                    size += 1
