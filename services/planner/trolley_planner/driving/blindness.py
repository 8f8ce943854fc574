"""Whether the goal is held up by what the lidar does not see: nobody drives into that."""

import math

from trolley import codes
from trolley.geometry import Pose2D
from trolley.messages import BaseState
from trolley_planner.context.motion_state import ControlInput
from trolley_planner.driving.goal_execution import GoalExecution
from trolley_planner.sensing.inputs import OWN_SOURCE, Inputs

SHUT_IN = (
    "The lidar has not seen for long what is behind the robot, and it has no room to turn: "
    "drive it out by hand."
)
BLIND_S = 30.0
"""A goal that is blocked so soon after base was held because the lidar sees nothing is blind."""

QUARTER_RAD = 0.5 * math.pi
"""A robot that can turn so far comes to see what was behind it [rad]."""


class Blindness:
    """Remembers that base did not drive as commanded because the lidar sees nothing there.

    The planner itself does not back up there either.

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

    def trouble(self, execution: GoalExecution, now: ControlInput) -> tuple[str, str | None]:
        """Return the code of what keeps the robot from its goal, and a sentence if blind."""
        if execution.trouble not in ("", codes.BLOCKED):
            return execution.trouble, None
        if self._last is not None and now.now_ns - self._last[0] <= BLIND_S * 1e9:
            return codes.BLIND, self._last[1]
        if execution.trouble == codes.BLOCKED and _is_shut_in(execution, now.motion.pose):
            return codes.BLIND, SHUT_IN
        return execution.trouble, None


def _is_shut_in(execution: GoalExecution, pose: Pose2D) -> bool:
    """Say whether the robot could only back up, where nothing is known to stand in the way."""
    context = execution.context
    return (
        not execution.route.is_blocked
        and not context.local_costmap.known_floor.sees_behind(pose)
        and not any(context.can_turn_by(pose, turn, 0.0) for turn in (-QUARTER_RAD, QUARTER_RAD))
    )
