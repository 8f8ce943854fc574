"""The path of a goal while it is driven: where the robot is on it, when it is planned anew."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D
from trolley_planner.context.planning_context import Rig
from trolley_planner.costmap.inflation import LETHAL
from trolley_planner.goals.goal import VIA_RADIUS_M
from trolley_planner.paths.path import PlannedPath

PASS_M = 0.8 * VIA_RADIUS_M
"""Via points are taken as passed a little nearer than asked for: the pose may err."""
REPLAN_BLOCKED_S = 0.3
"""Time between two plans while the path is blocked."""
DETOUR_FACTOR, DETOUR_M = 1.5, 2.0
"""A way is a detour if it is longer than this much of the old one and this much more."""
BETTER = 0.9
"""A new path is taken where it costs less than this share of the old one."""
STRAYED_M = 0.7
REACH_M = 1.0
"""The robot is looked for at most this far on along the path since the last time."""
OWN_PLACE_M, GOAL_PLACE_M = 0.4, 0.2
TIGHT_AHEAD_M, TIGHT_BEHIND_M = 0.8, 0.5
"""So far before and behind a tight place the robot keeps the clearance that there is."""
HORIZON_M = 12.0
"""Only obstacles this near along the path call for a new one."""


@dataclass(frozen=True, slots=True)
class Stretch:
    """The part of the path that the controller steers by."""

    first: int
    last: int
    target: Pose2D
    is_goal: bool


class Route:
    """A path to the goal, kept as good as the costmap allows.

    Args:
        rig: costmap and planner.
        config: times.
        targets: via points and the goal's position in `grid` [m], in their order.
        path: the first plan.
    """

    def __init__(
        self, rig: Rig, config: PlannerConfig, targets: list[Pose2D], path: PlannedPath
    ) -> None:
        self._rig = rig
        self._replan_ns = round(config.replan_s * 1e9)
        self._targets = targets
        self.path = path
        self.index = 0
        """Of the point of the path where the robot is."""
        self.is_blocked = False
        """Whether something stands on the path, and no way round was found."""
        self.narrow: list[tuple[float, float]] = []
        """Where a way that was looked for in vain is too narrow for the footprint [m in `grid`]."""
        self._patience_ns = round(config.patience_s * 1e9)
        self._blocked_since_ns: int | None = None
        self.changes = 0
        """How often the path was replaced."""
        self._planned_ns = 0
        self._weights_changed = False

    @property
    def goal(self) -> Pose2D:
        """The last target."""
        return self._targets[-1]

    @property
    def vias_left(self) -> int:
        """Via points that were not passed yet."""
        return len(self._targets) - 1

    def remaining_m(self, pose: Pose2D) -> float:
        """Return how far it is to the goal along the path [m]."""
        x, y = self.path.points[self.index]
        off = math.hypot(pose.x - float(x), pose.y - float(y))
        return off + float(self.path.remaining_m[self.index])

    def follow(self, pose: Pose2D) -> None:
        """Take where the robot is."""
        while self.vias_left and pose.distance_to(self._targets[0]) < PASS_M:
            self.index = max(self.index, self.path.vias[0])
            self._targets.pop(0)
            self.path = self.path.without_first_via()
        nearest = self.path.nearest(pose.x, pose.y, self.index, REACH_M)
        self.index = min(nearest, self.path.vias[0]) if self.vias_left else nearest

    def stretch(self, reach_m: float) -> Stretch:
        """Return the part ahead that is at most `reach_m` long and leads to the next target."""
        last = self.path.ahead(self.index, reach_m)
        if self.vias_left:
            last = min(last, self.path.vias[0])
        return Stretch(self.index, last, self._targets[0], self.vias_left == 0)

    def has_strayed(self, pose: Pose2D) -> bool:
        """Say whether the robot is so far from the path that it needs another."""
        x, y = self.path.points[self.index]
        return math.hypot(pose.x - float(x), pose.y - float(y)) > STRAYED_M

    def retarget(self, goal: Pose2D) -> None:
        """Drive to a slightly different goal from now on."""
        self._targets[-1] = goal

    def maintain(self, pose: Pose2D, now_ns: int, force: bool = False) -> None:
        """Bring the costmap up to date; replace the path where it is blocked or can be better.

        Args:
            pose: of the robot in `grid`.
            now_ns: robot time.
            force: plan in any case.
        """
        self._weights_changed |= self._rig.costmap.refresh()
        is_cut = bool(self.blocked_points(1))
        if is_cut and self._blocked_since_ns is None:
            self._blocked_since_ns = now_ns
        waited_ns = now_ns - self._planned_ns
        if is_cut or self.has_strayed(pose):
            due = waited_ns >= REPLAN_BLOCKED_S * 1e9
        else:
            self.is_blocked, self._blocked_since_ns = False, None
            due = self._weights_changed and waited_ns >= self._replan_ns
        if due or force:
            self._planned_ns = now_ns
            self._weights_changed = False
            self._replan(pose, is_cut, now_ns, force)

    @property
    def is_tight_here(self) -> bool:
        """Whether the robot is where it fits only with less clearance than usual, or nearly so."""
        if not self.path.is_tight:
            return False
        left = float(self.path.remaining_m[self.index])
        first = int(np.searchsorted(-self.path.remaining_m, -(left + TIGHT_BEHIND_M)))
        return bool(self._lethal(first, self.path.ahead(self.index, TIGHT_AHEAD_M)).any())

    def blocked_points(self, limit: int = 20) -> list[tuple[float, float]]:
        """Return points of the path ahead that something keeps the robot from [m in `grid`].

        The robot's own place and the goal's are left out: they may be tight and still be right.
        """
        costmap = self._rig.costmap
        first = self.path.ahead(self.index, OWN_PLACE_M)
        left = float(self.path.remaining_m[self.index])
        last = self.path.ahead(self.index, min(HORIZON_M, left - GOAL_PLACE_M))
        points = self.path.points[first : last + 1]
        lethal = self._lethal(first, last)
        if self.path.is_tight:
            cols, rows = self._cells(first, last)
            lethal &= costmap.distance_m[rows, cols] < costmap.tight_m
        return [(float(x), float(y)) for x, y in points[lethal][:limit]]

    def _lethal(self, first: int, last: int) -> NDArray[np.bool_]:
        """Return for some points of the path whether they are too near to something."""
        cols, rows = self._cells(first, last)
        return self._rig.costmap.weights[rows, cols] == LETHAL

    def _cells(self, first: int, last: int) -> NDArray[np.int64]:
        """Return columns and rows (2, n) of some points of the path."""
        points = self.path.points[first : last + 1]
        return np.floor(points / self._rig.costmap.resolution_m).astype(np.int64).T

    def _replan(self, pose: Pose2D, is_cut: bool, now_ns: int, force: bool) -> None:
        """Look for a better path, or any if the present one is cut."""
        costmap, planner = self._rig.costmap, self._rig.planner
        start = (pose.x, pose.y)
        targets = [(target.x, target.y) for target in self._targets]
        found = planner.plan(start, targets, costmap.weights, costmap.distance_m)
        self.narrow = planner.narrow if found is None else []
        if found is None:
            self.is_blocked = True
            # Along a blocked path it goes as far as it can: things look different from near by.
            if force or self.has_strayed(pose):
                hopeful = planner.plan(
                    start, targets, planner.hopeful_weights(), costmap.static_distance_m
                )
                if hopeful is not None:
                    self._take(hopeful)
            return
        old_length = float(self.path.remaining_m[self.index])
        is_detour = found.length_m > DETOUR_FACTOR * old_length + DETOUR_M
        blocked_since = now_ns if self._blocked_since_ns is None else self._blocked_since_ns
        # Nor does it squeeze past who may step aside.
        is_worse = is_detour or (found.is_tight and not self.path.is_tight)
        if is_cut and is_worse and now_ns - blocked_since < self._patience_ns:
            self.is_blocked = True
            return
        self.is_blocked = False
        old_cost = planner.cost_of(self.path.points[self.index :], costmap.weights)
        if force or is_cut or planner.cost_of(found.points, costmap.weights) < BETTER * old_cost:
            self._take(found)

    def _take(self, path: PlannedPath) -> None:
        self.path = path
        self.index = 0
        self.changes += 1
