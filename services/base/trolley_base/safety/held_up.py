"""Whether the motor board's reports were held up, so that they prove nothing about the board.

A busy computer, a starved `base` or a line that stalls let a sound board's reports come late, and
then faster than they were made. What is known of when the wheels moved is wrong for that long: the
robot seems to rush, or to go on when it has long stopped. Real faults last, so judging them waits
until reports come at their own pace again. It never waits for long to judge whether a robot that is
told to stand does so.
"""

from collections import deque
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class HeldUpParams:
    """When reports count as held up; set by hand, with `test_held_up.py` as the judge."""

    least_gap_ns: int = 150_000_000
    """A pause between reports that is shorter is no pause: a few periods of base, late [ns]."""
    gap_intervals: float = 3.0
    """So many times the usual interval between reports is a pause."""
    unknown_gap_ns: int = 500_000_000
    """What is a pause before the board's pace is known [ns]."""
    calm_ns: int = 400_000_000
    """Reports must have come at their pace for this long [ns]: what the robot does takes about so
    long to show, and a report that was held up for longer follows a silence, with which the
    drivers begin anew."""
    hurry: float = 1.25
    """So many times the usual number of reports are more than their pace."""
    spare: int = 2
    """Reports by which the number may differ all the same, since they come with base's periods."""
    known_after: int = 8
    """Intervals after which the pace is known."""
    learned: int = 16
    """Intervals of which it is the mean, roughly."""
    longest_ns: int = 3_000_000_000
    """Reports that are held up again and again are judged after this long all the same [ns]."""
    judged_ns: int = 1_500_000_000
    """And then for at least this long, in which a robot that does not stand is found [ns]."""


PARAMS = HeldUpParams()


class HeldUp:
    """Watches when reports arrive."""

    def __init__(self) -> None:
        """Know nothing of the board's pace."""
        self._interval_ns = 0.0
        self._num_learned = 0
        self._last_ns: int | None = None
        self._arrived: deque[tuple[int, int]] = deque()
        self._since_ns: int | None = None
        self._uneven_ns = 0
        self._judged_until_ns: int | None = None

    def proves_little(self, now_ns: int) -> bool:
        """Say whether reports are judged only because they have stalled for so long."""
        return self._judged_until_ns is not None and now_ns < self._judged_until_ns

    def update(self, now_ns: int, count: int) -> bool:
        """Take how many reports have come by now; return whether they prove nothing.

        Args:
            now_ns: robot time of base's period [ns].
            count: since the call before.
        """
        if count:
            self._note(now_ns, count)
        if self._since_ns is None:
            return False
        if now_ns - self._since_ns >= PARAMS.longest_ns:
            self._since_ns = None
            self._judged_until_ns = now_ns + PARAMS.judged_ns
        elif now_ns - self._uneven_ns >= PARAMS.calm_ns and self._last_ns == now_ns:
            self._since_ns = None
        return self._since_ns is not None

    def _note(self, now_ns: int, count: int) -> None:
        last_ns, self._last_ns = self._last_ns, now_ns
        self._arrived.append((now_ns, count))
        while now_ns - self._arrived[0][0] >= PARAMS.calm_ns:
            self._arrived.popleft()
        if last_ns is None:
            return
        gap_ns = now_ns - last_ns
        if gap_ns > self._pause_ns or (self._since_ns is not None and self._is_hurried):
            self._uneven_ns = now_ns
            if self._since_ns is None and now_ns >= (self._judged_until_ns or 0):
                self._since_ns = now_ns
        elif self._since_ns is None:
            self._learn(gap_ns / count)

    @property
    def _pause_ns(self) -> float:
        if self._num_learned < PARAMS.known_after:
            return PARAMS.unknown_gap_ns
        return max(PARAMS.least_gap_ns, PARAMS.gap_intervals * self._interval_ns)

    @property
    def _is_hurried(self) -> bool:
        if self._num_learned < PARAMS.known_after:
            return False
        usual = PARAMS.calm_ns / self._interval_ns
        arrived = sum(count for _, count in self._arrived)
        return arrived > PARAMS.hurry * usual + PARAMS.spare

    def _learn(self, interval_ns: float) -> None:
        self._num_learned = min(self._num_learned + 1, PARAMS.learned)
        self._interval_ns += (interval_ns - self._interval_ns) / self._num_learned
