"""What is known of the goal that a trip asked the planner for."""

from trolley.messages import GoalStatus
from trolley_tour.trips.record import Moment

ASK_AGAIN_NS = 1_000_000_000
"""A goal that the planner has not taken is sent again this often."""
SILENCE_NS = 2_000_000_000
"""The planner reports at 5 Hz; after this long it is asked whether it still drives."""


class Asking:
    """Whether the planner has the goal, and when to ask it again."""

    def __init__(self) -> None:
        self.is_accepted = False
        """Whether the planner has said that it has the goal."""
        self.is_standing = False
        """Whether the planner has said that a paused trip's goal stands."""
        self._waits_for: str | None = None
        self._stamp_ns = 0
        self._heard_ns = 0
        self._due_ns = 0
        self._corrected_ns: int | None = None

    def renew(self) -> None:
        """Begin anew, with another goal."""
        self.is_accepted, self._stamp_ns = False, 0

    def sent(self, goal_id: str | None, at: Moment) -> None:
        """The goal was sent."""
        self._waits_for, self._due_ns = goal_id, at.monotonic_ns + ASK_AGAIN_NS

    def answered(self, goal_id: str) -> None:
        """The answer to a goal that was sent is there."""
        if self._waits_for == goal_id:
            self._waits_for = None

    def heard(self, status: GoalStatus, at: Moment) -> None:
        """The planner said how the goal goes."""
        self._stamp_ns = max(self._stamp_ns, status.stamp_ns)
        self.is_accepted, self._heard_ns = True, at.monotonic_ns

    def heard_nothing(self, status: GoalStatus, at: Moment) -> None:
        """The planner has no goal: it was restarted, unless it said so before it took ours."""
        if self.is_accepted and status.stamp_ns > self._stamp_ns:
            self.lost(at)

    def lost(self, at: Moment) -> None:
        """The planner does not have the goal any more: send it again at once."""
        self.is_accepted, self._due_ns = False, at.monotonic_ns

    def is_due(self, at: Moment) -> bool:
        """Whether to send the goal (again): it is not taken, or the planner has fallen silent."""
        silent = at.monotonic_ns - self._heard_ns > SILENCE_NS
        free = self._waits_for is None and at.monotonic_ns >= self._due_ns
        return free and (silent or not self.is_accepted)

    def may_correct(self, at: Moment) -> bool:
        """Whether to repeat what a goal of ours did not heed, once a second."""
        last_ns = self._corrected_ns
        if last_ns is not None and at.monotonic_ns - last_ns < ASK_AGAIN_NS:
            return False
        self._corrected_ns = at.monotonic_ns
        return True
