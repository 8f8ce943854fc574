"""Where everything that arrives waits for the one thread that calls a service's methods."""

import dataclasses
import threading
from collections import deque
from collections.abc import Callable, Hashable

Task = Callable[[int], None]
"""What to do about an arrival; its argument is the local monotonic time of the arrival [ns]."""

MAX_WAITING = 4096


@dataclasses.dataclass(slots=True)
class _Entry:
    task: Task
    arrived_ns: int
    slot: Hashable


class Inbox:
    """A queue that any thread fills and one thread empties, in order of arrival.

    An arrival with a `slot` replaces the one of the same slot that still waits (newest wins).
    """

    def __init__(self, monotonic_ns: Callable[[], int]) -> None:
        self.now_ns = monotonic_ns
        self._queue: deque[_Entry] = deque()
        self._slots: dict[Hashable, _Entry] = {}
        self._condition = threading.Condition()
        self.dropped = 0
        """Arrivals lost because too much was waiting."""
        self.replaced = 0
        """Arrivals overtaken by a newer one of their slot."""

    def push(self, task: Task, slot: Hashable = None, *, urgent: bool = False) -> bool:
        """Add an arrival, in front if `urgent`, and wake the reader. False: no room, dropped."""
        arrived_ns = self.now_ns()
        with self._condition:
            waiting = self._slots.get(slot) if slot is not None else None
            if waiting is not None:
                waiting.task, waiting.arrived_ns = task, arrived_ns
                self.replaced += 1
                return True
            if len(self._queue) >= MAX_WAITING and not urgent:
                self.dropped += 1
                return False
            entry = _Entry(task, arrived_ns, slot)
            if slot is not None:
                self._slots[slot] = entry
            if urgent:
                self._queue.appendleft(entry)
            else:
                self._queue.append(entry)
            self._condition.notify()
            return True

    def pop(self) -> tuple[Task, int] | None:
        """Take the oldest arrival, None if nothing waits."""
        with self._condition:
            if not self._queue:
                return None
            entry = self._queue.popleft()
            if entry.slot is not None:
                del self._slots[entry.slot]
            return entry.task, entry.arrived_ns

    def wait(self, timeout_s: float) -> None:
        """Wait until something arrives, `timeout_s` at most."""
        with self._condition:
            if not self._queue:
                self._condition.wait(timeout_s)

    def wake(self) -> None:
        """End a `wait` early."""
        with self._condition:
            self._condition.notify()

    @property
    def is_empty(self) -> bool:
        """Whether nothing waits."""
        return not self._queue
