"""Whether `base` itself was held up, as on a computer that is too busy.

The stop field counts on a decision in each period. One that comes late leaves the robot driving by
the last one meanwhile, and a device that was not listened to seems to be silent.
"""

from dataclasses import dataclass

from trolley_base.safety.safety_state import SCAN_SILENCE_NS


@dataclass(frozen=True, slots=True)
class OwnPausesParams:
    """Which pauses matter; set by hand, with `test_braking.py` as the judge."""

    longest_ns: int = 150_000_000
    """The longest time between two decisions that is no pause [ns]."""
    again_ns: int = 5_000_000_000
    """A pause so soon after another is no chance: there will be more [ns]."""
    silent_ns: int = SCAN_SILENCE_NS
    """A pause that is as long counts by itself: devices seem to be silent behind it [ns]."""
    remembered_ns: int = 1_000_000_000
    """Time after the last such pause in which the robot stands [ns]."""


PARAMS = OwnPausesParams()


class OwnPauses:
    """Knows how long `base` was held up lately."""

    def __init__(self) -> None:
        """Nothing was decided yet."""
        self._last_ns: int | None = None
        self._paused_at_ns: int | None = None
        self._counted_at_ns = 0
        self.pause_ns = 0
        """The pause for which the robot must stand, 0 if there was none lately."""

    def note(self, now_ns: int) -> int:
        """Note that it decides now; return `pause_ns`."""
        pause_ns = 0 if self._last_ns is None else now_ns - self._last_ns
        self._last_ns = now_ns
        if now_ns - self._counted_at_ns > PARAMS.remembered_ns:
            self.pause_ns = 0
        if pause_ns > PARAMS.longest_ns:
            before_ns, self._paused_at_ns = self._paused_at_ns, now_ns
            is_again = before_ns is not None and now_ns - before_ns <= PARAMS.again_ns
            if is_again or pause_ns >= PARAMS.silent_ns:
                self.pause_ns, self._counted_at_ns = pause_ns, now_ns
        return self.pause_ns
