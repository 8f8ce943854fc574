"""Receives everything that a robot publishes, and asks for what it published before."""

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from trolley import topics
from trolley.connection import Connection
from trolley.recording.layout import key_of
from trolley.runtime.bus import Closer, Reply, Sample

MAX_WAITING_BYTES = 96 << 20
"""How many bytes may wait for a slow disk: three of the largest maps."""
ASK_TIMEOUT_S = 2.0
OTHERS_ARE_BACK_S = 2.0


class Heard(NamedTuple):
    """A message that arrived."""

    sample: Sample
    arrived_ns: int
    """Local monotonic time."""
    is_latest: bool
    """Whether it was asked for: a latest value, which may be old."""


class Listener:
    """What arrives of a robot, stored on Zenoh's threads until it is taken."""

    def __init__(self, connection: Connection, robot: str) -> None:
        self.lost = 0
        """Messages for which there was no room."""
        self._waiting: deque[Heard] = deque()
        self._bytes = 0
        self._condition = threading.Condition()
        self._ask_at_s = [time.monotonic()]
        self._key = key_of(robot, "**")
        self._clock_key = topics.CLOCK.key(robot)
        self._bus = connection.bus
        self._closer: Closer | None = connection.listen(self._key, self._hear)
        self._bus.on_connection(self._reconnected)

    def take(self, timeout_s: float) -> Heard | None:
        """The oldest arrival, None if nothing arrives in time."""
        self._ask_when_due()
        with self._condition:
            self._condition.wait_for(lambda: bool(self._waiting), timeout_s)
            if not self._waiting:
                return None
            heard = self._waiting.popleft()
            self._bytes -= len(heard.sample.payload)
            return heard

    def await_clock(self, timeout_s: float, is_over: Callable[[], bool]) -> Heard | None:
        """Wait for the robot's clock, and leave it there; None if it does not come in time."""
        end_s = time.monotonic() + timeout_s
        while time.monotonic() < end_s and not is_over():
            self._ask_when_due()
            with self._condition:
                for heard in self._waiting:
                    if heard.sample.key == self._clock_key:
                        return heard
                self._condition.wait(0.05)
        return None

    def close(self) -> None:
        """Stop listening; may be called more than once."""
        if self._closer is not None:
            self._closer.close()
            self._closer = None

    def _ask_when_due(self) -> None:
        if self._ask_at_s and time.monotonic() >= self._ask_at_s[0]:
            self._ask_at_s.pop(0)
            selector = f"{self._key}?format=msgpack"
            self._bus.get(selector, b"", "", ASK_TIMEOUT_S, self._answered, lambda: None)

    def _answered(self, reply: Reply) -> None:
        if not reply.is_error:
            self._store(Sample(reply.key, reply.payload, reply.encoding), is_latest=True)

    def _hear(self, sample: Sample) -> None:
        self._store(sample, is_latest=False)

    def _store(self, sample: Sample, *, is_latest: bool) -> None:
        with self._condition:
            if self._bytes + len(sample.payload) > MAX_WAITING_BYTES:
                self.lost += 1
                return
            self._bytes += len(sample.payload)
            self._waiting.append(Heard(sample, time.monotonic_ns(), is_latest))
            self._condition.notify()

    def _reconnected(self, is_up: bool) -> None:
        # When the others, who look for the router at their own pace, are back as well.
        if is_up:
            self._ask_at_s.append(time.monotonic() + OTHERS_ARE_BACK_S)
