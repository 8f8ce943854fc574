"""Presses of Stop: repeated until the robot has answered, and shown as unanswered until then."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

PATIENCE_NS = 400_000_000
"""Without an answer for this long the robot is not stopped, and Stop is asked again."""
REPEAT_NS = 250_000_000
NOT_STOPPED = "NOT STOPPED: no connection"
MOST_NAMED = 5
"""Of so many other robots it is said by name that they have not stopped."""

Answered = Callable[[bool], None]
"""Called with whether the robot answered."""
AskStop = Callable[[str, Answered], None]
"""Asks a robot to stop, and calls back with whether it answered."""


@dataclass
class _Press:
    """One press of Stop; the robot counts as stopped only when `base` has answered."""

    pressed_ns: int
    next_try_ns: int
    has_failed: bool = False


@dataclass(frozen=True)
class StopLine:
    """The line that the page shows about a stop that is not confirmed."""

    text: str
    is_alarm: bool


DISOBEYED = StopLine("NOT STOPPED: the motor board does not obey", is_alarm=True)
"""`base` has answered, and the robot moves all the same."""
UNCONFIRMED = StopLine("STOP NOT CONFIRMED: the motor board is silent", is_alarm=True)
"""`base` has answered, and nobody knows whether the robot moves."""


class StopPresses:
    """The presses that are not answered yet, one for each robot.

    They are repeated forever, whatever robot is shown by then and even with no browser open; only
    an answer or Resume ends them.
    """

    def __init__(self, ask: AskStop) -> None:
        self._ask = ask
        self._presses: dict[str, _Press] = {}
        self._resuming: Counter[str] = Counter()

    @property
    def num_waiting(self) -> int:
        """How many robots have yet to answer."""
        return len(self._presses)

    def press(self, robot: str, now_ns: int) -> None:
        """Stop a robot, at once and until it answers."""
        if robot not in self._presses:
            self._presses[robot] = _Press(now_ns, now_ns)
        self._presses[robot].next_try_ns = now_ns
        self.tick(now_ns)

    def release(self, robot: str) -> None:
        """Take the press back, as the robot is asked to resume; `resumed` tells of the answer."""
        self._presses.pop(robot, None)
        self._resuming[robot] += 1

    def resumed(self, robot: str) -> None:
        """The robot has answered: whoever pressed Stop since asks once more, to come after it."""
        self._resuming[robot] -= 1
        if robot in self._presses:
            self._presses[robot].next_try_ns = 0

    def tick(self, now_ns: int) -> None:
        """Repeat the presses that are due."""
        for robot, press in tuple(self._presses.items()):
            if now_ns >= press.next_try_ns:
                press.next_try_ns = now_ns + PATIENCE_NS
                self._ask(robot, self._answer_to(robot, press, now_ns))

    def line(self, robot: str, now_ns: int) -> StopLine | None:
        """What to say while this robot is shown; None where no press waits for an answer."""
        lost = sorted(
            name
            for name, press in self._presses.items()
            if press.has_failed or now_ns - press.pressed_ns > PATIENCE_NS
        )
        if lost:
            others = [name for name in lost if name != robot]
            named = ", ".join(others[:MOST_NAMED]) + (", …" if len(others) > MOST_NAMED else "")
            return StopLine(NOT_STOPPED + (f" ({named})" if named else ""), is_alarm=True)
        return StopLine("Stopping …", is_alarm=False) if self._presses else None

    def _answer_to(self, robot: str, press: _Press, asked_ns: int) -> Callable[[bool], None]:
        def answer(is_answered: bool) -> None:
            if self._presses.get(robot) is not press:
                return
            if is_answered and self._resuming[robot] > 0:
                press.next_try_ns = asked_ns + REPEAT_NS  # else the two might have met out of order
            elif is_answered:
                del self._presses[robot]
            else:
                press.has_failed = True
                press.next_try_ns = min(press.next_try_ns, asked_ns + REPEAT_NS)

        return answer
