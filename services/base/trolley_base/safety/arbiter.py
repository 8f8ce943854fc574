"""Which velocity command wins: priorities, freshness, and a pause before a lower source drives."""

import enum
from collections.abc import Mapping
from dataclasses import dataclass

from trolley.geometry import Twist2D
from trolley.messages import VelocityCommand

MAX_VALID_NS = 500_000_000
"""A command is good for at most this long, whatever its sender says [ns]."""
MAX_AGE_NS = 500_000_000
"""A command that was stamped longer before its arrival is of a situation that is over [ns]."""
MAX_AHEAD_NS = 200_000_000
"""A stamp may be ahead by this much; clocks that follow base's are never that far off [ns]."""
HOLD_NS = 1_000_000_000
"""After a source falls silent, base stands for this long before a lower one may drive [ns]."""


class Reject(enum.Enum):
    """Why a command was dropped; the value is the counter's name under `cmd_vel/`."""

    UNKNOWN_SOURCE = "unknown_source"
    NOT_FINITE = "not_finite"
    NOT_VALID = "not_valid"
    OLD = "old"
    REPEATED = "repeated"
    OUT_OF_ORDER = "out_of_order"
    AHEAD = "ahead"


_BY_ROBOT_TIME = "stamp commands by robot time, as on `clock`, not by a computer's clock"
WHY: Mapping[Reject, str] = {
    Reject.UNKNOWN_SOURCE: "[base] sources does not name its source",
    Reject.NOT_FINITE: "its velocity is not a number",
    Reject.NOT_VALID: "its valid_for is not a number of seconds above 0",
    Reject.OLD: f"its stamp is more than 0.5 s old: the link is slow, or {_BY_ROBOT_TIME}",
    Reject.REPEATED: "it was heard before",
    Reject.OUT_OF_ORDER: "its stamp is not newer than that of its source's last command: "
    f"{_BY_ROBOT_TIME}, and let one program send them",
    Reject.AHEAD: f"its stamp is more than 0.2 s ahead: {_BY_ROBOT_TIME}",
}
"""Why a command was dropped, in words for the log."""


@dataclass(frozen=True, slots=True)
class Choice:
    """Who drives.

    Attributes:
        source: None while nobody may: nothing fresh, or the pause after a silence.
        twist: what the source wants, zero for nobody.
        scan_ns: stamp of the scan that the command was computed with, 0 if none.
        lost: the source that drove has fallen silent while it was moving the robot.
    """

    source: str | None
    twist: Twist2D
    scan_ns: int = 0
    lost: bool = False


@dataclass(slots=True)
class _Wish:
    """A source's newest command, in robot time of base's own clock."""

    twist: Twist2D
    scan_ns: int
    arrived_ns: int
    valid_ns: int
    is_new: bool = True
    """Whether no decision has been taken since it came."""

    def is_fresh(self, now_ns: int) -> bool:
        """Whether it still holds: as long as it is valid, and for one decision in any case."""
        good_ns = MAX_VALID_NS if self.is_new else self.valid_ns
        return now_ns - self.arrived_ns < good_ns


class Arbiter:
    """Keeps the newest command of each source and chooses between them.

    All times are robot time by base's own clock, so a command counts from its arrival and a wrong
    clock of its sender can neither prolong nor revive it.

    Args:
        priorities: of each source that may drive; the highest with a fresh command wins.
    """

    def __init__(self, priorities: Mapping[str, int]) -> None:
        self._priorities = dict(priorities)
        self._wishes: dict[str, _Wish] = {}
        self._accepted: dict[str, VelocityCommand] = {}
        self._driving: str | None = None
        self._moved = False

    def offer(
        self, source: str, command: VelocityCommand, arrived_ns: int, foremost_ns: int
    ) -> Reject | None:
        """Take a command, or say why not.

        Args:
            source: who sent it.
            command: the velocity, and how long it is good for.
            arrived_ns: when it arrived.
            foremost_ns: the latest that others can believe robot time to be.
        """
        if source not in self._priorities:
            return Reject.UNKNOWN_SOURCE
        if not command.twist.is_finite():
            return Reject.NOT_FINITE
        # Written so that NaN is refused, too; an endless one is not a number of seconds either.
        if not 0.0 < command.valid_for < float("inf"):
            return Reject.NOT_VALID
        if command.stamp_ns > foremost_ns + MAX_AHEAD_NS:
            return Reject.AHEAD
        last = self._accepted.get(source)
        if command == last:
            return Reject.REPEATED
        if command.stamp_ns < arrived_ns - MAX_AGE_NS:
            return Reject.OLD
        if last is not None and command.stamp_ns <= last.stamp_ns:
            return Reject.OUT_OF_ORDER
        self._accepted[source] = command
        # The limit first: a number of seconds near the largest float is none of nanoseconds.
        valid_ns = round(min(command.valid_for, MAX_VALID_NS / 1e9) * 1e9)
        self._wishes[source] = _Wish(command.twist, command.scan_ns, arrived_ns, valid_ns)
        return None

    def choose(self, now_ns: int) -> Choice:
        """Say who drives now."""
        fresh = [source for source, wish in self._wishes.items() if wish.is_fresh(now_ns)]
        for wish in self._wishes.values():
            wish.is_new = False
        best = max(fresh, key=self._rank, default=None)
        driving = self._driving
        if driving is not None and driving not in fresh:
            silent = self._wishes[driving]
            silent_ns = now_ns - (silent.arrived_ns + silent.valid_ns)
            is_lower = best is None or self._priorities[best] < self._priorities[driving]
            if is_lower and silent_ns < HOLD_NS:
                return Choice(None, Twist2D.zero(), lost=self._moved)
        self._driving = best
        if best is None:
            return Choice(None, Twist2D.zero())
        wish = self._wishes[best]
        self._moved = not wish.twist.is_zero
        return Choice(best, wish.twist, wish.scan_ns)

    def forget(self) -> None:
        """Drop every command: only what arrives from now on can move the robot."""
        self._wishes.clear()
        self._driving = None

    def _rank(self, source: str) -> tuple[int, bool, str]:
        """Order sources; of two equals the one that drives stays."""
        return self._priorities[source], source == self._driving, source
