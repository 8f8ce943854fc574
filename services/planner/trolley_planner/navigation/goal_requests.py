"""What is asked about goals: send, follow, preview, cancel, pause, resume."""

from trolley import codes
from trolley.codes import Refused
from trolley.config import PlannerConfig
from trolley.messages import GoalStatus, Path
from trolley.messages.request_params import FollowPerson, SendGoal, WhichGoal
from trolley_planner import wire
from trolley_planner.context.motion_state import MotionState
from trolley_planner.context.planning_context import PlanningContext
from trolley_planner.driving.following import BEHIND, Following, pick_person, tracks_seen
from trolley_planner.driving.route import seconds_along, timed_poses
from trolley_planner.goals import (
    Goal,
    Tolerances,
    ValidatedGoal,
    check_frame,
    check_ready,
    check_state,
    goal_pose,
    validate,
)
from trolley_planner.navigation.current_goal import CurrentGoal
from trolley_planner.navigation.goal_driver import GoalDriver
from trolley_planner.navigation.goal_guard import GoalGuard
from trolley_planner.navigation.replanner import Replanner
from trolley_planner.sensing.inputs import Inputs


class GoalRequests:
    """Answers requests: checks them, and changes the current goal.

    Args:
        config: of the planner.
        inputs: the newest messages.
        motion_state: where the robot is, and its limits.
        current: the goal.
        replanner: makes a costmap that holds what is asked for.
        driver: sets off.
        guard: pauses.
    """

    def __init__(
        self,
        config: PlannerConfig,
        inputs: Inputs,
        motion_state: MotionState,
        current: CurrentGoal,
        replanner: Replanner,
        driver: GoalDriver,
        guard: GoalGuard,
    ) -> None:
        self._config = config
        self._inputs = inputs
        self._motion_state = motion_state
        self._current = current
        self._replanner = replanner
        self._driver = driver
        self._guard = guard

    def set_config(self, config: PlannerConfig) -> None:
        """Apply other settings from now on; the current goal stays."""
        self._config = config

    def send(self, params: SendGoal, new_id: str, now_ns: int | None) -> GoalStatus:
        """Take a goal, in place of the one before.

        Args:
            params: the request.
            new_id: for a goal that brings none.
            now_ns: robot time, None while unknown.

        Raises:
            Refused: the goal that was driven to is then untouched.
        """
        known = None if params.id is None else self._current.status_of(params.id, now_ns or 0)
        if known is not None:
            return known
        check_ready(self._inputs, now_ns)
        now = now_ns or 0
        return self._take(*self._validate(params, new_id, now), None, now)

    def follow(self, params: FollowPerson, new_id: str, now_ns: int | None) -> GoalStatus:
        """Begin to follow a person, in place of the goal before.

        Args:
            params: the request.
            new_id: for a goal that brings none.
            now_ns: robot time, None while unknown.

        Raises:
            Refused: the goal that was driven to is then untouched.
        """
        known = None if params.id is None else self._current.status_of(params.id, now_ns or 0)
        if known is not None:
            return known
        check_ready(self._inputs, now_ns)
        now = now_ns or 0
        check_frame(params.frame, self._inputs)
        check_state(self._inputs, now)
        context, here = self._replanner.context_for((), now)
        person = pick_person(tracks_seen(context), here, params.point)
        if person is None:
            raise Refused(codes.NOBODY)
        following = Following(person, here, params.distance, now)
        place = following.place_behind(now)
        goal = Goal(params.id or new_id, place, (), BEHIND, params.speed, now)
        return self._take(validate(goal, context, here, self._config), context, following, now)

    def preview(self, params: SendGoal, now_ns: int | None) -> Path:
        """Return the path to a goal with its times, without driving.

        Raises:
            Refused: as `send`.
        """
        check_ready(self._inputs, now_ns)
        now = now_ns or 0
        validated, context = self._validate(params, "preview", now)
        motion = self._motion_state.motion()
        if motion is None:
            raise Refused(codes.NOT_LOCALIZED)
        goal, points, costmap = validated.goal, validated.path.points, context.costmap
        limits = self._motion_state.limits(goal.speed)
        seconds = seconds_along(points, motion.pose.yaw, costmap, limits)
        goal_yaw = None if goal.tolerances.any_heading else costmap.to_grid(goal.pose).yaw
        poses, dt = timed_poses(points, seconds, goal_yaw)
        return wire.path_message(poses, costmap.frame_T_grid, self._inputs.frame, now, dt)

    def cancel(self, params: WhichGoal, now_ns: int) -> GoalStatus:
        """End the current goal.

        Raises:
            Refused: `not_current`.
        """
        self._current.board.check_current(params.id)
        self._guard.cancel(now_ns)
        return self._current.status(now_ns)

    def pause(self, params: WhichGoal, now_ns: int) -> GoalStatus:
        """Stop, and keep the goal.

        Raises:
            Refused: `not_current`.
        """
        self._current.board.check_current(params.id)
        self._guard.pause(codes.PAUSED, now_ns)
        return self._current.status(now_ns)

    def resume(self, params: WhichGoal, now_ns: int | None) -> GoalStatus:
        """Drive on to the goal that was paused.

        Raises:
            Refused: `not_current`, or whatever a new goal would be refused for.
        """
        self._current.board.check_current(params.id)
        goal, now = self._current.board.goal, now_ns or 0
        if goal is None or self._current.board.state != "paused":
            return self._current.status(now)
        check_ready(self._inputs, now_ns)
        check_state(self._inputs, now)
        if self._current.following is not None and self._current.following.is_lost(now):
            raise Refused(codes.PERSON_LOST)
        left = goal if self._current.execution is None else self._current.execution.remaining_goal()
        context, here = self._replanner.context_for((*left.vias, left.pose), now)
        self._current.board.check_current(params.id)  # on another map it has ended
        self._set_off(validate(left, context, here, self._config), context, now)
        return self._current.status(now)

    def resume_or_fail(self, now_ns: int) -> None:
        """Drive on to a goal that paused by itself; it fails where that is not possible."""
        try:
            self.resume(WhichGoal(), now_ns)
        except Refused as refusal:
            if self._current.board.is_active:
                self._current.end("failed", refusal.code, now_ns, refusal.message)

    def _validate(
        self, params: SendGoal, new_id: str, now_ns: int
    ) -> tuple[ValidatedGoal, PlanningContext]:
        """Validate a goal by map, zones and costmap.

        Raises:
            Refused: see `goals`.
        """
        pose = goal_pose(params, self._inputs)
        check_state(self._inputs, now_ns)
        vias = tuple(via.wrapped() for via in params.via)
        context, here = self._replanner.context_for((*vias, pose), now_ns)
        goal = Goal(
            params.id or new_id,
            pose,
            vias,
            Tolerances(params.xy_tolerance, params.yaw_tolerance),
            params.speed,
            now_ns,
        )
        return validate(goal, context, here, self._config), context

    def _take(
        self,
        validated: ValidatedGoal,
        context: PlanningContext,
        following: Following | None,
        now_ns: int,
    ) -> GoalStatus:
        """Drive to a goal in place of the one before, behind a person if one is followed."""
        self._current.take(validated.goal, following, now_ns)
        self._set_off(validated, context, now_ns)
        return self._current.status(now_ns)

    def _set_off(self, validated: ValidatedGoal, context: PlanningContext, now_ns: int) -> None:
        """Start driving along a first path."""
        self._guard.set_off(now_ns)
        self._driver.set_off(validated, context, now_ns)
