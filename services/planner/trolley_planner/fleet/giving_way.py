"""Giving way to other robots: when to wait, where, and when to drive on."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, Twist2D
from trolley_planner.context.motion_state import ControlInput
from trolley_planner.context.planning_context import PlanningContext
from trolley_planner.control.controller import Motion, limited_change
from trolley_planner.driving.goal_execution import GoalExecution
from trolley_planner.fleet.neighbours import Neighbour, moved_into
from trolley_planner.fleet.right_of_way import (
    RIGHT_OF_WAY,
    OwnRobot,
    Passages,
    must_step_aside,
    must_wait,
    robot_standing_on,
)
from trolley_planner.fleet.waiting_pose import find_waiting_pose, is_clear


@dataclass(frozen=True, slots=True)
class GivingWayParams:
    """How long robots wait for each other; all by hand."""

    facing_s: float = 1.5
    """Time face to face after which one of two standing robots has to step aside."""
    passed_s: float = 0.6
    """Time for which the path must have been free before the robot drives on."""
    idle_s: float = 12.0
    """Time within which a robot with the right of way must move `idle_m` to keep it."""
    idle_m: float = 0.2
    """Distance that it must move within `idle_s`."""
    turn_s: float = 15.0
    """Time for which the other robot has the right of way instead."""
    again_s: float = 30.0
    """Time within which coming upon a robot again that has not moved continues the wait for it."""
    look_s: float = 1.0
    """Time between two searches for a better place to wait."""
    most_waits: float = 5.0
    """Multiple of the time to give up after which the robot stops waiting."""
    blocking_m: float = 2.0
    """Distance within which a robot that stands on the path is named."""


GIVING_WAY = GivingWayParams()
TO_PASS = "to pass"


@dataclass(slots=True)
class WaitForRobot:
    """Which robot this one waits for."""

    name: str
    where: str
    """In words: at which narrow place, or "to pass" if they face each other."""
    since_ns: int
    """Since when, with what it drove in between and came upon that one again."""
    began_ns: int
    """Since when this time, whoever it waited for before."""
    place: Pose2D
    """Where the other robot was when it last moved."""
    moved_ns: int
    free_ns: int | None = None
    """Since when it need not wait for that one any more."""

    @property
    def sentence(self) -> str:
        """The sentence for people."""
        return f"Waiting for robot {self.name} {self.where}."

    def goes_on(self, other: Neighbour, now_ns: int) -> bool:
        """Say whether a wait that is over was for nothing: that robot is still where it was."""
        return (
            self.name == other.name
            and self.place.distance_to(other.pose) <= GIVING_WAY.idle_m
            and self.free_ns is not None
            and now_ns - self.free_ns < GIVING_WAY.again_s * 1e9
        )


class GivingWay:
    """Tracks the other robots, and decides whether to wait for one.

    Args:
        config: of the planner.
    """

    def __init__(self, config: PlannerConfig) -> None:
        self._config = config
        self._passages: tuple[object, Passages] | None = None
        self._stood_ns: int | None = None
        self._left_to: dict[str, int] = {}
        self._looked_ns = 0
        self._waited_ns = 0
        self._waiting_execution: GoalExecution | None = None
        self.others: list[Neighbour] = []
        """The other robots, in `grid`."""
        self.wait: WaitForRobot | None = None
        """Which robot it waits for now."""
        self._waits: dict[str, WaitForRobot] = {}

    def set_config(self, config: PlannerConfig) -> None:
        """Apply other settings from now on."""
        self._config = config

    def update_neighbours(
        self, context: PlanningContext, others: Sequence[Neighbour], now_ns: int
    ) -> None:
        """Replace what is known of the other robots.

        Args:
            context: its costmap learns where they will be.
            others: in the frame of the goals.
            now_ns: robot time.
        """
        grid_T_frame = context.costmap.grid_T_frame
        self.others = [moved_into(other, grid_T_frame) for other in others]
        places = np.array([(one.pose.x, one.pose.y, one.radius_m) for one in self.others])
        tracks = [one.track for one in self.others if len(one.track)]
        context.costmap.moving.set_robots(places.reshape(-1, 3), tracks, now_ns)

    def forget(self) -> None:
        """Stop waiting, as with a new goal."""
        self.wait, self._waiting_execution, self._stood_ns, self._waited_ns = None, None, None, 0
        self._looked_ns = 0
        self._left_to.clear()
        self._waits.clear()

    def decide(self, name: str, execution: GoalExecution, motion: Motion, now_ns: int) -> None:
        """Decide whether to wait, and for which robot.

        Args:
            name: of this robot.
            execution: to its goal.
            motion: of it.
            now_ns: robot time.
        """
        self._update_standing(motion, now_ns)
        going = [one for one in self.others if one.is_going]
        if not going:
            self._resume_when_free(now_ns)
            return
        pose, context = motion.pose, execution.context
        execution.route.update_position(pose)
        passages = self._passages_for(context, going)
        stood_s = 0.0 if self._stood_ns is None else (now_ns - self._stood_ns) * 1e-9
        own = OwnRobot(
            name,
            (pose.x, pose.y),
            context.footprint.circumscribed_m,
            execution.route.path.points[execution.route.index :],
            None if self.wait is None else self.waited_s(now_ns),
            stood_s,
        )
        before = self.wait
        order = sorted(going, key=lambda one: before is None or one.name != before.name)
        for other in order:
            if self._left_to.get(other.name, 0) > now_ns:
                continue
            where = must_wait(own, other, passages)
            if where is None and self._is_face_to_face(own, other):
                where = TO_PASS
            if where is not None:
                self._wait_for(other, where, now_ns)
                self._look_for_waiting_pose(execution, pose, passages, now_ns)
                return
        self._resume_when_free(now_ns)

    def update(self, motion: Motion, now_ns: int) -> bool:
        """Take in a scan on the way to the waiting pose; False if it is not driving to one."""
        if self._waiting_execution is None:
            return False
        self._waiting_execution.update(motion, now_ns)
        return True

    def command(self, now: ControlInput) -> Twist2D:
        """Return the velocity while it waits: to the waiting pose, and zero there."""
        waiting = self._waiting_execution
        if waiting is not None:
            twist = waiting.command(now)
            if waiting.outcome is None:
                return twist
            self._waiting_execution = None
        return limited_change(now.motion.twist, Twist2D.zero(), now.limits, now.elapsed_s)

    def maintain(self, context: PlanningContext, now: ControlInput) -> None:
        """Do what takes longer: update the costmap and the path to the waiting pose."""
        if self._waiting_execution is not None:
            self._waiting_execution.replan_if_due(now)
        else:
            context.costmap.refresh()

    def waited_s(self, now_ns: int) -> float:
        """Return how long it has been waiting [s]."""
        return 0.0 if self.wait is None else (now_ns - self.wait.since_ns) * 1e-9

    def pop_waited_ns(self) -> int:
        """Return how long the last wait took, only once; 0 if there was none."""
        waited_ns, self._waited_ns = self._waited_ns, 0
        return waited_ns

    def has_waited_enough(self, now_ns: int) -> bool:
        """Say whether to give up."""
        return self.waited_s(now_ns) > GIVING_WAY.most_waits * self._config.give_up_s

    def blocking_robot(self, execution: GoalExecution) -> str | None:
        """Return the name of a robot that stands on the path, None if none does."""
        route = execution.route
        last = route.path.ahead(route.index, GIVING_WAY.blocking_m)
        ahead = route.path.points[route.index : last + 1]
        return robot_standing_on(ahead, self.others, execution.context.footprint.inscribed_m)

    def _update_standing(self, motion: Motion, now_ns: int) -> None:
        if not motion.is_standing:
            self._stood_ns = None
        elif self._stood_ns is None:
            self._stood_ns = now_ns

    def _is_face_to_face(self, own: OwnRobot, other: Neighbour) -> bool:
        """Say whether to let another robot pass; once begun, until that one has passed."""
        waits = (
            self.wait is not None and self.wait.name == other.name and self.wait.where == TO_PASS
        )
        return must_step_aside(
            replace(own, stood_s=math.inf) if waits else own, other, GIVING_WAY.facing_s
        )

    def _wait_for(self, other: Neighbour, where: str, now_ns: int) -> None:
        wait = self.wait
        if wait is None or wait.name != other.name:
            since_ns, began_ns = now_ns, now_ns
            if wait is not None:
                since_ns, began_ns, wait.free_ns = wait.since_ns, wait.began_ns, now_ns
            last = self._waits.get(other.name)
            if last is None or not last.goes_on(other, now_ns):
                last = WaitForRobot(other.name, where, since_ns, began_ns, other.pose, now_ns)
            since_ns = min(since_ns, last.since_ns)
            wait = replace(last, where=where, since_ns=since_ns, began_ns=began_ns)
            self.wait = self._waits[other.name] = wait
        wait.free_ns = None
        if wait.place.distance_to(other.pose) > GIVING_WAY.idle_m:
            wait.place, wait.moved_ns = other.pose, now_ns
        elif now_ns - wait.moved_ns > GIVING_WAY.idle_s * 1e9:
            self._left_to[other.name] = now_ns + round(GIVING_WAY.turn_s * 1e9)

    def _resume_when_free(self, now_ns: int) -> None:
        """Drive on once there has been no robot to wait for during some time."""
        if self.wait is None:
            return
        if self.wait.free_ns is None:
            self.wait.free_ns = now_ns
        if now_ns - self.wait.free_ns > GIVING_WAY.passed_s * 1e9:
            self._waited_ns = now_ns - self.wait.began_ns
            self.wait, self._waiting_execution = None, None

    def _look_for_waiting_pose(
        self, execution: GoalExecution, pose: Pose2D, passages: Passages, now_ns: int
    ) -> None:
        """Search for a waiting pose if the robot is in another's way."""
        if now_ns - self._looked_ns < GIVING_WAY.look_s * 1e9:
            return
        self._looked_ns = now_ns
        context = execution.context
        radius_m = context.footprint.circumscribed_m
        if is_clear(pose, radius_m, passages, self.others):
            self._waiting_execution = None
            return
        place = find_waiting_pose(context.costmap, passages, pose, radius_m, self.others)
        if place is None:
            self._waiting_execution = None
            return
        target = Pose2D(*place, 0.0)
        if (
            self._waiting_execution is not None
            and self._waiting_execution.goal_grid.distance_to(target) < 0.3
        ):
            return
        self._waiting_execution = execution.to_place_beside(place, pose, now_ns)

    def _passages_for(self, context: PlanningContext, going: Sequence[Neighbour]) -> Passages:
        """Return where this robot and the largest of the others do not fit side by side."""
        largest_m = max(one.radius_m for one in going)
        half_m = context.footprint.circumscribed_m + largest_m + RIGHT_OF_WAY.margin_m
        known = self._passages
        walls_m = context.costmap.static.distance_m
        if known is None or known[0] is not walls_m or abs(known[1].half_m - half_m) > 1e-6:
            passages = Passages(walls_m, context.costmap.resolution_m, half_m)
            known = self._passages = walls_m, passages
        return known[1]
