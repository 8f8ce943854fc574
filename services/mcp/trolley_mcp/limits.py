"""How much an assistant may ask in a while. A stop is never counted."""

import dataclasses

from trolley.codes import Refused

TOO_MANY = "too_many"
"""Code of a call that comes too soon; it never reaches the robot."""


@dataclasses.dataclass
class Bucket:
    """So many at once, and then so many each second.

    Source:
        Turner, New directions in communications (1986): the leaky bucket as a meter.
    """

    most: float
    per_s: float
    _left: float = dataclasses.field(init=False)
    _at_s: float = dataclasses.field(init=False, default=0.0)

    def __post_init__(self) -> None:
        self._left = self.most

    def wait_s(self, now_s: float) -> float:
        """Take one, and return 0; or take none, and return how long until there is one [s]."""
        self._left = min(self.most, self._left + (now_s - self._at_s) * self.per_s)
        self._at_s = now_s
        if self._left < 1.0:
            return (1.0 - self._left) / self.per_s
        self._left -= 1.0
        return 0.0


class CallLimits:
    """What one session may ask."""

    MOST_AT_ONCE = 8
    """Calls that wait for an answer at the same time."""

    def __init__(self) -> None:
        self._calls = Bucket(most=20.0, per_s=4.0)
        self._commands = Bucket(most=6.0, per_s=0.5)
        self.num_in_progress = 0

    def check(self, now_s: float, *, is_command: bool) -> None:
        """Count a call.

        Raises:
            Refused: `too_many`.
        """
        if self.num_in_progress >= self.MOST_AT_ONCE:
            raise Refused(
                TOO_MANY,
                f"{self.num_in_progress} calls wait for an answer already, and no more may.",
            )
        wait_s = self._calls.wait_s(now_s)
        if wait_s == 0.0 and is_command:
            wait_s = self._commands.wait_s(now_s)
        if wait_s > 0.0:
            raise Refused(TOO_MANY, f"Too many calls: the next one is taken in {wait_s:.1f} s.")
