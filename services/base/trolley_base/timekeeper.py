"""Robot time for everybody: published, and saved so that it never goes back."""

from trolley import topics
from trolley.messages import Clock
from trolley.runtime.service import Service, every
from trolley_base.persistence import LATEST_NS, TIME_FILE, SavedTime, first_stamp_ns
from trolley_base.robot_clock import Beat, RobotClock

CLOCK_S = 0.1
"""Period of `clock`."""
SLEPT_NS = 15_000_000_000
"""Who did not run for so long may have slept; `trolley up` ends a service that is silent longer."""
SAVE_TIME_S = 60.0
"""Period at which robot time is saved; half of what a run begins later than the saved value."""


class Timekeeper:
    """Owns robot time on behalf of base."""

    def __init__(self, service: Service) -> None:
        self._service = service
        self.clock = RobotClock()
        self._save_beat = Beat(SAVE_TIME_S)
        self._awake_ns = 0

    def next_epoch_ns(self) -> int:
        """Return the robot time at which this run begins."""
        service = self._service
        return first_stamp_ns(service.unix_ns, service.state.read(TIME_FILE, SavedTime))

    def begin(self, epoch_ns: int, rate: float, step_ns: int | None) -> None:
        """Start the clock; the arguments are those of `RobotClock.begin`."""
        self.clock.begin(epoch_ns, self._service.monotonic_ns, rate, step_ns)
        self._awake_ns = self._service.since_boot_ns

    def has_slept(self) -> bool:
        """Whether this computer has slept since this was asked last; says so."""
        before_ns, self._awake_ns = self._awake_ns, self._service.since_boot_ns
        slept_ns = self._awake_ns - before_ns
        if slept_ns <= SLEPT_NS:
            return False
        self._service.log.warning(
            "This computer slept or was held up: base begins anew, and nothing drives on by itself",
            seconds=round(slept_ns * 1e-9),
        )
        return True

    def robot_ns(self, monotonic_ns: int) -> int:
        """Return robot time at a local monotonic time; 0 before the run has begun."""
        return self.clock.now(monotonic_ns) or 0

    def finish_period(self, now_ns: int) -> None:
        """Note that everything has been brought to `now_ns`."""
        if self._save_beat.is_due(now_ns):
            self.save(now_ns)
        if self.clock.reached(now_ns, self._service.monotonic_ns):
            self.publish_clock()

    def save(self, now_ns: int) -> None:
        """Save robot time."""
        self._service.save(TIME_FILE, SavedTime(stamp_ns=min(now_ns, LATEST_NS)))

    @every(CLOCK_S, clock="local")
    def publish_clock(self) -> None:
        """Publish robot time, for everybody to follow."""
        clock = Clock(stamp_ns=self._service.stamp_ns, rate=self.clock.rate, epoch=self.clock.epoch)
        self._service.publish(topics.CLOCK, clock)
