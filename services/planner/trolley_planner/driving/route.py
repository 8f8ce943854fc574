"""The path to a goal while it is driven: progress along it, replanning, timing."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, wrap_angle, wrap_angles
from trolley_planner.context.planning_context import PlanningContext
from trolley_planner.control.robot_motion import Limits, caution_speed
from trolley_planner.costmap.costmap import Costmap
from trolley_planner.costmap.inflation import LETHAL, UNKNOWN
from trolley_planner.goals import VIA_RADIUS_M
from trolley_planner.paths.path import PlannedPath

PASS_M = 0.8 * VIA_RADIUS_M
"""Via points are taken as passed a little nearer than asked for: the pose may err."""


@dataclass(frozen=True, slots=True)
class RouteParams:
    """When the path is replaced; all by hand."""

    replan_blocked_s: float = 0.3
    """Time between two plans while the path is blocked."""
    rest_per_state_s: float = 2e-5
    """Time more for each pose that the last plan had to search, up to the robot's patience, so that
    a slow computer is not busy with that alone: it takes a PC a fifteenth of this."""
    most_poses: int = 200_000
    """Number of poses searched at narrow places after which a plan gives up: 0.3 s of a PC, which
    gives no command meanwhile."""
    detour_factor: float = 1.5
    """Multiple of the old length above which a path may be a detour."""
    detour_m: float = 2.0
    """Extra length above which such a path is a detour."""
    better_share: float = 0.9
    """Share of the old cost below which a new path is taken."""
    strayed_m: float = 0.7
    """Distance from the path beyond which the robot needs a new one."""
    reach_m: float = 1.0
    """Length of path ahead of the last match within which the robot's place is found."""
    own_place_m: float = 0.4
    """Distance from the robot within which its path may be tight."""
    goal_place_m: float = 0.2
    """Distance from the goal within which the path may be tight."""
    tight_ahead_m: float = 0.8
    """Distance before a tight place at which the robot accepts the clearance that there is."""
    tight_behind_m: float = 0.5
    """Distance behind a tight place up to which the robot accepts the clearance that there is."""
    off_map_m: float = 1.0
    """Extra length of a path that may lie off the map, since maps have holes."""
    off_wall_m: float = 0.16
    """Distance from the map's walls beyond which something stands on its own, and is no edge of a
    door that is not quite where the map says: three cells."""
    horizon_m: float = 12.0
    """Distance along the path up to which obstacles call for replanning."""


ROUTE = RouteParams()


@dataclass(frozen=True, slots=True)
class Stretch:
    """The part of the path that the controller steers by."""

    first: int
    last: int
    target: Pose2D
    is_goal: bool


class Blockage(NamedTuple):
    """What stands on the only path."""

    place: tuple[float, float]
    """Its middle, x, y in `grid` [m]."""
    free_m: float
    """Length of the path up to there [m]."""


class Route:
    """A path to the goal, kept as good as the costmap allows.

    Args:
        context: costmap and planner.
        config: times.
        targets: via points and the goal's position in `grid` [m], in their order.
        path: the first plan.
        any_heading: whether the robot may look anywhere at the goal.
    """

    def __init__(
        self,
        context: PlanningContext,
        config: PlannerConfig,
        targets: list[Pose2D],
        path: PlannedPath,
        any_heading: bool = False,
    ) -> None:
        self._context = context
        self._replan_ns = round(config.replan_s * 1e9)
        self.targets = targets
        """Via points that are left, and the goal."""
        self._any_heading = any_heading
        self.path = path
        self.index = 0
        """Of the point of the path where the robot is."""
        self.is_blocked = False
        """Whether something stands on the path, and no way around it was found."""
        self.narrow: list[tuple[float, float]] = []
        """Where the only path was too narrow for the footprint, x, y in `grid` [m]."""
        self._patience_ns = round(config.patience_s * 1e9)
        self._blocked_since_ns: int | None = None
        self.changes = 0
        """How often the goal's path was replaced."""
        self._must_replan = False
        self._timed: tuple[tuple[int, float], NDArray[np.float64]] | None = None
        """For which path and speed the times along it are known, and these."""
        self._planned_ns = 0
        self._rest_ns = 0
        self._weights_changed = False

    @property
    def goal(self) -> Pose2D:
        """The last target."""
        return self.targets[-1]

    @property
    def vias_left(self) -> int:
        """Via points that were not passed yet."""
        return len(self.targets) - 1

    def remaining_m(self, pose: Pose2D) -> float:
        """Return how far it is to the goal along the path [m]."""
        x, y = self.path.points[self.index]
        off = math.hypot(pose.x - float(x), pose.y - float(y))
        return off + float(self.path.remaining_m[self.index])

    def update_position(self, pose: Pose2D) -> None:
        """Advance along the path to where the robot is, past via points that it reached."""
        while self.vias_left and pose.distance_to(self.targets[0]) < PASS_M:
            self.index = max(self.index, self.path.vias[0])
            self.targets.pop(0)
            self.path = self.path.without_first_via()
        nearest = self.path.nearest(pose.x, pose.y, self.index, ROUTE.reach_m)
        self.index = min(nearest, self.path.vias[0]) if self.vias_left else nearest

    def eta_s(self, pose: Pose2D, goal_yaw: float | None, limits: Limits) -> float:
        """Return how long the rest of the path will take, with the turn at its end [s].

        The times along it are kept until the path or the speed changes.

        Args:
            pose: of the robot in `grid`.
            goal_yaw: heading at the end, None if any will do.
            limits: of the robot.
        """
        path, key = self.path, (self.changes, limits.max_speed)
        if self._timed is None or self._timed[0] != key:
            seconds = seconds_along(path.points, pose.yaw, self._context.costmap, limits)
            self._timed = key, seconds
        seconds, turn = self._timed[1], 0.0
        if goal_yaw is not None:
            end = path.points[-1] - path.points[path.ahead(0, max(path.length_m - 0.3, 0.0))]
            bearing = math.atan2(float(end[1]), float(end[0]))
            turn = abs(wrap_angle(goal_yaw - bearing)) / limits.max_turn
        return float(seconds[-1] - seconds[self.index]) + turn

    def stretch(self, reach_m: float) -> Stretch:
        """Return the part ahead that is at most `reach_m` long and leads to the next target."""
        last = self.path.ahead(self.index, reach_m)
        if self.vias_left:
            last = min(last, self.path.vias[0])
        return Stretch(self.index, last, self.targets[0], self.vias_left == 0)

    def has_strayed(self, pose: Pose2D) -> bool:
        """Say whether the robot is so far from the path that it needs another."""
        x, y = self.path.points[self.index]
        return math.hypot(pose.x - float(x), pose.y - float(y)) > ROUTE.strayed_m

    def retarget(self, goal: Pose2D) -> None:
        """Drive to a slightly moved goal from now on."""
        self.targets[-1] = goal

    def replan_soon(self) -> None:
        """Look for a path the next time in any case, as after a jump of the pose."""
        self._must_replan = True

    def replan_if_due(self, pose: Pose2D, now_ns: int) -> None:
        """Update the costmap; replace the path where it is blocked or a better one exists.

        Args:
            pose: of the robot in `grid`.
            now_ns: robot time.
        """
        force, self._must_replan = self._must_replan, False
        self._weights_changed |= self._context.costmap.refresh()
        is_cut = bool(self.blocked_points(1))
        if is_cut and self._blocked_since_ns is None:
            self._blocked_since_ns = now_ns
        waited_ns = now_ns - self._planned_ns
        if is_cut or self.has_strayed(pose):
            due = waited_ns >= ROUTE.replan_blocked_s * 1e9 + self._rest_ns
        else:
            self.is_blocked, self._blocked_since_ns = False, None
            due = self._weights_changed and waited_ns >= self._replan_ns
        if due or force:
            self._planned_ns = now_ns
            self._weights_changed = False
            search = self._context.pose_search
            num_before = search.num_states
            self._replan(pose, is_cut, now_ns, force)
            num_states = search.num_states - num_before
            rest_ns = round(num_states * ROUTE.rest_per_state_s * 1e9)
            self._rest_ns = min(rest_ns, self._patience_ns)

    @property
    def is_tight_here(self) -> bool:
        """Whether the robot is where it fits only with less clearance than usual, or nearly so."""
        if not self.path.is_tight:
            return False
        left = float(self.path.remaining_m[self.index])
        first = int(np.searchsorted(-self.path.remaining_m, -(left + ROUTE.tight_behind_m)))
        return bool(self._lethal(first, self.path.ahead(self.index, ROUTE.tight_ahead_m)).any())

    def blocked_points(self, limit: int = 20) -> list[tuple[float, float]]:
        """Return blocked points of the path ahead [m in `grid`]."""
        points = self.path.points[self._blocked()[:limit]]
        return [(float(x), float(y)) for x, y in points]

    def _blocked(self) -> NDArray[np.int64]:
        """Return the indices of the blocked points of the path ahead.

        The robot's own place and the goal's are left out: they may be tight and still be right.
        """
        costmap = self._context.costmap
        first = self.path.ahead(self.index, ROUTE.own_place_m)
        left = float(self.path.remaining_m[self.index])
        last = self.path.ahead(self.index, min(ROUTE.horizon_m, left - ROUTE.goal_place_m))
        lethal = self._lethal(first, last)
        if self.path.is_tight:
            cols, rows = self._cells(first, last)
            lethal &= costmap.distance_m[rows, cols] < costmap.tight_m
        return first + np.flatnonzero(lethal)

    @property
    def blockage(self) -> Blockage | None:
        """What stands on the path, and on any other.

        None where nothing stands off the map's walls: from close by, the edges of a narrow door may
        leave room.
        """
        blocked = self._blocked() if self.is_blocked else ()
        if len(blocked) == 0:
            return None
        there = int(blocked[0])
        place = self.what_stands_near(*self.path.points[there].tolist())
        if place is None:
            return None
        left_m = self.path.remaining_m
        return Blockage(place, float(left_m[self.index] - left_m[there]))

    def what_stands_near(self, x: float, y: float) -> tuple[float, float] | None:
        """Return the middle of what is seen off the map's walls, None if there is nothing.

        Args:
            x: within the robot's radius of which place, in `grid` [m].
            y: the same.
        """
        costmap = self._context.costmap
        reach_m, edge_m = costmap.footprint.circumscribed_m, costmap.resolution_m
        row, col = (max(math.floor((at - reach_m) / edge_m), 0) for at in (y, x))
        size = math.ceil(2.0 * reach_m / edge_m) + 1
        around = np.s_[row : row + size, col : col + size]
        stands = costmap.distance_m[around] <= 0.0
        rows, cols = np.nonzero(stands & (costmap.static.distance_m[around] > ROUTE.off_wall_m))
        if len(rows) == 0:
            return None
        return edge_m * (col + float(cols.mean()) + 0.5), edge_m * (row + float(rows.mean()) + 0.5)

    def leads_off_map(self, off_m: float) -> bool:
        """Say whether the path leads further off the map, and not back onto it.

        Args:
            off_m: how far the robot has driven since the map ended [m].
        """
        cols, rows = self._cells(self.index, len(self.path.points))
        is_off = self._context.costmap.static.kinds[rows, cols] == UNKNOWN
        left_m = self.path.remaining_m[self.index :]
        lengths_m = -np.diff(left_m, append=0.0) * is_off
        back = int(np.argmin(is_off)) if not is_off.all() else len(is_off)
        back_m, away_m = float(lengths_m[:back].sum()), float(lengths_m[back:].sum())
        return back_m > off_m + ROUTE.off_map_m or away_m > ROUTE.off_map_m or back == len(is_off)

    def _lethal(self, first: int, last: int) -> NDArray[np.bool_]:
        """Say which points of the path are too near to an obstacle."""
        cols, rows = self._cells(first, last)
        return self._context.costmap.weights[rows, cols] == LETHAL

    def _cells(self, first: int, last: int) -> NDArray[np.int64]:
        """Return columns and rows (2, n) of some points of the path."""
        points = self.path.points[first : last + 1]
        return np.floor(points / self._context.costmap.resolution_m).astype(np.int64).T

    def _replan(self, pose: Pose2D, is_cut: bool, now_ns: int, force: bool) -> None:
        """Search for a better path, or for any if the present one is blocked."""
        costmap, planner = self._context.costmap, self._context.planner
        start = (pose.x, pose.y)
        targets = [(target.x, target.y) for target in self.targets]
        yaws = pose.yaw, self._goal_yaw
        layers, most = (costmap.weights, costmap.distance_m), ROUTE.most_poses
        found = planner.plan(start, targets, *layers, yaws, most)
        self.narrow = planner.narrow if found is None else []
        if found is None:
            self.is_blocked = True
            # It follows a blocked path as far as it can: from close by things may look different.
            if force or self.has_strayed(pose):
                layers = planner.optimistic_weights(), costmap.static.distance_m
                optimistic = planner.plan(start, targets, *layers, yaws, most)
                if optimistic is not None:
                    self._replace(optimistic)
            return
        old_length = float(self.path.remaining_m[self.index])
        is_detour = found.length_m > ROUTE.detour_factor * old_length + ROUTE.detour_m
        blocked_since = now_ns if self._blocked_since_ns is None else self._blocked_since_ns
        # Nor does it squeeze past who may step aside.
        is_worse = is_detour or (found.is_tight and not self.path.is_tight)
        if is_cut and is_worse and now_ns - blocked_since < self._patience_ns:
            self.is_blocked = True
            return
        self.is_blocked = False
        old_cost = planner.cost_of(self.path.points[self.index :], costmap.weights)
        if (
            force
            or is_cut
            or planner.cost_of(found.points, costmap.weights) < ROUTE.better_share * old_cost
        ):
            self._replace(found)

    @property
    def _goal_yaw(self) -> float | None:
        return None if self._any_heading else self.targets[-1].yaw

    def _replace(self, path: PlannedPath) -> None:
        self.path = path
        self.index = 0
        self.changes += 1


@dataclass(frozen=True, slots=True)
class TimingParams:
    """How paths are timed; by hand."""

    corner_rad: float = 0.6
    """The robot turns in place at corners sharper than this."""
    most_poses: int = 2000
    """A timed path has no more poses than this."""
    step_s: float = 0.25
    """Time between two poses of a timed path, unless it has too many."""


TIMING = TimingParams()


def seconds_along(
    points: NDArray[np.float64], start_yaw: float, costmap: Costmap, limits: Limits
) -> NDArray[np.float64]:
    """Return when the robot is at each point of a path.

    Args:
        points: (n, 2) in `grid` [m].
        start_yaw: heading at the beginning, in `grid` [rad].
        costmap: tells what is near, and the speed zones.
        limits: of the robot.

    Returns:
        (n,) seconds since the start; the first turn is over at index 0.
    """
    if len(points) < 2:
        return np.zeros(len(points))
    steps = np.diff(points, axis=0)
    lengths = np.hypot(steps[:, 0], steps[:, 1])
    cells = np.floor(points[1:] / costmap.resolution_m).astype(np.int64)
    near = costmap.distance_m[cells[:, 1], cells[:, 0]] - costmap.footprint.inscribed_m
    speeds = np.array([caution_speed(limits, clearance) for clearance in near.tolist()])
    speeds = np.minimum(speeds, costmap.static.speed_limits[cells[:, 1], cells[:, 0]])
    bearings = np.arctan2(steps[:, 1], steps[:, 0])
    corners = np.abs(wrap_angles(np.diff(bearings)))
    turns = np.where(corners > TIMING.corner_rad, corners / limits.max_turn, 0.0)
    seconds = lengths / np.maximum(speeds, 0.01)
    seconds[1:] += turns
    first = abs(wrap_angle(float(bearings[0]) - start_yaw))
    begin = (first / limits.max_turn if first > TIMING.corner_rad else 0.0) + 0.5 * (
        limits.max_speed / limits.acceleration
    )
    return begin + np.insert(np.cumsum(seconds), 0, 0.0)


def timed_poses(
    points: NDArray[np.float64], seconds: NDArray[np.float64], goal_yaw: float | None
) -> tuple[NDArray[np.float64], float]:
    """Return poses (m, 3) at even times, and the time between two of them [s].

    Args:
        points: (n, 2) [m].
        seconds: (n,) when the robot is there.
        goal_yaw: heading at the end; None: as it arrives.
    """
    steps = np.diff(points, axis=0)
    last = float(np.arctan2(steps[-1, 1], steps[-1, 0])) if len(steps) else 0.0
    end_yaw = last if goal_yaw is None else goal_yaw
    total = max(float(seconds[-1]), TIMING.step_s)
    count = min(math.ceil(total / TIMING.step_s) + 1, TIMING.most_poses)
    wanted = np.linspace(0.0, total, count)
    at = np.concatenate([[0.0], seconds]) if seconds[0] > 0.0 else seconds
    places = np.concatenate([points[:1], points]) if seconds[0] > 0.0 else points
    xs = np.interp(wanted, at, places[:, 0])
    ys = np.interp(wanted, at, places[:, 1])
    bearings = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0])) if len(steps) else np.zeros(1)
    yaws = np.interp(wanted, seconds[1:], bearings) if len(steps) else np.full(count, end_yaw)
    yaws[-1] = end_yaw
    return np.stack([xs, ys, wrap_angles(yaws)], axis=1), total / (count - 1)
