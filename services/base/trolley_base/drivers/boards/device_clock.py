"""Robot time of what a board stamps with a clock of its own, which ours has set, and which drifts.

How much later than its stamp a message comes is the way over the line, and what the clocks differ
by. Just after the board has asked for the time only the way is left: what the least late of many
messages is later than then, later on, is the drift.
"""

from collections import deque

WINDOW = 64
"""Of so many messages one is expected to come without delay."""
LONGEST_WAY_NS = 300_000_000
"""A way that seems longer, or negative, is none: the board has set its clock by something else."""
LEAP_NS = 1_000_000_000
"""By so much a clock does not drift: it was set."""


class DeviceClock:
    """Turns a board's stamps into robot time; no stamp is later than its arrival, or goes back."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget the board; until its clock is set, the way is taken to be nothing."""
        self._delays_ns: deque[int] = deque(maxlen=WINDOW)
        self._num_to_learn = 0
        self._way_ns = 0
        self._newest_ns = 0

    def note_set(self) -> None:
        """The board has just set its clock by ours: learn the way."""
        self._delays_ns.clear()
        self._num_to_learn = WINDOW

    def stamp(self, device_ns: int, arrived_ns: int) -> int:
        """Return the robot time of a stamp [ns]; `arrived_ns` never goes back."""
        delay_ns = arrived_ns - device_ns
        if self._delays_ns and abs(delay_ns - self._delays_ns[-1]) > LEAP_NS:
            self._delays_ns.clear()
        self._delays_ns.append(delay_ns)
        least_ns = min(self._delays_ns)
        if self._num_to_learn:
            self._num_to_learn -= 1
            self._way_ns = least_ns if 0 <= least_ns <= LONGEST_WAY_NS else 0
        stamp_ns = min(device_ns + least_ns - self._way_ns, arrived_ns)
        self._newest_ns = max(self._newest_ns, stamp_ns)
        return self._newest_ns
