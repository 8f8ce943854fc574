"""The goal's status: state, reason, and a sentence for people."""

from collections import OrderedDict

from trolley import codes
from trolley.codes import SENTENCES
from trolley.messages import GoalState, GoalStatus
from trolley_planner.goals.goal import ACTIVE, Goal

KEPT_GOALS = 32


class StatusBoard:
    """The state of the current goal, and every change of it in its order.

    Args:
        frame: of the goals.
    """

    def __init__(self, frame: str) -> None:
        self.goal: Goal | None = None
        self.state: GoalState = "idle"
        self.reason = ""
        self.message = ""
        self.history = GoalHistory()
        self._frame = frame
        self._changes: list[GoalStatus] = []
        self._ended_ns: int | None = None
        self._details: GoalStatus | None = None

    @property
    def is_active(self) -> bool:
        """Whether there is a goal that is not over."""
        return self.state in ACTIVE

    def begin(self, goal: Goal) -> None:
        """Begin a new goal; `set` follows it."""
        self.goal = goal
        self._ended_ns = None
        self._details = None

    def set(
        self,
        state: GoalState,
        reason: str,
        now_ns: int,
        message: str | None = None,
        details: GoalStatus | None = None,
    ) -> None:
        """Enter a state; nothing happens where state, reason and message stay the same.

        Args:
            state: the new state.
            reason: a code, "" if there is none.
            now_ns: robot time.
            message: one sentence; that of the code if not given.
            details: distance, time and so on at this moment.
        """
        sentence = SENTENCES.get(reason, "") if message is None else message
        if (state, reason, sentence) == (self.state, self.reason, self.message):
            return
        self.state, self.reason, self.message = state, reason, sentence
        if not self.is_active:
            self._ended_ns = now_ns
        self._changes.append(self.snapshot(now_ns, details))

    def snapshot(self, now_ns: int, details: GoalStatus | None = None) -> GoalStatus:
        """Return the present status, and keep it for whoever asks by id later."""
        goal = self.goal
        # How it ended stays known after its execution is gone.
        self._details = details = self._details if details is None else details
        end_ns = now_ns if self._ended_ns is None else self._ended_ns
        status = GoalStatus(
            stamp_ns=now_ns,
            id=None if goal is None else goal.id,
            state=self.state,
            reason=self.reason,
            message=self.message,
            frame=self._frame,
            pose=None if goal is None else goal.pose,
            distance_remaining=None if details is None else details.distance_remaining,
            eta=None if details is None or not self.is_active else details.eta,
            elapsed=0.0 if goal is None else max(0.0, (end_ns - goal.sent_ns) * 1e-9),
            recoveries=0 if details is None else details.recoveries,
            blocked=[] if details is None else details.blocked,
        )
        self.history.remember(status)
        return status

    def pop_changes(self) -> list[GoalStatus]:
        """Return every status since the last call, oldest first."""
        changes, self._changes = self._changes, []
        return changes

    def check_current(self, goal_id: str | None) -> None:
        """Refuse unless this is the current goal, and it is not over.

        Raises:
            Refused: `not_current`.
        """
        goal = self.goal
        if goal is None or not self.is_active or (goal_id is not None and goal_id != goal.id):
            raise codes.Refused(codes.NOT_CURRENT)


class GoalHistory:
    """The last goals by their id."""

    def __init__(self) -> None:
        self._statuses: OrderedDict[str, GoalStatus] = OrderedDict()

    def remember(self, status: GoalStatus) -> None:
        """Keep the newest status of a goal; drop the oldest goals."""
        if status.id is None:
            return
        self._statuses[status.id] = status
        self._statuses.move_to_end(status.id)
        while len(self._statuses) > KEPT_GOALS:
            self._statuses.popitem(last=False)

    def find(self, goal_id: str) -> GoalStatus | None:
        """Return the newest status of a goal, None if it is not known (any more)."""
        return self._statuses.get(goal_id)
