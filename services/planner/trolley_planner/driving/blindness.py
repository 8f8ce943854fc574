"""Whether the goal is held up by what the lidar does not see: base does not drive into that."""

from trolley import codes
from trolley.messages import BaseState
from trolley_planner.driving.goal_execution import GoalExecution
from trolley_planner.sensing.inputs import OWN_SOURCE, Inputs

BLIND_S = 30.0
"""A goal that is blocked so soon after base was held because the lidar sees nothing is blind."""


class Blindness:
    """Remembers that base did not drive as commanded because the lidar sees nothing there.

    Args:
        inputs: the newest messages.
    """

    def __init__(self, inputs: Inputs) -> None:
        self._inputs = inputs
        self._last: tuple[int, str] | None = None
        """When base last held the robot for that, and what it said."""

    @property
    def is_held(self) -> bool:
        """Whether base holds the robot for that now."""
        base = self._inputs.base
        return base is not None and (base.mode, base.reason) == ("held", codes.BLIND)

    def update_base(self, base: BaseState, now_ns: int) -> None:
        """Take in the base's state, which is in the inputs already."""
        if self.is_held and base.source == OWN_SOURCE:
            self._last = now_ns, base.message

    def forget(self) -> None:
        """Forget it, as when the robot sets off."""
        self._last = None

    def trouble(self, execution: GoalExecution, now_ns: int) -> tuple[str, str | None]:
        """Return the code of what keeps the robot from its goal, and base's sentence if blind."""
        if self._last is None or now_ns - self._last[0] > BLIND_S * 1e9:
            return execution.trouble, None
        is_blocked = execution.trouble in ("", codes.BLOCKED)
        return (codes.BLIND, self._last[1]) if is_blocked else (execution.trouble, None)
