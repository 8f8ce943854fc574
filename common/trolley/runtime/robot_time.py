"""Robot time: the one clock that every stamp counts, owned by `base`, followed by all others."""

from collections import deque
from typing import Protocol

from trolley.messages import Clock

SILENCE_NS = 1_000_000_000
WINDOW_NS = 10_000_000_000


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


class FollowedTime:
    """Robot time from `clock` messages.

    The maximum, over the messages of the present epoch and rate in the last 10 s, of stamp + rate x
    local time since arrival; it holds rather than goes back; without a message for 1 s there is
    none.
    """

    def __init__(self) -> None:
        """Start without robot time."""
        self.epoch = 0
        self.rate = 1.0
        self._offsets: deque[tuple[int, float]] = deque()
        self._offset = 0.0
        self._heard_ns: int | None = None
        self._last: int | None = None

    def hear(self, clock: Clock, arrived_ns: int) -> bool:
        """Take a clock message that arrived at local `arrived_ns`; True when a new epoch began."""
        known = self._heard_ns is not None
        silent = self._heard_ns is None or arrived_ns - self._heard_ns > SILENCE_NS
        if known and clock.epoch < self.epoch and not silent:
            return False
        began = not known or clock.epoch != self.epoch
        if began or clock.rate != self.rate:
            self._offsets.clear()
        if began:
            self._last = None
        self.epoch, self.rate = clock.epoch, clock.rate
        while self._offsets and arrived_ns - self._offsets[0][0] > WINDOW_NS:
            self._offsets.popleft()
        self._offsets.append((arrived_ns, clock.stamp_ns - clock.rate * arrived_ns))
        self._offset = max(offset for _, offset in self._offsets)
        self._heard_ns = arrived_ns
        return began

    def now(self, monotonic_ns: int) -> int | None:
        """Robot time [ns] at local `monotonic_ns`, None without a message in the last second."""
        if self._heard_ns is None or monotonic_ns - self._heard_ns > SILENCE_NS:
            return None
        now = round(self._offset + self.rate * monotonic_ns)
        self._last = now if self._last is None else max(self._last, now)
        return self._last
