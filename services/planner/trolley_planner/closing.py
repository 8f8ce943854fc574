"""Notices what comes towards the robot faster than the robot goes itself."""

from collections import deque

SIGHT_M = 1.2
"""Nearer things are watched."""
EXCESS_MPS = 0.25
"""Nearing faster than the robot's own motion explains by this: it moves."""
HORIZON_S = 1.2
"""Who would be here within this time is waited for."""
HOLD_S = 0.5
"""The robot stands for so long since the last scan that shows it."""


class ClosingWatch:
    """Compares the clearance of three scans in a row.

    A costmap takes everything for standing. Who walks towards the robot needs it to brake before
    the distance alone would say so: whoever stands cannot run into anybody.
    """

    def __init__(self) -> None:
        self._seen: deque[tuple[int, float]] = deque(maxlen=3)
        self._hold_until_ns = 0

    def note(self, stamp_ns: int, clearance_m: float, own_mps: float) -> None:
        """Take the clearance [m] by a new scan, at most `SIGHT_M`.

        Args:
            stamp_ns: robot time.
            clearance_m: of the footprint where the robot is.
            own_mps: how fast its edge moves by itself.
        """
        if self._seen and stamp_ns - self._seen[-1][0] > HOLD_S * 1e9:
            self._seen.clear()
        if self._seen and stamp_ns <= self._seen[-1][0]:
            return
        self._seen.append((stamp_ns, clearance_m))
        if len(self._seen) < 3 or clearance_m >= SIGHT_M:
            return
        (first_ns, first_m), (second_ns, second_m), _ = self._seen
        rates = (
            (first_m - second_m) / ((second_ns - first_ns) * 1e-9),
            (second_m - clearance_m) / ((stamp_ns - second_ns) * 1e-9),
        )
        # Both steps: a thing that comes into sight round a corner is not one that moves.
        if min(rates) > own_mps + EXCESS_MPS and clearance_m < HORIZON_S * sum(rates) / 2.0:
            self._hold_until_ns = stamp_ns + round(HOLD_S * 1e9)

    def must_stand(self, now_ns: int) -> bool:
        """Say whether the robot had better stand."""
        return now_ns < self._hold_until_ns
