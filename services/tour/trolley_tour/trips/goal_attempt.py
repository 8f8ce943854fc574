"""One goal that a trip asks the planner for: does the planner have it, and when to ask again."""

from trolley.messages import GoalStatus
from trolley_tour.trips.record import Moment
from trolley_tour.trips.trip_params import TripParams


class GoalAttempt:
    """What is known of the goal under way."""

    def __init__(self, params: TripParams) -> None:
        self.seconds = 0.0
        """Robot time [s] of driving to it so far."""
        self._params = params
        self._is_accepted = False
        """Whether the planner has said that it has the goal."""
        self._is_answer_due = False
        """Whether the goal was sent and the answer is still to come."""
        self._stamp_ns = 0
        self._heard_ns = 0
        self._send_again_ns = 0

    def sent(self, at: Moment) -> None:
        """The goal was sent."""
        self._is_answer_due = True
        self._send_again_ns = at.monotonic_ns + int(self._params.ask_again_s * 1e9)

    def answered(self) -> None:
        """The planner answered, whatever it said."""
        self._is_answer_due = False

    def refused(self) -> None:
        """The planner did not accept the goal yet."""
        self._is_accepted = False

    def update(self, status: GoalStatus, at: Moment) -> None:
        """The planner reported on the goal."""
        self._stamp_ns = max(self._stamp_ns, status.stamp_ns)
        self._is_accepted, self._heard_ns = True, at.monotonic_ns

    def update_idle(self, status: GoalStatus, at: Moment) -> None:
        """The planner reported that it has no goal: restarted, or it has not taken ours yet."""
        if self._is_accepted and status.stamp_ns > self._stamp_ns:
            self.lost(at)

    def lost(self, at: Moment) -> None:
        """The planner no longer has the goal: send it again at once."""
        self._is_accepted, self._send_again_ns = False, at.monotonic_ns

    def is_due(self, at: Moment) -> bool:
        """Whether to send the goal (again): it is not accepted, or the planner is silent."""
        is_silent = at.monotonic_ns - self._heard_ns > int(self._params.silence_s * 1e9)
        may_send = not self._is_answer_due and at.monotonic_ns >= self._send_again_ns
        return may_send and (is_silent or not self._is_accepted)
