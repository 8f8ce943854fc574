"""When a board sent what arrived: a steady clock behind arrivals that are late by chance.

A board without stamps reports at its own even pace; serial drivers, threads and a busy host delay
its frames, never the other way round. So the clock runs on by one period per frame, is set back at
once when a frame arrives before it was due, and follows late frames slowly: frames that were held
up and come together get the times at which they were sent. Since no stamp is later than its
arrival, and none falls far behind, the sum of all intervals is the time that really passed.
"""

# Share of a frame's lateness by which the clock follows it.
FOLLOW = 1 / 8
# Share of an interval between two arrivals by which the period follows it.
LEARN = 1 / 64
# No stamp is older than this behind its arrival [ns]: frames were lost, not late.
MOST_LATE_NS = 150_000_000


class ArrivalClock:
    """Stamps frames that a board sends at an even pace.

    Args:
        period_ns: how far apart they are, nominally; the true period is learned.
    """

    def __init__(self, period_ns: int) -> None:
        self._nominal_ns = period_ns
        self._period_ns = float(period_ns)
        self._stamp_ns: int | None = None
        self._arrived_ns = 0

    def reset(self) -> None:
        """Forget the board: the next frame is the first."""
        self._period_ns = float(self._nominal_ns)
        self._stamp_ns = None

    def stamp(self, arrived_ns: int) -> int:
        """Return when a frame was sent [ns]: not after `arrived_ns`, which never goes back."""
        if self._stamp_ns is None:
            self._stamp_ns = arrived_ns
        else:
            self._period_ns += LEARN * (arrived_ns - self._arrived_ns - self._period_ns)
            due_ns = self._stamp_ns + round(self._period_ns)
            late_ns = arrived_ns - due_ns
            following_ns = due_ns + round(FOLLOW * late_ns) if late_ns > 0 else arrived_ns
            self._stamp_ns = max(following_ns, arrived_ns - MOST_LATE_NS)
        self._arrived_ns = arrived_ns
        return self._stamp_ns
