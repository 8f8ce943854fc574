"""What a service holds: what is known of a topic, and an answer that is still to come."""

from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

import msgspec

from trolley.codes import Refused
from trolley.topics import Topic

M = TypeVar("M", bound=msgspec.Struct)
R = TypeVar("R")


MAX_HISTORY = 5000


class Watch(Generic[M]):
    """What is known of a topic: the latest message of each key, and the last seconds if asked."""

    def __init__(self, topic: Topic[M], seconds: float) -> None:
        self.topic = topic
        self.latest: M | None = None
        """The newest message of all keys."""
        self.arrived_ns: int | None = None
        """Local monotonic time of its arrival."""
        self.count = 0
        """How many messages arrived so far."""
        self.by_parts: dict[tuple[str, ...], M] = {}
        """The newest message per varying chunks (the robot first where all are watched)."""
        self.history: deque[M] = deque(maxlen=MAX_HISTORY)
        """The messages of the last `seconds`, oldest first; empty unless asked for."""
        self.is_full = False
        """Whether messages were refused since something was last forgotten: there is too much."""
        self._seconds = seconds
        self._arrivals: dict[tuple[str, ...], int] = {}
        self._sizes: dict[tuple[str, ...], int] = {}
        self._num_bytes = 0
        self._marks: deque[tuple[int, tuple[str, ...]]] = deque(maxlen=MAX_HISTORY)

    @property
    def keeps_history(self) -> bool:
        """Whether every message counts, not just the newest."""
        return self._seconds > 0.0

    def arrived(self, parts: tuple[str, ...]) -> int | None:
        """Local monotonic time [ns] at which the newest message of a key arrived."""
        return self._arrivals.get(parts)

    def take(self, message: M, parts: tuple[str, ...], arrived_ns: int, num_bytes: int) -> bool:
        """Store a message (called by the runtime); False: too much is kept already."""
        all_bytes = self._num_bytes - self._sizes.get(parts, 0) + num_bytes
        is_new = parts not in self.by_parts
        if (is_new and len(self.by_parts) >= self.topic.max_keys) or (
            all_bytes > self.topic.max_kept_bytes
        ):
            self.is_full = True
            return False
        self._sizes[parts], self._num_bytes = num_bytes, all_bytes
        self.count += 1
        self.latest = message
        self.arrived_ns = arrived_ns
        self.by_parts[parts] = message
        self._arrivals[parts] = arrived_ns
        if self._seconds > 0.0:
            self.history.append(message)
            self._marks.append((arrived_ns, parts))
            while arrived_ns - self._marks[0][0] > self._seconds * 1e9:
                self.history.popleft()
                self._marks.popleft()
        return True

    def forget(self, is_gone: Callable[[tuple[str, ...], M], bool]) -> None:
        """Drop what `is_gone(varying_chunks, message)` says of (called by the runtime)."""
        for parts in [parts for parts, message in self.by_parts.items() if is_gone(parts, message)]:
            del self.by_parts[parts], self._arrivals[parts]
            self._num_bytes -= self._sizes.pop(parts)
            self.is_full = False
        kept = [
            (message, mark)
            for message, mark in zip(self.history, self._marks, strict=True)
            if not is_gone(mark[1], message)
        ]
        self.history.clear()
        self.history.extend(message for message, _ in kept)
        self._marks.clear()
        self._marks.extend(mark for _, mark in kept)
        newest = max(self._arrivals, key=self._arrivals.__getitem__, default=None)
        self.latest = None if newest is None else self.by_parts[newest]
        self.arrived_ns = None if newest is None else self._arrivals[newest]


class Later(Generic[R]):
    """An answer that is still to come: call `reply` or `refuse` once, within 2 s."""

    def __init__(self) -> None:
        self._done: Callable[[R | Refused], None] | None = None
        self._result: R | Refused | None = None

    @property
    def is_open(self) -> bool:
        """Whether it still waits for its answer."""
        return self._result is None

    def reply(self, value: R) -> None:
        """Answer."""
        self._settle(value)

    def refuse(self, refusal: Refused) -> None:
        """Refuse."""
        self._settle(refusal)

    def on_settled(self, done: Callable[[R | Refused], None]) -> None:
        """Call `done` with the answer, at once if it is there (called by the runtime)."""
        self._done = done
        if self._result is not None:
            done(self._result)

    def _settle(self, result: R | Refused) -> None:
        if self._result is None:
            self._result = result
            if self._done is not None:
                self._done(result)
