"""The current goal: how it is driven to, whom it follows, and what is reported of it."""

from collections.abc import Sequence
from typing import Literal

import msgspec

from trolley import codes
from trolley.config import PlannerConfig
from trolley.messages import GoalStatus, Path
from trolley_planner import wire
from trolley_planner.context.motion_state import MotionState
from trolley_planner.context.planning_context import PlanningContext
from trolley_planner.driving.following import Following
from trolley_planner.driving.goal_execution import GoalExecution
from trolley_planner.goals import Goal, StatusBoard, ValidatedGoal
from trolley_planner.sensing.inputs import Inputs

STOPPING_S = 0.5
"""Time for which zero is commanded after a goal is over [s]."""


class CurrentGoal:
    """The goal that the robot drives to, from the request to its end; at most one.

    Args:
        config: of the planner.
        inputs: for the frame of the goals.
        motion_state: where the robot is, and its limits.
    """

    def __init__(self, config: PlannerConfig, inputs: Inputs, motion_state: MotionState) -> None:
        self._config = config
        self._inputs = inputs
        self._motion_state = motion_state
        self._over_ns: int | None = None
        self.board = StatusBoard(config.frame)
        self.execution: GoalExecution | None = None
        """How the goal is driven to, None without one."""
        self.following: Following | None = None
        """The person that the goal follows, None if the goal is a fixed pose."""

    def set_config(self, config: PlannerConfig) -> None:
        """Apply other settings from the next execution on."""
        self._config = config

    @property
    def is_driving(self) -> bool:
        """Whether the goal is neither over nor paused."""
        return self.board.state in ("driving", "recovering")

    def is_stopping(self, now_ns: int) -> bool:
        """Say whether the goal was paused or ended a moment ago."""
        return self._over_ns is not None and 0 <= now_ns - self._over_ns < STOPPING_S * 1e9

    # Its life.

    def take(self, goal: Goal, following: Following | None, now_ns: int) -> None:
        """Replace the goal; `execute` follows."""
        if self.board.is_active:
            self.end("canceled", codes.REPLACED, now_ns)
        self.board.begin(goal)
        self.board.set("planning", "", now_ns)
        self.following = following

    def execute(
        self,
        validated: ValidatedGoal,
        context: PlanningContext,
        now_ns: int,
        before: GoalExecution | None = None,
    ) -> None:
        """Begin to execute the goal; its first look at the costmap must not wait for a scan.

        Args:
            validated: with its first path.
            context: costmap and planners.
            now_ns: robot time.
            before: how the same goal was driven to on another costmap.
        """
        execution = GoalExecution(validated.goal, context, self._config, validated.path, now_ns)
        self.execution = execution
        motion = self._motion_state.motion()
        if motion is not None:
            if before is not None:
                execution.continue_from(before, motion.pose)
            execution.update(motion, now_ns)

    def drop_execution(self) -> None:
        """Forget how a goal that is over was driven to: its costmap is gone."""
        self.execution = None

    def set_off(self, now_ns: int) -> None:
        """Report that the robot drives to the goal from now on."""
        self._over_ns = None
        self.report("driving", "", now_ns)

    def report(
        self,
        state: Literal["driving", "recovering", "paused"],
        reason: str,
        now_ns: int,
        message: str | None = None,
    ) -> None:
        """Enter a state of the current goal, or stay in it."""
        self.board.set(state, reason, now_ns, message, self._details())

    def pause(self, reason: str, now_ns: int, message: str | None = None) -> None:
        """Stop, and keep the goal."""
        self._over_ns = now_ns
        self.report("paused", reason, now_ns, message)

    def end(
        self,
        state: Literal["arrived", "failed", "canceled"],
        reason: str,
        now_ns: int,
        message: str | None = None,
        blocked: Sequence[tuple[float, float]] = (),
    ) -> None:
        """Close the current goal; `blocked` are places that it ended for."""
        details = self._details()
        if details is not None and blocked:
            details = msgspec.structs.replace(details, blocked=list(blocked))
        self.board.set(state, reason, now_ns, message, details)
        self._over_ns = now_ns
        self.execution, self.following = None, None

    # What is reported.

    def status(self, now_ns: int) -> GoalStatus:
        """Return the status of the current goal."""
        return self.board.snapshot(now_ns, self._details())

    def status_of(self, goal_id: str, now_ns: int) -> GoalStatus | None:
        """Return the status of one of the last goals, None if it is not known."""
        if self.board.goal is not None and goal_id == self.board.goal.id:
            return self.status(now_ns)
        return self.board.history.find(goal_id)

    @property
    def path_key(self) -> str:
        """What changes whenever the path does."""
        if self.execution is None or not self.board.is_active:
            return ""
        return self.execution.path_key

    def path(self, now_ns: int) -> Path:
        """Return the path that is left, an empty one without a goal."""
        execution = self.execution if self.board.is_active else None
        return wire.remaining_path_message(execution, self._inputs.frame, now_ns)

    @property
    def trajectory(self) -> Path | None:
        """What the newest command leads to, None while nothing is driven."""
        if self.execution is None or self.board.state != "driving":
            return None
        stamp_ns = self._motion_state.commanded_ns
        return wire.trajectory_message(self.execution.context, self._inputs.frame, stamp_ns)

    def _details(self) -> GoalStatus | None:
        """Return distance, time and obstacles on the way to the goal for a status."""
        motion = self._motion_state.motion()
        if self.execution is None or motion is None or self.board.goal is None:
            return None
        limits = self._motion_state.limits(self.execution.goal.speed)
        details = wire.status_details(self.execution, motion, limits)
        if self.following is None:
            return details
        return msgspec.structs.replace(details, person=self.following.person)
