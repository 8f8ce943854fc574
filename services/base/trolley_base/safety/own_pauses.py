"""Whether `base` itself was held up, as on a computer that is too busy.

The stop field counts on a decision in each period. One that comes late leaves the robot driving by
the last one meanwhile, and a device that was not listened to seems to be silent.
"""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class OwnPausesParams:
    """Which pauses matter; set by hand, with `test_braking.py` as the judge."""

    longest_ns: int = 150_000_000
    """The longest time between two decisions with which the robot drives [ns]."""
    remembered_ns: int = 1_000_000_000
    """Time after a longer one in which it stands: where there was one, the next is near [ns]."""


PARAMS = OwnPausesParams()


class OwnPauses:
    """Knows how long `base` was held up lately."""

    def __init__(self) -> None:
        """Nothing was decided yet."""
        self._last_ns: int | None = None
        self._pause_ns = self._ended_ns = 0

    def note(self, now_ns: int) -> int:
        """Note that it decides now; return the pause for which the robot must stand, else 0."""
        pause_ns = 0 if self._last_ns is None else now_ns - self._last_ns
        self._last_ns = now_ns
        if pause_ns > PARAMS.longest_ns:
            self._pause_ns, self._ended_ns = pause_ns, now_ns
        elif now_ns - self._ended_ns > PARAMS.remembered_ns:
            self._pause_ns = 0
        return self._pause_ns
