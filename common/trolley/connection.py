"""A program's connection to the robots of a network: ask, get, subscribe, each with a time limit.

Scripts want `trolley.Robot`; this is the layer below it, which the command line shares.
"""

import dataclasses
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, Generic, Self, TypeVar
from urllib.parse import quote

import msgspec

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.config import ConfigError, RobotConfig, find_config, load_host_config
from trolley.config.robot import why_no_endpoint
from trolley.messages import BaseState, Clock
from trolley.ports import ROUTER_PORT
from trolley.requests import Request
from trolley.runtime import codec
from trolley.runtime.bus import Closer, Reply, Sample, has_wildcard
from trolley.runtime.clock_follower import ANSWER_S, told
from trolley.runtime.endpoints import is_far
from trolley.runtime.replies import outcome
from trolley.runtime.robot_time import FollowedTime
from trolley.runtime.zenoh_bus import (
    FORKED,
    NotConnected,
    ZenohBus,
    ZenohError,
    is_forked,
    open_bus,
)
from trolley.security.host_keys import DEFAULT_FOLDER, HostKeys, KeysError, keys_for
from trolley.suggestions import did_you_mean
from trolley.topics import Topic

M = TypeVar("M", bound=msgspec.Struct)
P = TypeVar("P", bound=msgspec.Struct)
R = TypeVar("R")

DEFAULT_ENDPOINT = f"tcp/127.0.0.1:{ROUTER_PORT}"
CONNECT_TIMEOUT_S = 3.0
ASK_TIMEOUT_S = 2.5
"""Requests are answered within 2 s."""
GET_TIMEOUT_S = 2.0
MOST_WAITING = 1000
MOST_WAITING_BYTES = 64 << 20
"""What a subscription keeps that nobody reads: so many messages, and so many bytes of them."""
TOKENS_S = (1.0, 10.0)
"""How long the router may take to say who is there, and when it is asked once more."""
CLOCK_PATIENCE_S = 1.0
SLICE_S = 0.2
"""How long a message, or the lock to take one in, is waited for at a time."""


class RobotUnreachable(Exception):
    """There is no router, no such robot, or it fell silent; the text says which and what to do."""


class Closed(RobotUnreachable):
    """It was closed; perhaps by another thread, or a signal, while something waited."""

    def __init__(self) -> None:
        super().__init__("this connection to the robot is closed; make a new one")


class RouterBusy(RobotUnreachable):
    """The router does not say in time who is there, so nobody can tell whether a robot is."""


class SeveralRobots(Exception):
    """Several robots are on the network and none was named; `names` lists them."""

    def __init__(self, names: Sequence[str]) -> None:
        self.names = list(names)
        super().__init__(f"several robots are on the network; name one of them: {', '.join(names)}")


class Arrival(msgspec.Struct, Generic[M], frozen=True):
    """A message of a subscription."""

    robot: str
    parts: tuple[str, ...]
    """The chunks of its key that vary."""
    message: M
    size: int
    """Bytes on the wire."""
    arrived_s: float
    """Local monotonic time."""


class Subscription(Generic[M]):
    """Messages as they arrive, oldest first; a context manager.

    Where nobody reads them, the oldest are dropped.
    """

    def __init__(self, topic: Topic[M], most_waiting: int = MOST_WAITING) -> None:
        self.invalid = 0
        """Messages that were not understood."""
        self.is_closed = False
        """Whether nothing more will come."""
        self._topic = topic
        self._most_waiting = most_waiting
        self._waiting: deque[Arrival[M]] = deque()
        self._waiting_bytes = 0
        self._heard: set[str] = set()
        self._condition = threading.Condition()
        self._closer: Closer | None = None

    def open(self, bus: ZenohBus, key: str) -> None:
        """Begin to listen (called by `Connection`)."""
        self._closer = bus.subscribe(key, self._take)

    def add_latest(self, reply: Reply) -> None:
        """Add a latest value that was read after subscribing, unless something newer came."""
        with self._condition:
            if not reply.is_error and reply.key not in self._heard:
                self._store(reply.key, reply.payload, reply.encoding)

    def next(self, timeout_s: float | None = None) -> Arrival[M] | None:
        """The next message, None if none comes in time, or none any more: see `is_closed`.

        Raises:
            RobotUnreachable: This process was forked from the one that listens.
        """
        if is_forked():
            raise RobotUnreachable(FORKED)
        end_s = math.inf if timeout_s is None else time.monotonic() + timeout_s
        with self._condition:
            while not self._waiting and not self.is_closed:
                left_s = end_s - time.monotonic()
                if left_s <= 0.0:
                    break
                # In slices: a signal that closes it just before it waits wakes nobody.
                self._condition.wait(min(left_s, SLICE_S))
            return self._pop() if self._waiting else None

    def __iter__(self) -> Iterator[Arrival[M]]:
        while (arrival := self.next()) is not None:
            yield arrival

    def close(self) -> None:
        """Stop listening; whoever waits for a message waits no longer."""
        if is_forked():  # in the midst of a message, perhaps: the lock is never given back then
            return
        closer, self._closer = self._closer, None
        if closer is not None:
            closer.close()
        with self._condition:
            self.is_closed = True
            self._condition.notify_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _take(self, sample: Sample) -> None:
        if sample.is_delete:
            return
        # In slices: a signal that closes it may have interrupted who has the lock.
        while not self._condition.acquire(timeout=SLICE_S):
            if self.is_closed:
                return
        try:
            self._store(sample.key, sample.payload, sample.encoding)
        finally:
            self._condition.release()

    def _store(self, key: str, payload: bytes, encoding: str) -> None:
        # A put to many keys at once is no message of any of them.
        matched = None if has_wildcard(key) else self._topic.match(key)
        if matched is None:
            return
        if len(payload) > self._topic.max_bytes:
            self.invalid += 1
            return
        try:
            message = codec.decode(self._topic.message, payload, encoding)
        except codec.BadPayload:
            self.invalid += 1
            return
        self._heard.add(key)
        self._waiting.append(Arrival(*matched, message, len(payload), time.monotonic()))
        self._waiting_bytes += len(payload)
        while len(self._waiting) > 1 and (
            len(self._waiting) > self._most_waiting or self._waiting_bytes > MOST_WAITING_BYTES
        ):
            self._pop()
        self._condition.notify()

    def _pop(self) -> Arrival[M]:
        oldest = self._waiting.popleft()
        self._waiting_bytes -= oldest.size
        return oldest


class Connection:
    """A session with a router and what can be done over it; a context manager.

    Raises:
        RobotUnreachable: On entering, where no router answers.
    """

    def __init__(
        self,
        endpoints: Sequence[str],
        connect_timeout_s: float = CONNECT_TIMEOUT_S,
        keys: HostKeys | None = None,
    ) -> None:
        self.endpoints = list(endpoints)
        self._opening: AbstractContextManager[ZenohBus] = open_bus(
            endpoints, connect_timeout_s, keys
        )
        self._bus: ZenohBus | None = None

    def __enter__(self) -> Self:
        try:
            self._bus = self._opening.__enter__()
        except NotConnected as error:
            raise RobotUnreachable(str(error)) from error
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._bus = None
        self._opening.__exit__(kind, error, trace)

    @property
    def bus(self) -> ZenohBus:
        """The open bus."""
        bus = self._bus  # read once: another thread may close it meanwhile
        if bus is None:
            raise Closed
        if is_forked():
            raise RobotUnreachable(FORKED)
        return bus

    @contextmanager
    def using(self) -> Generator[ZenohBus]:
        """The open bus; another thread may close it meanwhile."""
        try:
            yield self.bus
        except ZenohError as error:
            raise Closed from error

    def ask(
        self, robot: str, request: Request[P, R], params: P, timeout_s: float = ASK_TIMEOUT_S
    ) -> R:
        """Ask a robot and wait for its answer.

        Raises:
            Refused: With the contract's code; `timeout` if no answer came. RobotUnreachable: Nobody
            of that name is on the network.
        """
        try:
            payload = codec.encode_parameters(params)
        except UnicodeEncodeError as error:  # bytes of another encoding, as Python keeps them
            problem = f"{error.object!r} is not UTF-8 text; save or type it as UTF-8."
            raise Refused(codes.BAD_REQUEST, f"{request.name}: {problem}") from error
        replies, timed_out = self._gather(
            f"{request.key(robot)}?format=msgpack", timeout_s, payload, codec.MIME["msgpack"]
        )
        if not replies:
            alive = self.services(robot)
            if not alive:
                raise self.unknown_robot(robot)
            if not timed_out and (robot, request.owner) in alive:
                raise Refused(
                    codes.NOT_READY,
                    f"{request.name}: {request.owner} is still starting, or this connection may "
                    "look but not command.",
                    service=request.owner,
                )
        result: Any = outcome(request, replies, timed_out)
        if isinstance(result, Refused):
            raise result
        return result

    def stop_all(self, timeout_s: float = ASK_TIMEOUT_S) -> dict[str, BaseState]:
        """Stop every robot on the network; return what each answered, by name."""
        key = requests.BASE_STOP.key("*")
        replies, _ = self._gather(f"{key}?format=msgpack", timeout_s)
        answers: dict[str, BaseState] = {}
        for reply in replies:
            _, _, rest = reply.key.partition("/")
            robot = rest.partition("/")[0]
            if reply.is_error or not topics.names_robot(robot):
                continue
            try:
                answers[robot] = codec.decode(BaseState, reply.payload, reply.encoding)
            except codec.BadPayload:
                continue  # then this is no robot that has stopped
        return answers

    def get(
        self,
        robot: str,
        topic: Topic[M],
        *parts: str,
        parameters: Mapping[str, str] | None = None,
        timeout_s: float = GET_TIMEOUT_S,
    ) -> dict[tuple[str, ...], M]:
        """The latest values of a topic by the chunks of their keys that vary.

        With `"*"` as robot, the chunks begin with its name. Values that nobody has, or that cannot
        be decoded, are left out.
        """
        asked = {"format": "msgpack", **(parameters or {})}
        selector = ";".join(f"{name}={quote(value, safe='')}" for name, value in asked.items())
        replies, _ = self._gather(f"{_key(robot, topic, parts)}?{selector}", timeout_s)
        found: dict[tuple[str, ...], M] = {}
        for reply in replies:
            matched = None if reply.is_error else topic.match(reply.key)
            if matched is None:
                continue
            name, have = matched
            try:
                message = codec.decode(topic.message, reply.payload, reply.encoding)
            except codec.BadPayload:
                continue
            found[(name, *have) if robot == "*" else have] = message
        return found

    def latest(self, robot: str, topic: Topic[M], *parts: str) -> M | None:
        """The latest value of a single key, None if nobody has it."""
        return next(iter(self.get(robot, topic, *parts).values()), None)

    def subscribe(
        self,
        robot: str,
        topic: Topic[M],
        *parts: str,
        with_latest: bool = True,
        most_waiting: int = MOST_WAITING,
    ) -> Subscription[M]:
        """Listen to a topic, beginning with the latest values if its owner keeps some."""
        subscription = Subscription(topic, most_waiting)
        key = _key(robot, topic, parts)
        with self.using() as bus:
            subscription.open(bus, key)
            if with_latest:
                bus.get(
                    f"{key}?format=msgpack",
                    b"",
                    "",
                    GET_TIMEOUT_S,
                    subscription.add_latest,
                    lambda: None,
                )
        return subscription

    def publish(self, robot: str, topic: Topic[M], message: M, *parts: str) -> None:
        """Publish a message; without a router it is dropped, like one that may not be sent.

        Raises:
            ValueError: The key is not that of one value.
        """
        key = _key(robot, topic, parts)
        if has_wildcard(key):
            raise ValueError(f"to publish {topic.name}, name what varies, without a wildcard")
        payload = codec.encode(message, "msgpack")
        with self.using() as bus:
            bus.put(key, payload, codec.MIME["msgpack"], topic.qos)

    def delete(self, robot: str, topic: Topic[Any], *parts: str) -> None:
        """Ask the owner of what is stored to delete it."""
        with self.using() as bus:
            bus.delete(_key(robot, topic, parts))

    def listen(self, key_expr: str, callback: Callable[[Sample], None]) -> Closer:
        """Call back, on a thread of the bus, with everything that is published under a key."""
        return self.bus.subscribe(key_expr, callback)

    def services(self, robot: str = "*") -> dict[tuple[str, str], list[str]]:
        """The runs that are alive, by (robot, service)."""
        found: dict[tuple[str, str], list[str]] = {}
        for key in self._tokens(topics.ALIVE.key(robot)):
            matched = topics.ALIVE.match(key)
            if matched is not None and topics.names_robot(matched[0]) and not has_wildcard(key):
                name, (service, run) = matched
                found.setdefault((name, service), []).append(run)
        return found

    def robots(self) -> list[str]:
        """The names of the robots of which any service is alive.

        Raises:
            RouterBusy: The router does not say in time.
        """
        return sorted({robot for robot, _ in self.services()})

    def unknown_robot(self, robot: str) -> RobotUnreachable:
        """What to raise where nobody of that name is: it says who is there instead."""
        others = [name for name in self.robots() if name != robot]
        hint = f" {did_you_mean(robot, others)}" if others else ""
        return RobotUnreachable(
            f"no robot called {robot} is at {', '.join(self.endpoints)} "
            f"(or this connection is not allowed to ask it).{hint}"
        )

    def _tokens(self, key_expr: str) -> list[str]:
        """The tokens that are shown; a router that is late with its answer is asked once more."""
        shown: list[str] = []
        for patience_s in TOKENS_S:
            began_s = time.monotonic()
            with self.using() as bus:
                shown = bus.alive(key_expr, patience_s)
            if time.monotonic() - began_s < patience_s:
                return shown
        if not shown:
            raise RouterBusy(
                f"the router at {', '.join(self.endpoints)} does not say in time who is there: "
                "it, the link to it or this computer is too busy. Try again"
            )
        return shown

    def robot_now_ns(self, robot: str) -> int | None:
        """Robot time, at most 0.1 s behind; None without `base`. `RobotTime` is exact."""
        clock = self.latest(robot, topics.CLOCK)
        return None if clock is None else clock.stamp_ns

    def _gather(
        self, selector: str, timeout_s: float, payload: bytes = b"", encoding: str = ""
    ) -> tuple[list[Reply], bool]:
        replies: list[Reply] = []
        done = threading.Event()
        with self.using() as bus:
            bus.get(selector, payload, encoding, timeout_s, replies.append, done.set)
        # Zenoh ends the query by itself at its deadline; the margin is for that to arrive.
        in_time = done.wait(timeout_s + 0.5)
        return list(replies), not in_time


class RobotTime:
    """The time of a robot, followed from its clock as long as the connection lasts.

    Making one waits up to a second for the first message of the clock. Like services, it asks base
    about a message that does not follow from those before.
    """

    def __init__(self, connection: Connection, robot: str) -> None:
        self._connection, self._key = connection, topics.CLOCK.key(robot)
        self._clocks = connection.subscribe(robot, topics.CLOCK)
        self._time = FollowedTime()
        self._question: _ClockQuestion | None = None
        end_s = time.monotonic() + CLOCK_PATIENCE_S
        while self.now_ns() is None and (left_s := end_s - time.monotonic()) > 0.0:
            if self._question is not None:
                self._question.answered.wait(left_s)
            elif (first := self._clocks.next(left_s)) is not None:
                self._hear(first)

    def now_ns(self) -> int | None:
        """Robot time [ns], None where nothing was received from the robot for a second."""
        while (heard := self._clocks.next(0.0)) is not None:
            self._hear(heard)
        if self._question is not None and self._question.answered.is_set():
            self._question.settle(self._time)
            self._question = None
        return self._time.now(time.monotonic_ns())

    def _hear(self, heard: Arrival[Clock]) -> None:
        arrived_ns = round(heard.arrived_s * 1e9)
        if self._time.follows(heard.message, arrived_ns):
            self._time.update(heard.message, arrived_ns)
        elif self._question is None:
            self._question = _ClockQuestion(self._connection, self._key, heard.message, arrived_ns)


class _ClockQuestion:
    """Base is asked for its clock, because a message of it cannot be believed by itself."""

    def __init__(self, connection: Connection, key: str, clock: Clock, arrived_ns: int) -> None:
        self.answered = threading.Event()
        self._clock, self._arrived_ns = clock, arrived_ns
        self._replies: list[Reply] = []
        self._answered_ns = 0
        self._asked_s = time.monotonic()
        with connection.using() as bus:
            bus.get(f"{key}?format=msgpack", b"", "", ANSWER_S, self._replies.append, self._done)

    def settle(self, followed: FollowedTime) -> None:
        """Take in what came of it."""
        timed_out = self._answered_ns * 1e-9 - self._asked_s >= ANSWER_S
        answers = told(self._replies)
        followed.settle(
            self._clock, self._arrived_ns, answers, self._answered_ns, timed_out=timed_out
        )

    def _done(self) -> None:
        self._answered_ns = time.monotonic_ns()
        self.answered.set()


@dataclasses.dataclass(frozen=True)
class Target:
    """Which robot, and through which routers it is reached."""

    robot: str | None
    """None: the single one of the network."""
    endpoints: tuple[str, ...]
    preferred: str | None = None
    """Taken where several are there and this is one of them."""
    keys: HostKeys | None = None
    """This host's, where an endpoint needs them."""


def find_target(
    robot: str | None = None,
    connect: Sequence[str] | None = None,
    config: Path | str | None = None,
) -> Target:
    """Where to look: what is given, then the configuration file, then the default router.

    Raises:
        ConfigError: There is a configuration file, or keys, that cannot be used.
        ValueError: What is given is no endpoint.
    """
    for one in connect or ():
        if why_not := why_no_endpoint(one):
            raise ValueError(why_not)
    given = Path(config) if config is not None else None
    # Where an endpoint needs keys, the file says where they are.
    path = None if robot and connect and not any(map(is_far, connect)) else find_config(given)
    settings = None if path is None else load_host_config(path)
    endpoints = list(connect or [])
    if not endpoints:
        endpoints = settings.zenoh.connect if settings is not None else [DEFAULT_ENDPOINT]
    known = settings.robot.name if isinstance(settings, RobotConfig) else None
    folder = DEFAULT_FOLDER if settings is None else settings.path(settings.zenoh.keys)
    try:
        keys = keys_for(endpoints, folder)
    except KeysError as error:
        raise ConfigError(str(error)) from error
    # A router that was named by hand may belong to another robot than this host's file.
    if robot is None and connect and given is None:
        return Target(None, tuple(endpoints), known, keys)
    return Target(robot or known, tuple(endpoints), keys=keys)


def _key(robot: str, topic: Topic[Any], parts: Sequence[str]) -> str:
    """The key of a topic.

    Raises:
        ValueError: A part that can stand in none.
    """
    for part in parts:
        is_wild = part in ("*", "**")
        if not part or not (is_wild or set("/?#*$").isdisjoint(part)):
            raise ValueError(f"{topic.name}: {part!r} cannot stand in a key")
    return topic.key(robot, *parts)


def pick_robot(connection: Connection, target: Target) -> str:
    """The robot meant by a target.

    Raises:
        SeveralRobots: None was named and several are there.
        RobotUnreachable: None was named and none is there, or no robot can have that name.
    """
    if target.robot is not None:
        if not topics.names_robot(target.robot):
            raise connection.unknown_robot(target.robot)
        return target.robot
    names = connection.robots()
    if len(names) == 1:
        return names[0]
    if target.preferred in names:
        return target.preferred
    if names:
        raise SeveralRobots(names)
    raise RobotUnreachable(f"no robot is on the network at {', '.join(connection.endpoints)}")
