"""Whether a restart of the planner has lost a drive that nobody sends again."""

from trolley.messages import GoalStatus
from trolley.under_way import EXPLORES, GOAL_UNDER_WAY, trip_of


class LastDrive:
    """The goal that the robot was driving to when it was last heard of one."""

    def __init__(self) -> None:
        self._goal: GoalStatus | None = None

    def update(self, goal: GoalStatus | None) -> GoalStatus | None:
        """Take the newest status; return the goal that was lost, None if none was.

        Only a planner that has just started is idle: every goal that it was given ends otherwise.
        """
        if goal is None:
            return None
        if goal.state == "idle":
            return self._goal
        is_sent_again = trip_of(goal.id) is not None or (goal.id or "").startswith(EXPLORES)
        is_single = goal.state in GOAL_UNDER_WAY and not is_sent_again
        self._goal = goal if is_single else None
        return None
