"""What keeps the robot from driving to its goal although nobody asked for that.

Inputs that are missing make it wait, and fail the goal in the end. A stop, another driver, a
restart of base and the end of the map pause it.
"""

from trolley import codes
from trolley.config import PlannerConfig
from trolley.messages import BaseState
from trolley_planner.context.planning_context import CostmapManager
from trolley_planner.driving.spin_to_localize import SpinToLocalize
from trolley_planner.navigation.current_goal import CurrentGoal
from trolley_planner.sensing.inputs import OWN_SOURCE, Inputs

SETTLED_S = 1.5
"""A source that drove already when the goal came may fall silent within this time."""


class GoalGuard:
    """Makes the current goal wait, pauses it, and says when it may go on by itself.

    Args:
        config: of the planner.
        inputs: the newest messages.
        costmap_manager: says what is missing.
        current: the goal.
        spin: stopped with every pause, and when the goal is canceled.
    """

    def __init__(
        self,
        config: PlannerConfig,
        inputs: Inputs,
        costmap_manager: CostmapManager,
        current: CurrentGoal,
        spin: SpinToLocalize,
    ) -> None:
        self._config = config
        self._inputs = inputs
        self._costmap_manager = costmap_manager
        self._current = current
        self._spin = spin
        self._set_off_ns = 0
        self._checked_ns = 0
        self._trouble_since_ns: int | None = None

    def set_config(self, config: PlannerConfig) -> None:
        """Apply other settings from now on."""
        self._config = config

    def set_off(self, now_ns: int) -> None:
        """Take in that the robot sets off to a goal."""
        self._set_off_ns = self._checked_ns = now_ns
        self._trouble_since_ns = None

    def pause(self, reason: str, now_ns: int, message: str | None = None) -> None:
        """Stop, and keep the goal."""
        self._spin.stop()
        self._current.pause(reason, now_ns, message)

    def cancel(self, now_ns: int) -> None:
        """Stop, and end the goal."""
        self._spin.stop()
        self._current.end("canceled", codes.CANCELED, now_ns)

    def must_wait(self, now_ns: int) -> bool:
        """Say whether the robot must stand for want of inputs; fail if that lasts.

        Without base there is no robot time either, so that only the gap afterwards tells of it.
        """
        gap_s, self._checked_ns = (now_ns - self._checked_ns) * 1e-9, now_ns
        if gap_s > self._config.give_up_s:
            why = f"Nothing was heard of the robot's base for {gap_s:.0f} s."
            self._current.end("failed", codes.SCAN_LOST, now_ns, why)
            return True
        trouble = self._costmap_manager.trouble(now_ns)
        if trouble is None:
            self._trouble_since_ns = None
            return False
        if self._trouble_since_ns is None:
            self._trouble_since_ns = now_ns
        if now_ns - self._trouble_since_ns > self._config.give_up_s * 1e9:
            self._current.end("failed", trouble.code, now_ns, trouble.message)
        else:
            self._current.report("recovering", trouble.code, now_ns, trouble.message)
        return True

    def update_base(self, base: BaseState, before: BaseState | None, now_ns: int) -> None:
        """Pause the goal if base was stopped, or if somebody else drives.

        Args:
            base: its state.
            before: what it was before that.
            now_ns: robot time.
        """
        goal = self._current.board.goal
        if goal is None or not self._goes_on_by_itself:
            return
        if base.is_from_before(self._set_off_ns):
            return
        if base.mode == "stopped":
            # It stays paused once the robot may drive again, and so does what it says.
            why = "The robot was stopped; once it may drive again, resume the goal to go on."
            self.pause(codes.STOPPED, now_ns, why)
        elif base.mode == "fault":
            # What it does just now is for base to say; the goal says why it is paused.
            message = None if base.reason == codes.DOES_NOT_OBEY else base.message or None
            self.pause(base.reason or codes.STOPPED, now_ns, message)
        elif base.source not in (None, OWN_SOURCE):
            drove_before = before is not None and before.source == base.source
            if not drove_before or now_ns - goal.sent_ns > SETTLED_S * 1e9:
                why = f"{base.source} drives the robot; resume the goal to go on."
                self.pause(codes.TAKEN_OVER, now_ns, why)

    def begin_epoch(self, now_ns: int) -> None:
        """Pause the goal, since base was restarted; end it where nobody knows its place any more.

        In frame `odom` that is so: the odometry begins anew at zero, wherever the robot is.
        """
        if self._inputs.frame == "odom":
            if self._current.board.is_active:
                self._spin.stop()
                why = "The base was restarted, and the odometry with it; send the goal again."
                self._current.end("failed", codes.RESTARTED, now_ns, why)
        elif self._goes_on_by_itself:
            why = "The base was restarted; resume the goal to go on."
            self.pause(codes.RESTARTED, now_ns, why)

    def pause_off_map(self, now_ns: int) -> None:
        """Pause a goal whose path leads further off the map."""
        execution, off_m = self._current.execution, self._inputs.off_map_m
        if execution is None or off_m is None or not self._current.is_driving:
            return
        if execution.route.leads_off_map(off_m):
            self.pause(codes.OFF_MAP, now_ns)

    def is_back_on_map(self, now_ns: int) -> bool:
        """Say whether a goal that was paused off the map may go on."""
        base, pose = self._inputs.base, self._inputs.pose
        if self._current.execution is None or not self._waits_off_map:
            return False
        is_ours = base is None or (base.source in (None, OWN_SOURCE) and not base.is_halted)
        is_sure = pose is not None and pose.state == "localized"
        is_back = is_sure and self._inputs.off_map_m is None
        return is_back and is_ours and self._costmap_manager.trouble(now_ns) is None

    @property
    def _waits_off_map(self) -> bool:
        """Whether the goal was paused off the map, and goes on once the robot is back."""
        board = self._current.board
        return (board.state, board.reason) == ("paused", codes.OFF_MAP)

    @property
    def _goes_on_by_itself(self) -> bool:
        """Whether the robot drives to the goal, or will without being asked."""
        board = self._current.board
        return board.is_active and (board.state != "paused" or self._waits_off_map)
