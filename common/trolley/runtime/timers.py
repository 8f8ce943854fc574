"""Periods and deadlines of a node, on robot time or on the local monotonic clock."""

import dataclasses
import heapq
from collections.abc import Callable

from trolley.runtime.robot_time import FollowedTime, TimeSource

_LONGEST_NS = 1_000_000_000
_SHORTEST_NS = 500_000


@dataclasses.dataclass
class _Period:
    period_ns: int
    is_local: bool
    call: Callable[[], None]
    is_wanted: Callable[[], bool]
    next_ns: int | None = None


class Deadline:
    """A call that is postponed repeatedly, or given up."""

    def __init__(
        self, now_ns: Callable[[], int], call: Callable[[], None], is_set: Callable[[int], None]
    ) -> None:
        self._now_ns = now_ns
        self._call = call
        self._is_set = is_set
        self.due_ns: int | None = None
        """Local time at which to call, None if not at all."""
        self._was_due_ns = 0
        """Local time at which it was to be called when it was called last."""

    def set(self, seconds: float) -> None:
        """Call in `seconds` of local time, and not when it was to be called before."""
        self.due_ns = self._now_ns() + round(seconds * 1e9)
        self._is_set(self.due_ns)

    def repeat(self, seconds: float) -> None:
        """Call as many `seconds` after it was due last, as a period does: missed ones are skipped.

        Called from what it calls, it does so again and again.
        """
        period_ns, now_ns = round(seconds * 1e9), self._now_ns()
        missed = (now_ns - self._was_due_ns) // period_ns
        self.due_ns = self._was_due_ns + (missed + 1) * period_ns
        self._is_set(self.due_ns)

    def clear(self) -> None:
        """Do not call."""
        self.due_ns = None

    def run(self, now_ns: int) -> bool:
        """Call, if it is due; returns whether it was."""
        if self.due_ns is None or self.due_ns > now_ns:
            return False
        self._was_due_ns, self.due_ns = self.due_ns, None
        self._call()
        return True


class Timers:
    """What is due when. Missed periods are skipped; robot periods rest without robot time."""

    def __init__(self) -> None:
        self._periods: list[_Period] = []
        self._deadlines: list[tuple[int, int, Callable[[], None]]] = []
        self._movable: list[Deadline] = []
        self._count = 0
        self._quiet_until_ns = 0
        """Local time before which nothing is due, unless something is added or a clock moves."""

    def every(
        self,
        seconds: float,
        call: Callable[[], None],
        *,
        is_local: bool,
        when: Callable[[], bool] = lambda: True,
    ) -> None:
        """Call at a period, first as soon as its clock runs; nothing is due while not `when()`."""
        self._periods.append(_Period(int(seconds * 1e9), is_local, call, when))
        self.look_again()

    def at(self, monotonic_ns: int, call: Callable[[], None]) -> None:
        """Call once at a local time."""
        self._count += 1
        heapq.heappush(self._deadlines, (monotonic_ns, self._count, call))
        self._is_set(monotonic_ns)

    def deadline(self, now_ns: Callable[[], int], call: Callable[[], None]) -> Deadline:
        """Return a deadline that is set and cleared, by this local clock."""
        self._movable.append(Deadline(now_ns, call, self._is_set))
        return self._movable[-1]

    def look_again(self) -> None:
        """Note that robot time may have changed otherwise than by going on."""
        self._quiet_until_ns = 0

    def _is_set(self, due_ns: int) -> None:
        self._quiet_until_ns = min(self._quiet_until_ns, due_ns)

    def run(self, monotonic_ns: Callable[[], int], time: TimeSource) -> bool:
        """Call what is due; True if anything was."""
        if monotonic_ns() < self._quiet_until_ns:
            return False
        self._quiet_until_ns = 0
        did = False
        while self._deadlines and self._deadlines[0][0] <= monotonic_ns():
            heapq.heappop(self._deadlines)[2]()
            did = True
        local_ns = monotonic_ns()
        for deadline in self._movable:
            did |= deadline.run(local_ns)
        robot_ns = time.now(local_ns)
        for period in self._periods:
            clock = local_ns if period.is_local else robot_ns
            if clock is None:
                period.next_ns = None
                continue
            if period.next_ns is None or period.next_ns > clock + period.period_ns:
                period.next_ns = clock
            if period.next_ns <= clock:
                missed = (clock - period.next_ns) // period.period_ns
                period.next_ns += (missed + 1) * period.period_ns
                if period.is_wanted():
                    period.call()
                    did = True
        return did

    def next_due_ns(self, monotonic_ns: int, time: TimeSource) -> int:
        """Local time at which to look again, a second ahead at most."""
        due = monotonic_ns + _LONGEST_NS
        if self._deadlines:
            due = min(due, self._deadlines[0][0])
        for deadline in self._movable:
            if deadline.due_ns is not None:
                due = min(due, deadline.due_ns)
        robot_ns = time.now(monotonic_ns)
        for period in self._periods:
            if not period.is_wanted():
                continue
            if period.is_local:
                due = min(due, period.next_ns or monotonic_ns)
            elif robot_ns is not None:
                left_ns = (period.next_ns or robot_ns) - robot_ns
                # Rounded up, and no busy wait while a simulated clock stands between two steps.
                wait_ns = -int(-left_ns // time.rate) if left_ns > 0 else _SHORTEST_NS
                due = min(due, monotonic_ns + wait_ns)
        if isinstance(time, FollowedTime):  # base's own moves at any moment
            self._quiet_until_ns = min(due, time.even_until_ns(monotonic_ns))
        return due
