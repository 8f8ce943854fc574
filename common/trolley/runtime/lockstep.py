"""The lock-step runtime: any services in one process on an in-memory bus, in simulated time.

One robot, or several on the same bus. Time starts at 0 and advances to the next thing due once
everybody has answered, so thousands of simulated seconds pass as fast as they can be computed, and
the same seed gives the same bytes.
"""

import functools
import os
import random
import tempfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from trolley.codes import Refused
from trolley.messages.request_params import Nothing
from trolley.requests import Request
from trolley.runtime import codec
from trolley.runtime.bus import Query, Reply, Sample, matches
from trolley.runtime.log import Log
from trolley.runtime.node import Node
from trolley.runtime.replies import outcome
from trolley.runtime.service import Service
from trolley.runtime.state import StateFolder
from trolley.topics import Qos, Topic

M = TypeVar("M", bound=msgspec.Struct)
S = TypeVar("S", bound=Service)
P = TypeVar("P", bound=msgspec.Struct)
R = TypeVar("R")

ID_CHARACTERS = "abcdefghijklmnopqrstuvwxyz0123456789"
MAX_ROUNDS = 1000
MAX_ROUTES = 1 << 14
_MEMORY = Path("/dev/shm")
"""A folder in memory: what is saved in simulated time need not wait for a disk."""

_matches = functools.lru_cache(maxsize=1 << 14)(matches)  # the same keys all the time


class _Declared:
    """A subscription or queryable of the memory bus."""

    def __init__(
        self,
        key_expr: str,
        callback: Callable[[Any], None],
        owner: "list[_Declared]",
        routes: "dict[str, tuple[_Declared, ...]]",
    ) -> None:
        self.key_expr = key_expr
        self.callback = callback
        self._owner = owner
        self._routes = routes

    def close(self) -> None:
        """Take it back."""
        if self in self._owner:
            self._owner.remove(self)
            self._routes.clear()


class _MemoryQuery:
    """A get that waits for its answers; the last of those asked ends it."""

    def __init__(
        self, selector: str, payload: bytes, encoding: str, on_reply: Callable[[Reply], None]
    ) -> None:
        self.key, _, self.parameters = selector.partition("?")
        self.payload = payload
        self.encoding = encoding
        self.waiting = 0
        self.on_reply = on_reply
        self.on_done: Callable[[], None] = lambda: None

    def reply(self, key: str, payload: bytes, encoding: str) -> None:
        if not _matches(self.key, key):  # Zenoh refuses it, too
            raise ValueError(f"{key} is no answer to {self.key}")
        self.on_reply(Reply(key, payload, encoding))

    def refuse(self, payload: bytes, encoding: str) -> None:
        self.on_reply(Reply(self.key, payload, encoding, is_error=True))

    def finish(self) -> None:
        self.waiting -= 1
        if self.waiting == 0:
            self.on_done()


class _Newest:
    """The newest of a key of the memory bus."""

    def __init__(self, bus: "MemoryBus", key: str) -> None:
        self._payload: bytes | None = None
        self._declared = bus.subscribe(key, self._hear)

    def _hear(self, sample: Sample) -> None:
        self._payload = sample.payload

    def take(self) -> bytes | None:
        payload, self._payload = self._payload, None
        return payload

    def close(self) -> None:
        self._declared.close()


class MemoryBus:
    """A bus in one process; everything is delivered at once and in order of declaration."""

    def __init__(self) -> None:
        self._subscribers: list[_Declared] = []
        self._queryables: list[_Declared] = []
        self._routes: dict[str, tuple[_Declared, ...]] = {}  # who gets a key, while nobody comes

    def put(self, key: str, payload: bytes, encoding: str, qos: Qos) -> None:
        """Publish."""
        del qos  # nothing is ever congested here
        self._deliver(Sample(key, payload, encoding))

    def is_heard(self, key: str, encoding: str) -> bool:
        """Everything is made, so that the bytes do not depend on who listens."""
        del key, encoding
        return True

    def delete(self, key: str) -> None:
        """Publish a deletion."""
        self._deliver(Sample(key, b"", "", is_delete=True))

    def subscribe(self, key_expr: str, callback: Callable[[Sample], None]) -> _Declared:
        """Call back for each put and delete that matches."""
        declared = _Declared(key_expr, callback, self._subscribers, self._routes)
        self._subscribers.append(declared)
        self._routes.clear()
        return declared

    def newest(self, key: str) -> _Newest:
        """Keep the newest of what anybody puts to a key, one's own puts too."""
        return _Newest(self, key)

    def serve(self, key_expr: str, callback: Callable[[Query], None]) -> _Declared:
        """Call back for each get that matches."""
        declared = _Declared(key_expr, callback, self._queryables, self._routes)
        self._queryables.append(declared)
        return declared

    def get(
        self,
        selector: str,
        payload: bytes,
        encoding: str,
        timeout_s: float,
        on_reply: Callable[[Reply], None],
        on_done: Callable[[], None],
    ) -> None:
        """Ask everybody who serves the key."""
        del timeout_s  # who asks keeps its own deadline
        query = _MemoryQuery(selector, payload, encoding, on_reply)
        asked = [one for one in self._queryables if _matches(one.key_expr, query.key)]
        query.waiting, query.on_done = len(asked), on_done
        for one in asked:
            one.callback(query)
        if not asked:
            on_done()

    def _deliver(self, sample: Sample) -> None:
        routed = self._routes.get(sample.key)
        if routed is None:
            if len(self._routes) >= MAX_ROUTES:
                self._routes.clear()
            routed = tuple(one for one in self._subscribers if _matches(one.key_expr, sample.key))
            self._routes[sample.key] = routed
        for one in routed:
            one.callback(sample)


class _LockstepHost:
    """Simulated time, seeded ids, work done at once."""

    def __init__(self, runtime: "Lockstep", seed: int, robot: str) -> None:
        self._runtime = runtime
        self._random = random.Random(seed)
        log = Log("state")
        self.state = StateFolder(runtime.state / robot, log)
        self.maps = StateFolder(runtime.state / "maps", log)

    def monotonic_ns(self) -> int:
        return self._runtime.now_ns

    def since_boot_ns(self) -> int:
        return self._runtime.now_ns + self._runtime.slept_ns

    def unix_ns(self) -> int:
        return self._runtime.now_ns + self._runtime.slept_ns

    def utc_now(self) -> str | None:
        return None

    def new_id(self) -> str:
        return "".join(self._random.choices(ID_CHARACTERS, k=12))

    def work(self, fn: Callable[[], Any], done: Callable[[Any], None]) -> None:
        done(fn())

    def usage(self) -> tuple[float, int]:
        return 0.0, 0


class Lockstep:
    """Services run together in simulated time.

    Args:
        robot: The robot's name in every key where no other is given.
        seed: What all ids come from.
        state: The state folder; a fresh temporary one if not given.
    """

    def __init__(self, robot: str = "trolley", seed: int = 0, state: Path | None = None) -> None:
        self.robot = robot
        self.now_ns = 0
        self.slept_ns = 0
        """For how long the computer has slept: the monotonic clock stood still meanwhile."""
        self.bus = MemoryBus()
        self.nodes: dict[str, Node] = {}
        self._seed = seed
        self._num_added = 0
        where = _MEMORY if os.access(_MEMORY, os.W_OK) else None
        self._folder = (
            tempfile.TemporaryDirectory(prefix="trolley-", dir=where) if state is None else None
        )
        self.state = Path(self._folder.name) if self._folder is not None else state or Path()

    @property
    def now_s(self) -> float:
        """Simulated seconds since the start."""
        return self.now_ns * 1e-9

    def add(self, service: S, robot: str | None = None) -> S:
        """Start a service now; that of another robot stands in `nodes` as `<robot>/<service>`."""
        name = self.robot if robot is None else robot
        seed = _service_seed(self._seed, service.name, self._num_added)
        self._num_added += 1  # a restarted service must not give its old ids again
        node = Node(service, name, self.bus, _LockstepHost(self, seed, name))
        self.nodes[service.name if name == self.robot else f"{name}/{service.name}"] = node
        node.open()
        self._settle()
        return service

    def kill(self, name: str) -> None:
        """Remove a service as SIGKILL would: without calling `stop`."""
        node = self.nodes.pop(name)
        node.silence()

    def run(self, seconds: float) -> None:
        """Let `seconds` of simulated time pass."""
        self.run_until(lambda: False, seconds)

    def run_until(self, happened: Callable[[], bool], seconds: float) -> bool:
        """Let time pass until `happened()`, `seconds` at most; True if it happened."""
        end_ns = self.now_ns + int(seconds * 1e9)
        self._settle()
        while not happened():
            due_ns = min((node.next_due_ns() for node in self.nodes.values()), default=end_ns)
            self.now_ns = min(max(due_ns, self.now_ns + 1), end_ns)
            self._settle()
            if self.now_ns >= end_ns:
                return happened()
        return True

    def publish(self, topic: Topic[M], message: M, *parts: str, robot: str | None = None) -> None:
        """Put a message on the bus, as a program outside would."""
        key = topic.key(robot or self.robot, *parts)
        self.put(key, codec.encode(message, "msgpack"), codec.MIME["msgpack"])

    def put(self, key: str, payload: bytes, encoding: str = "") -> None:
        """Put raw bytes on the bus and let everybody react."""
        self.bus.put(key, payload, encoding, Qos.STATE)
        self._settle()

    def delete(self, key: str) -> None:
        """Delete a key on the bus."""
        self.bus.delete(key)
        self._settle()

    def record(self, topic: Topic[M], *parts: str, robot: str | None = None) -> list[M]:
        """A list that grows by every message of the topic published from now on."""
        messages: list[M] = []

        def take(sample: Sample) -> None:
            if not sample.is_delete:
                messages.append(codec.decode(topic.message, sample.payload, sample.encoding))

        self.bus.subscribe(topic.key(robot or self.robot, *parts), take)
        return messages

    def get(
        self, selector: str, payload: bytes = b"", encoding: str = "", seconds: float = 2.0
    ) -> list[Reply]:
        """Ask on the bus and let time pass until all answers are in."""
        replies: list[Reply] = []
        done: list[bool] = []
        self.bus.get(
            selector, payload, encoding, seconds, replies.append, lambda: done.append(True)
        )
        self.run_until(lambda: bool(done), seconds)
        return replies

    def ask(
        self,
        request: Request[P, R],
        params: P | None = None,
        seconds: float = 2.0,
        robot: str | None = None,
    ) -> R:
        """Ask a service and return its reply.

        Raises:
            Refused: It refused, or nobody answered.
        """
        payload = codec.encode(Nothing() if params is None else params, "msgpack")
        replies = self.get(
            request.key(robot or self.robot), payload, codec.MIME["msgpack"], seconds
        )
        result = outcome(request, replies, timed_out=False)
        if isinstance(result, Refused):
            raise result
        return result  # outcome decoded it as request.reply

    def counters(self, name: str) -> dict[str, int]:
        """The counters of a service."""
        return self.nodes[name].counters

    def close(self) -> None:
        """Stop all services and remove the temporary state."""
        for node in reversed(self.nodes.values()):
            node.close()
        self.nodes.clear()
        if self._folder is not None:
            self._folder.cleanup()

    def __enter__(self) -> "Lockstep":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _settle(self) -> None:
        for _ in range(MAX_ROUNDS):
            busy = [node.step() for node in tuple(self.nodes.values())]  # all, not up to the first
            if not any(busy):
                return
        raise RuntimeError(
            f"services kept answering each other for {MAX_ROUNDS} rounds without time passing"
        )


def _service_seed(seed: int, name: str, index: int) -> int:
    """A seed for one service, the same in every run."""
    return zlib.crc32(f"{seed}/{name}/{index}".encode())
