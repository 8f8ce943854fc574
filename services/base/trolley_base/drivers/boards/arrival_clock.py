"""When a board sent what arrived: an even clock behind arrivals that are late by chance.

A board without stamps reports at its own even pace; serial drivers, threads and a busy host delay
its frames, never the other way round. So arrivals are compared with a grid of that pace, and the
least delayed of the last frames says how the grid lies: frames that were held up and come together
get the times at which they were sent. No stamp is later than its arrival or earlier than the stamp
before, and all intervals together are the time that passed.
"""

from collections import deque

WINDOW = 16
"""Of this many frames at least one is expected to arrive without delay; after a frame is lost, the
grid is right again after as many."""
MOST_INTERVALS, NOMINAL_INTERVALS = 256, 32
"""The period is the mean of at most this many intervals between arrivals; the nominal period counts
for this many of them at first."""
MOST_BEHIND_NS = 300_000_000
"""Until the period of a board with another pace is known, no stamp lies farther behind [ns]."""


class ArrivalClock:
    """Stamps frames that a board sends at an even pace.

    Args:
        period_ns: how far apart they are, nominally; the true period is learned.
    """

    def __init__(self, period_ns: int) -> None:
        self._nominal_ns = period_ns
        self.reset()

    def reset(self) -> None:
        """Forget the board: the next frame is the first."""
        self._period_ns = float(self._nominal_ns)
        self._intervals = NOMINAL_INTERVALS
        self._grid_ns: int | None = None
        self._arrived_ns = 0
        self._delays_ns: deque[int] = deque(maxlen=WINDOW)

    def stamp(self, arrived_ns: int) -> int:
        """Return when a frame was sent [ns]; `arrived_ns` never goes back."""
        if self._grid_ns is None:
            self._grid_ns = arrived_ns
        else:
            unexpected_ns = arrived_ns - self._arrived_ns - self._period_ns
            self._period_ns += unexpected_ns / self._intervals
            self._intervals = min(self._intervals + 1, MOST_INTERVALS)
            self._grid_ns += round(self._period_ns)
        self._arrived_ns = arrived_ns
        self._delays_ns.append(arrived_ns - self._grid_ns)
        return max(self._grid_ns + min(self._delays_ns), arrived_ns - MOST_BEHIND_NS)
