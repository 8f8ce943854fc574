"""Robot time: the one clock that all stamps refer to, owned by `base`, followed by all others."""

import dataclasses
from collections import deque
from typing import Protocol

from trolley.messages import Clock

SILENCE_NS = 1_000_000_000
"""After this long without a `clock` message there is no robot time."""
WINDOW_NS = 10_000_000_000
"""How far back the messages count that robot time is computed from."""


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
        self._last: int | None = None

    def update(self, clock: Clock, arrived_ns: int) -> bool:
        """Take in a message that arrived at local `arrived_ns`; True when a new epoch began."""
        known = self._heard_ns is not None
        silent = self._heard_ns is None or arrived_ns - self._heard_ns > SILENCE_NS
        if known and clock.epoch < self.epoch and not silent:
            return False
        began = not known or clock.epoch != self.epoch
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
        return self._follow(robot)

    def update(self, robot: str, clock: Clock, arrived_ns: int) -> bool:
        """Take in a `clock` message of a robot; True when a new epoch began."""
        return self._follow(robot).update(clock, arrived_ns)

    def _follow(self, robot: str) -> FollowedTime:
        if robot not in self._followed:
            self._followed[robot] = FollowedTime()
        return self._followed[robot]
