"""Robot time: the one clock that all stamps refer to, owned by `base`, followed by all others."""

import dataclasses
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple, Protocol

from trolley.messages import Clock

SILENCE_NS = 1_000_000_000
"""After this long without a `clock` message there is no robot time."""
WINDOW_NS = 10_000_000_000
"""How far back the messages count that robot time is computed from."""
LEAP_NS = 2_000_000_000
"""A message that would move robot time by more than this, in local time, is not believed [ns]."""
LATE_NS = 60_000_000_000
"""No pause of a base makes its clock fall behind what was told before by more than this [ns]."""


class TimeSource(Protocol):
    """Gives robot time at a moment of the local monotonic clock."""

    @property
    def epoch(self) -> int:
        """Robot time [ns] at which the present run of `base` began."""
        ...

    @property
    def rate(self) -> float:
        """Robot seconds per real second."""
        ...

    def now(self, monotonic_ns: int) -> int | None:
        """Robot time [ns], None while unknown."""
        ...


@dataclasses.dataclass(frozen=True, slots=True)
class _Heard:
    """A clock message."""

    arrived_ns: int
    stamp_ns: int

    def extended(self, rate: float, monotonic_ns: int) -> int:
        """Its stamp carried on to a local time.

        Only the short time since its arrival becomes a float: stamps count from 1970, where the
        next float is 256 ns away.
        """
        return self.stamp_ns + round(rate * (monotonic_ns - self.arrived_ns))


class Settled(NamedTuple):
    """What came of a message that base was asked about."""

    is_believed: bool
    began: bool
    """Whether a new epoch began."""


class FollowedTime:
    """Robot time from `clock` messages.

    The maximum, over the messages of the present epoch and rate in the last 10 s, of stamp + rate x
    local time since arrival; it holds rather than goes back; without a message for 1 s there is
    none.
    """

    def __init__(self) -> None:
        """Start without robot time."""
        self.epoch = 0
        self.rate: float = 1.0
        self._heard: deque[_Heard] = deque()
        self._heard_ns: int | None = None
        self._doubted: Clock | None = None
        self._last: int | None = None

    def is_running(self, monotonic_ns: int) -> bool:
        """Whether a message was taken in within the last second."""
        return self._heard_ns is not None and monotonic_ns - self._heard_ns <= SILENCE_NS

    def follows(self, clock: Clock, arrived_ns: int) -> bool:
        """Whether a message is what the ones before it and the time since then allow."""
        if self._heard_ns is None or (clock.epoch, clock.rate) != (self.epoch, self.rate):
            return False
        latest_ns = self._heard[0].extended(self.rate, arrived_ns)
        return clock.stamp_ns <= latest_ns + _leap_ns(clock) and not self._is_behind(clock)

    def settle(
        self,
        clock: Clock,
        arrived_ns: int,
        answers: Sequence[Clock],
        answered_ns: int,
        *,
        timed_out: bool,
    ) -> Settled:
        """Take in a message that does not follow, or what base says instead.

        Where no base answers, a newer epoch is taken, and anything while there is no robot time.

        Args:
            clock: the message.
            arrived_ns: when it arrived.
            answers: what base said when it was asked for its clock; of several the one that is
                followed already counts.
            answered_ns: when that arrived.
            timed_out: whether a base may be there and had no time to answer.
        """
        known = [one for one in answers if self.follows(one, answered_ns)]
        answer = next(iter(known or answers), None)
        if answer is None:
            is_new = clock.epoch > self.epoch and not timed_out
            is_believed = is_new or not self.is_running(arrived_ns)
        else:
            is_believed = _is_of_one_base(clock, answer)
        if is_believed:
            return Settled(True, self.update(clock, arrived_ns))
        return Settled(False, answer is not None and self.update(answer, answered_ns))

    def hear(self, clock: Clock, arrived_ns: int) -> None:
        """Take in a message where base cannot be asked: what does not follow has to come twice."""
        doubted, self._doubted = self._doubted, None
        is_allowed = self.follows(clock, arrived_ns) or not self.is_running(arrived_ns)
        is_second = clock != doubted and _is_of_one_base(clock, doubted)
        if is_allowed or is_second:
            self.update(clock, arrived_ns)
        else:
            self._doubted = clock

    def update(self, clock: Clock, arrived_ns: int) -> bool:
        """Take in a message that arrived at local `arrived_ns`; True when a new epoch began.

        Whether it can be believed is decided before: see `follows`. Time that a wrong message had
        moved far ahead starts over, as in a new epoch.
        """
        began = self._heard_ns is None or clock.epoch != self.epoch or self._is_behind(clock)
        if began or clock.rate != self.rate:
            self._heard.clear()
        if began:
            self._last = None
        self.epoch, self.rate = clock.epoch, clock.rate
        while self._heard and arrived_ns - self._heard[0].arrived_ns > WINDOW_NS:
            self._heard.popleft()
        # What an older message says less than a newer one is never the maximum again, so the first
        # of those that are left always is.
        while self._heard and self._heard[-1].extended(self.rate, arrived_ns) < clock.stamp_ns:
            self._heard.pop()
        self._heard.append(_Heard(arrived_ns, clock.stamp_ns))
        self._heard_ns = arrived_ns
        return began

    def now(self, monotonic_ns: int) -> int | None:
        """Robot time [ns] at local `monotonic_ns`, None without a message in the last second."""
        if self._heard_ns is None or monotonic_ns - self._heard_ns > SILENCE_NS:
            return None
        now = self._heard[0].extended(self.rate, monotonic_ns)
        self._last = now if self._last is None else max(self._last, now)
        return self._last

    def even_until_ns(self, monotonic_ns: int) -> int:
        """Local time [ns] until which it goes on at its rate if no message comes."""
        if self._heard_ns is None or monotonic_ns - self._heard_ns > SILENCE_NS:
            return monotonic_ns + SILENCE_NS
        return self._heard_ns + SILENCE_NS

    def _is_behind(self, clock: Clock) -> bool:
        return self._last is not None and clock.stamp_ns < self._last - LATE_NS


def _leap_ns(clock: Clock) -> int:
    return round(LEAP_NS * max(1.0, clock.rate))


def _is_of_one_base(one: Clock, other: Clock | None) -> bool:
    """Whether two messages can be of the same run of a base, at about the same time."""
    if other is None or (one.epoch, one.rate) != (other.epoch, other.rate):
        return False
    return abs(one.stamp_ns - other.stamp_ns) <= _leap_ns(one)


class RobotClocks:
    """The clock of each robot as heard on the wire; the service that owns robot time has its own.

    Args:
        robot: The service's own robot.
        own: The clock of that robot where the service owns it.
    """

    def __init__(self, robot: str, own: TimeSource | None = None) -> None:
        self._robot = robot
        self._own = own
        self._followed: dict[str, FollowedTime] = {}

    @property
    def own(self) -> TimeSource:
        """The clock of the service's own robot."""
        return self.of(self._robot)

    def of(self, robot: str) -> TimeSource:
        """The clock of a robot."""
        if robot == self._robot and self._own is not None:
            return self._own
        return self.followed(robot)

    def epoch_of(self, robot: str) -> int:
        """The epoch of a robot, 0 where its clock is not known: any name costs no memory."""
        if robot == self._robot and self._own is not None:
            return self._own.epoch
        followed = self._followed.get(robot)
        return 0 if followed is None else followed.epoch

    def followed(self, robot: str) -> FollowedTime:
        """The clock of a robot as heard on the wire."""
        if robot not in self._followed:
            self._followed[robot] = FollowedTime()
        return self._followed[robot]
