"""The queue between the bus's threads and the one thread that calls a service's methods."""

import threading
from collections import deque
from collections.abc import Callable, Hashable

import msgspec

Task = Callable[[int], None]
"""What to do about an arrival; its argument is the local monotonic time at which it came [ns]."""

MAX_WAITING = 4096
MOST_QUIET = 64
"""Number of arrivals that nobody waits for after which the reader is woken all the same."""
MAX_WAITING_BYTES = 96 << 20
"""How many bytes a flood may hold in memory: three of the largest maps."""


class _Entry(msgspec.Struct):
    task: Task
    arrived_ns: int
    slot: Hashable
    size: int


class Inbox:
    """A queue that any thread fills and one thread empties, in order of arrival, urgent ones first.

    An arrival with a `slot` replaces the one of the same slot that still waits (newest wins).
    """

    def __init__(self, monotonic_ns: Callable[[], int]) -> None:
        self.now_ns = monotonic_ns
        """The local monotonic clock."""
        self.arrived_ns = 0
        """When the entry that was popped last had arrived."""
        self._queue: deque[_Entry] = deque()
        self._urgent: deque[_Entry] = deque()
        self._slots: dict[Hashable, _Entry] = {}
        self._bytes = 0
        self._lock = threading.RLock()  # one thread may take it twice
        self._bell = threading.Lock()  # the reader waits for it to be released
        self._bell.acquire()
        self._is_waiting = False
        self._woken = False
        self.dropped = 0
        """Arrivals lost because too much was waiting."""
        self.replaced = 0
        """Arrivals overtaken by a newer one of their slot."""

    def push(
        self,
        task: Task,
        slot: Hashable = None,
        *,
        urgent: bool = False,
        own: bool = False,
        size: int = 0,
        wakes: bool = True,
    ) -> bool:
        """Add an arrival and wake the reader.

        Args:
            task: What to do about it.
            slot: It replaces the arrival of the same slot that still waits.
            urgent: It goes before everything that is not.
            own: The outcome of something the service itself began; it is never dropped.
            size: The bytes that it holds.
            wakes: Whether to wake the reader; else it is there when the reader wakes next.

        Returns:
            False where there was no room and it was dropped.
        """
        arrived_ns = self.now_ns()
        with self._lock:
            waiting = None if slot is None else self._slots.get(slot)
            if waiting is not None:
                waiting.task, waiting.arrived_ns = task, arrived_ns
                self._bytes += size - waiting.size
                waiting.size = size
                self.replaced += 1
            else:
                queue = self._urgent if urgent else self._queue
                is_heavy = size > 0 and self._bytes > 0 and self._bytes + size > MAX_WAITING_BYTES
                if not own and (is_heavy or len(queue) >= MAX_WAITING):
                    self.dropped += 1
                    return False
                entry = _Entry(task, arrived_ns, slot, size)
                if slot is not None:
                    self._slots[slot] = entry
                self._bytes += size
                queue.append(entry)
                wakes = wakes or len(queue) >= MOST_QUIET
            if wakes:
                self._ring()
            return True

    def pop(self) -> tuple[Task, int] | None:
        """Take the oldest arrival, urgent ones first; None if nothing waits."""
        with self._lock:
            queue = self._urgent or self._queue
            if not queue:
                return None
            entry = queue.popleft()
            self._bytes -= entry.size
            if entry.slot is not None:
                del self._slots[entry.slot]
            self.arrived_ns = entry.arrived_ns
            return entry.task, entry.arrived_ns

    def wait(self, timeout_s: float) -> None:
        """Wait until something arrives or `wake` is called, `timeout_s` at most."""
        with self._lock:
            if self._queue or self._urgent or self._woken:
                self._woken = False
                return
            self._is_waiting = True
        self._bell.acquire(timeout=timeout_s)
        with self._lock:
            self._is_waiting = self._woken = False
            self._bell.acquire(blocking=False)  # it may have rung just after the time was up

    def wake(self) -> None:
        """End the present `wait`, or the next one, early (also from a signal handler)."""
        with self._lock:
            self._woken = True
            self._ring()

    @property
    def is_empty(self) -> bool:
        """Whether nothing waits."""
        return not self._queue and not self._urgent

    def _ring(self) -> None:
        """End the present `wait`; a condition of `threading` would do more each time."""
        if self._is_waiting:
            self._is_waiting = False
            if self._bell.locked():
                self._bell.release()
