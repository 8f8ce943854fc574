"""Robot time as base keeps it: the one clock that every stamp of this robot counts.

With real hardware it runs with the monotonic clock. A simulation or a recording runs by steps: the
clock never gets farther ahead of what has been reached than one step. After a pause (a stopped
process, a busy machine) the steps that are missing are made up for, none is skipped; where they
cannot be made up for, the rate is lowered, and raised again when there is room.
"""

PATIENCE_NS = 500_000_000
"""The rate is judged once the steps have been late for this long without a break [ns]."""
RAISE_AFTER_NS, RAISE_AGAIN_NS = 10_000_000_000, 2_000_000_000
"""A rate is raised after this long without lateness [ns]: one that was lowered, and one that was
raised just before."""
LOWER_TO, RAISE_BY = 0.95, 1.2
MIN_RATE = 0.01


class RobotClock:
    """The clock of a run of base (a `trolley.runtime.robot_time.TimeSource`)."""

    def __init__(self) -> None:
        """Make a clock that has not begun."""
        self.epoch = 0
        self.rate = 1.0
        self._wanted_rate = 1.0
        self._step_ns: int | None = None
        self._begun = False
        self._anchor_ns = 0
        self._anchor_monotonic_ns = 0
        self._reached_ns = 0
        self._foremost_ns = 0
        self._late: tuple[int, int] | None = None
        self._raise_at_ns = 0

    def begin(
        self, epoch_ns: int, monotonic_ns: int, rate: float = 1.0, step_ns: int | None = None
    ) -> None:
        """Start a run.

        Args:
            epoch_ns: robot time of its beginning.
            monotonic_ns: the local monotonic clock now.
            rate: wanted robot seconds per real second.
            step_ns: how far the clock may be ahead of what was reached; None: it runs freely.
        """
        self.epoch = self._reached_ns = self._foremost_ns = epoch_ns
        self.rate = self._wanted_rate = rate
        self._step_ns = step_ns
        self._set_anchor(epoch_ns, monotonic_ns)
        self._late = None
        self._begun = True

    def now(self, monotonic_ns: int) -> int | None:
        """Robot time [ns] at a local monotonic time; None before the run has begun."""
        if not self._begun:
            return None
        now_ns = self._target_ns(monotonic_ns)
        return now_ns if self._step_ns is None else min(now_ns, self._reached_ns + self._step_ns)

    def foremost(self, monotonic_ns: int) -> int:
        """Return the latest robot time [ns] that others can believe it to be.

        Those who follow the clock cannot know that the steps are late, so they are ahead of `now`
        then, and wait where they are after the rate was lowered.
        """
        return max(self._foremost_ns, self._target_ns(monotonic_ns))

    def reached(self, now_ns: int, monotonic_ns: int) -> bool:
        """Say that everything has been brought to robot time `now_ns`.

        Returns:
            Whether the rate has changed.
        """
        self._reached_ns = now_ns
        if self._step_ns is None:
            return False
        if self._target_ns(monotonic_ns) - now_ns > self._step_ns:
            return self._judge_lateness(now_ns, monotonic_ns)
        self._late = None
        if self.rate < self._wanted_rate and monotonic_ns > self._raise_at_ns:
            return self._change_rate(min(self._wanted_rate, RAISE_BY * self.rate), monotonic_ns)
        return False

    def _judge_lateness(self, now_ns: int, monotonic_ns: int) -> bool:
        if self._late is None:
            self._late = now_ns, monotonic_ns
        late_at_ns, late_since_ns = self._late
        elapsed_ns = monotonic_ns - late_since_ns
        if elapsed_ns < PATIENCE_NS:
            return False
        # While late the steps follow each other without a pause: this is what the machine can do.
        possible = (now_ns - late_at_ns) / elapsed_ns
        self._late = now_ns, monotonic_ns
        if possible >= self.rate:
            return False
        return self._change_rate(max(MIN_RATE, LOWER_TO * possible), monotonic_ns)

    def _change_rate(self, rate: float, monotonic_ns: int) -> bool:
        self._foremost_ns = self.foremost(monotonic_ns)
        self._set_anchor(self._reached_ns, monotonic_ns)
        patience_ns = RAISE_AGAIN_NS if rate > self.rate else RAISE_AFTER_NS
        self._raise_at_ns = monotonic_ns + patience_ns
        self.rate = rate
        self._late = None
        return True

    @property
    def is_slowed(self) -> bool:
        """Whether the wanted rate could not be kept."""
        return self.rate < self._wanted_rate

    def _set_anchor(self, robot_ns: int, monotonic_ns: int) -> None:
        self._anchor_ns, self._anchor_monotonic_ns = robot_ns, monotonic_ns

    def _target_ns(self, monotonic_ns: int) -> int:
        return self._anchor_ns + round(self.rate * (monotonic_ns - self._anchor_monotonic_ns))


class Beat:
    """Says when something periodic is due, by robot time that is handed in."""

    def __init__(self, seconds: float) -> None:
        self._period_ns = round(seconds * 1e9)
        self._next_ns: int | None = None

    def is_due(self, now_ns: int) -> bool:
        """Say whether a period has passed since the last due time; the first time at once."""
        if self._next_ns is not None and now_ns < self._next_ns:
            return False
        since_ns = 0 if self._next_ns is None else now_ns - self._next_ns
        self._next_ns = now_ns - since_ns % self._period_ns + self._period_ns
        return True
