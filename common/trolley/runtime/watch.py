"""What a service holds in hand: what is known of a topic, and an answer that is still to come."""

from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

import msgspec

from trolley.codes import Refused
from trolley.topics import Topic

M = TypeVar("M", bound=msgspec.Struct)
R = TypeVar("R")


class Watch(Generic[M]):
    """What is known of a topic: the latest message of each key, and the last seconds if asked."""

    def __init__(self, topic: Topic[M], seconds: float) -> None:
        self.topic = topic
        self.latest: M | None = None
        """The newest message of all keys."""
        self.arrived_ns: int | None = None
        """Local monotonic time of its arrival."""
        self.by_parts: dict[tuple[str, ...], M] = {}
        """The newest message per varying chunks (the robot first where all are watched)."""
        self.history: deque[M] = deque()
        """The messages of the last `seconds`, oldest first; empty unless asked for."""
        self._seconds = seconds
        self._arrivals: deque[int] = deque()

    @property
    def keeps_history(self) -> bool:
        """Whether every message counts, not just the newest."""
        return self._seconds > 0.0

    def take(self, message: M, parts: tuple[str, ...], arrived_ns: int) -> None:
        """Store a message (called by the runtime)."""
        self.latest = message
        self.arrived_ns = arrived_ns
        self.by_parts[parts] = message
        if self._seconds > 0.0:
            self.history.append(message)
            self._arrivals.append(arrived_ns)
            while arrived_ns - self._arrivals[0] > self._seconds * 1e9:
                self.history.popleft()
                self._arrivals.popleft()

    def forget(self) -> None:
        """Drop everything known, as at a new epoch."""
        self.latest, self.arrived_ns = None, None
        self.by_parts.clear()
        self.history.clear()
        self._arrivals.clear()


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
