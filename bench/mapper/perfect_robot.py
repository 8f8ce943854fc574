"""A robot that knows where it is, sees without errors and drives as it is told: to judge exploring.

What the planner and the scan matching do to a drive is left out, so a house takes a second.
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from trolley import codes
from trolley.codes import Refused
from trolley.geometry import Pose2D
from trolley.geometry.footprint import footprint_from_box
from trolley.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap, cast_rays, distance_transform
from trolley.messages import GoalState, GoalStatus, Zone
from trolley.messages.request_params import SendGoal
from trolley_mapper.explore.exploration_goal import Cancel, Limits, Scene, Send, survey
from trolley_mapper.explore.explorer import Explorer
from trolley_mapper.explore.frontiers import Clearance
from trolley_mapper.explore.traversable_area import lay_out_area
from trolley_mapper.kernels.frontiers import FREE as FREE_KIND
from trolley_mapper.kernels.frontiers import STRAIGHT, UNREACHED, spread_into

CLEARANCE = Clearance(
    footprint_from_box(0.30, 0.24), passing_m=0.17, standing_m=0.30, squeezing_m=0.12
)
"""Of a robot of 0.30 x 0.24 m."""
LIMITS = Limits(radius_m=30.0, area_m2=500.0)
BEAMS, REACH_M = 360, 8.0
SPEED_MPS, TICK_S = 0.4, 0.5


def advance(explorer: Explorer, scene: Scene, now_s: float) -> None:
    """Let an explorer survey the map and choose."""
    seen = (
        survey(scene, explorer.clearance, explorer.limits) if explorer.wants_survey(now_s) else None
    )
    explorer.step(scene, seen, now_s)


class PerfectRobot:
    """Uncovers a house.

    Args:
        truth: the house, all of it.
        start: where it stands.
        zones: that it keeps out of.
        fails: whether the planner gives up on a goal.
        fov_rad: field of view of its lidar.
    """

    def __init__(
        self,
        truth: GridMap,
        start: Pose2D,
        zones: tuple[Zone, ...] = (),
        fails: Callable[[SendGoal], bool] = lambda _: False,
        fov_rad: float = 2.0 * math.pi,
    ) -> None:
        self.truth, self.pose, self.home, self.zones = truth, start, start, zones
        self.cells = np.full(truth.cells.shape, UNKNOWN, np.int8)
        self.way_m = self.now_s = 0.0
        self.goals: list[SendGoal] = []
        self.track = [start]
        self._fails, self._fov_rad = fails, fov_rad
        self._occupied = truth.occupied_mask()
        self._goal: SendGoal | None = None
        self._path: list[Pose2D] = []
        self.look()

    @property
    def grid(self) -> GridMap:
        """What it knows."""
        return GridMap("new", self.truth.resolution, self.truth.origin, self.cells)

    def scene(self) -> Scene:
        """What the explorer gets to see."""
        return Scene(self.grid, self.pose, False, False, self.zones, self.home)

    def look(self) -> None:
        """Take a scan."""
        at = self.truth.origin.inverse() @ self.pose
        edge = self.truth.resolution
        angles = at.yaw + self._fov_rad * (np.arange(BEAMS) / BEAMS - 0.5)
        ranges = cast_rays(self._occupied, edge, (at.x, at.y), angles, REACH_M)
        steps = np.arange(0.0, REACH_M, 0.5 * edge)
        reach = np.where(np.isfinite(ranges), ranges, REACH_M)
        ray, step = np.nonzero(steps[None, :] < reach[:, None])
        self._mark(at, angles[ray], steps[step].astype(np.float64), FREE)
        hit = np.isfinite(ranges)
        self._mark(at, angles[hit], (ranges[hit] + 0.1 * edge).astype(np.float64), OCCUPIED)

    def _mark(
        self, at: Pose2D, angles: NDArray[np.float64], away: NDArray[np.float64], value: int
    ) -> None:
        cols = np.floor((at.x + away * np.cos(angles)) / self.truth.resolution).astype(int)
        rows = np.floor((at.y + away * np.sin(angles)) / self.truth.resolution).astype(int)
        num_rows, num_cols = len(self.cells), len(self.cells[0])
        ok = (rows >= 0) & (rows < num_rows) & (cols >= 0) & (cols < num_cols)
        self.cells[rows[ok], cols[ok]] = value

    def explore(self, explorer: Explorer, limit_s: float = 4000.0) -> None:
        """Let an explorer drive until it is done or pauses."""
        explorer.begin(None, None)
        while explorer.is_under_way and self.now_s < limit_s:
            scene = replace(self.scene(), zones=[*self.zones, *explorer.barriers])
            advance(explorer, scene, self.now_s)
            for action in explorer.take_actions():
                self._obey(action, explorer)
            self._drive(explorer)
            self.now_s += TICK_S

    def _obey(self, action: Send | Cancel, explorer: Explorer) -> None:
        if isinstance(action, Cancel):
            self._goal = None
            return
        self.goals.append(action.goal)
        assert action.goal.pose is not None
        assert action.goal.id is not None
        path = self._plan(action.goal.pose)
        if path is None:
            explorer.hear_refusal(action.goal.id, Refused(codes.NO_PATH), self.now_s)
        else:
            self._goal, self._path = action.goal, path
            self._say(explorer, "driving")

    def _plan(self, goal: Pose2D) -> list[Pose2D] | None:
        """The path over what is known, cell by cell."""
        floor = lay_out_area(self.grid, self.zones, self.pose, 0.2, (self.home, 1000.0))
        rows, cols = floor.kinds.shape
        room = distance_transform((floor.kinds != FREE_KIND).astype(np.uint8), floor.resolution)
        passable = (room >= CLEARANCE.passing_m - 0.03).astype(np.uint8)
        cost, seed = np.empty((rows, cols), np.int32), np.empty((rows, cols), np.int32)
        x, y = floor.in_cells(goal)
        if not (0 <= x < cols and 0 <= y < rows) or not passable[int(y), int(x)]:
            return None
        spread_into(
            cost, seed, passable, np.array([int(y) * cols + int(x)], np.int32), UNREACHED // 2
        )
        x, y = floor.in_cells(self.pose)
        row, col = int(y), int(x)
        if cost[row, col] == UNREACHED:
            near = np.argwhere(cost != UNREACHED)
            gaps = np.hypot(*(near - [row, col]).T)
            if gaps.min() * floor.resolution > 0.5:
                return None
            row, col = near[int(np.argmin(gaps))]
        path: list[Pose2D] = []
        while cost[row, col] > 0:
            window = cost[max(row - 1, 0) : row + 2, max(col - 1, 0) : col + 2]
            down, right = np.unravel_index(int(np.argmin(window)), window.shape)
            row, col = max(row - 1, 0) + int(down), max(col - 1, 0) + int(right)
            path.append(floor.place(int(row * cols + col)))
        return [*path, goal]

    def _drive(self, explorer: Explorer) -> None:
        """Drive on for one tick."""
        goal = self._goal
        if goal is None:
            return
        if self._fails(goal):
            self._goal = None
            self._say(explorer, "failed", goal)
            return
        left = SPEED_MPS * TICK_S
        while self._path and left > 0.0:
            step = self._path.pop(0)
            away = self.pose.distance_to(step)
            yaw = math.atan2(step.y - self.pose.y, step.x - self.pose.x) if away else step.yaw
            self.pose = Pose2D(step.x, step.y, yaw if self._path else step.yaw)
            self.way_m += away
            left -= away
        self.track.append(self.pose)
        self.look()
        self._say(explorer, "driving" if self._path else "arrived")
        if not self._path:
            self._goal = None

    def _say(self, explorer: Explorer, state: GoalState, goal: SendGoal | None = None) -> None:
        current = goal or self._goal
        assert current is not None
        reason = codes.BLOCKED if state == "failed" else ""
        status = GoalStatus(stamp_ns=0, id=current.id, state=state, reason=reason)
        explorer.hear_goal(status, self.now_s)

    def share_found(self) -> float:
        """Share of the wanted floor that it knows."""
        wanted = wanted_floor(self.truth, self.home)
        return float(np.count_nonzero(wanted & (self.cells >= 0)) / np.count_nonzero(wanted))


def wanted_floor(truth: GridMap, start: Pose2D) -> NDArray[np.bool_]:
    """The floor within 1 m of where a robot can get, (rows, cols)."""
    free = truth.free_mask()
    passable = (distance_transform(1 - free, truth.resolution) >= CLEARANCE.passing_m).astype(
        np.uint8
    )
    near = way_from(truth, passable, start)
    seed = np.empty_like(near)
    reached = np.flatnonzero(near != UNREACHED).astype(np.int32)
    spread_into(near, seed, free, reached, round(STRAIGHT / truth.resolution))
    return near != UNREACHED


def way_from(grid: GridMap, passable: NDArray[np.uint8], pose: Pose2D) -> NDArray[np.int32]:
    """Cost of the path to each cell from a pose, (rows, cols)."""
    cost, seed = np.empty(passable.shape, np.int32), np.empty(passable.shape, np.int32)
    row, col = grid.world_to_cell(pose.as_array()[None, :2])[0]
    first = np.array([row * passable.shape[1] + col], np.int32)
    spread_into(cost, seed, passable, first, UNREACHED // 2)
    return cost
