"""What a service is: a class whose methods are bound to topics, periods and requests.

A service has no loop, thread or clock of its own. A runtime binds it to a node, calls `start`, and
then calls its methods one at a time: on a message (`@on`), at a period (`@every`), for a request
(`@answers`), for a `get` of its topics (`@gets`). Methods never block; files and long work go through
`work`. The same class runs as a process over Zenoh and in the lock-step runtime.

    class LocalizerService(Service):
        name = "localizer"

        def start(self) -> None:
            self._odometry = self.watch(topics.ODOM, seconds=2.0)

        @on(topics.SCAN)
        def locate(self, scan: Scan) -> None:
            self.publish(topics.POSE, self._core.step(scan, self._odometry.history))

        @answers(requests.POSE_SET)
        def set_pose(self, params: SetPose) -> PoseEstimate:
            if outside:
                raise Refused(codes.OUTSIDE_MAP)
            return estimate
"""

import dataclasses
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Generic, Literal, Protocol, TypeVar, overload

import msgspec

from trolley.codes import Refused
from trolley.requests import Request
from trolley.runtime.log import Log
from trolley.runtime.robot_time import TimeSource
from trolley.runtime.state import StateFolder
from trolley.topics import Topic

M = TypeVar("M", bound=msgspec.Struct)
P = TypeVar("P", bound=msgspec.Struct)
R = TypeVar("R")
T = TypeVar("T")
F = TypeVar("F", bound=Callable[..., Any])

TimerClock = Literal["robot", "local"]
BINDINGS = "__trolley_bindings__"


@dataclasses.dataclass(frozen=True)
class Binding:
    """What a decorator asks of the runtime for one method."""

    kind: Literal["on", "on_delete", "every", "answers", "gets"]
    topic: Topic[Any] | None = None
    request: Request[Any, Any] | None = None
    parts: tuple[str, ...] = ()
    robot: str | None = None
    seconds: float = 0.0
    clock: TimerClock = "robot"


def _bind(binding: Binding) -> Callable[[F], F]:
    def mark(method: F) -> F:
        setattr(method, BINDINGS, (*getattr(method, BINDINGS, ()), binding))
        return method

    return mark


def on(topic: Topic[Any], *parts: str, robot: str | None = None) -> Callable[[F], F]:
    """Call the method with each message of `topic`: `method(message, *varying_chunks)`.

    Sensor and command streams give the newest message of each key, state streams and stored keys
    every one. `parts` narrow the varying chunks; `robot="*"` listens to all robots, whose name then
    stands before the chunks.
    """
    return _bind(Binding("on", topic=topic, parts=parts, robot=robot))


def on_delete(topic: Topic[Any], *parts: str) -> Callable[[F], F]:
    """Call `method(*varying_chunks)` when a key of `topic` is deleted (chunks may hold wildcards)."""
    return _bind(Binding("on_delete", topic=topic, parts=parts))


def every(seconds: float, clock: TimerClock = "robot") -> Callable[[F], F]:
    """Call `method()` at this period of robot time, or of the local monotonic clock.

    Robot periods rest while there is no robot time; periods that were missed are skipped.
    """
    return _bind(Binding("every", seconds=seconds, clock=clock))


def answers(request: Request[Any, Any]) -> Callable[[F], F]:
    """Answer `request` with what `method(params)` returns; it raises `Refused` to refuse.

    A method that cannot answer yet returns `self.later()` and answers through it within 2 s.
    """
    return _bind(Binding("answers", request=request))


def gets(topic: Topic[Any], *parts: str) -> Callable[[F], F]:
    """Answer `get` of `topic` by `method(parameters) -> {varying_chunks: message}`.

    Only where the latest published value is not the answer: stored keys, `goal?id=`. The runtime
    picks what the asked key covers and refuses an unknown exact key with `unknown_name`.
    """
    return _bind(Binding("gets", topic=topic, parts=parts))


class Watch(Generic[M]):
    """What is known of a topic: the latest message of each key, and the last seconds if asked."""

    def __init__(self, topic: Topic[M], seconds: float) -> None:
        self.topic = topic
        self.latest: M | None = None
        """The newest message of all keys."""
        self.arrived_ns: int | None = None
        """Local monotonic time of its arrival."""
        self.by_parts: dict[tuple[str, ...], M] = {}
        """The newest message per varying chunks (with the robot first where all robots are watched)."""
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


class Port(Protocol):
    """What a node offers to its service; the methods of `Service` explain them."""

    @property
    def robot(self) -> str: ...
    @property
    def log(self) -> Log: ...
    @property
    def state(self) -> StateFolder: ...
    @property
    def maps(self) -> StateFolder: ...
    @property
    def monotonic_ns(self) -> int: ...
    @property
    def arrived_ns(self) -> int: ...
    def time_of(self, robot: str) -> TimeSource: ...
    @property
    def unix_ns(self) -> int: ...
    def utc_now(self) -> str | None: ...
    def new_id(self) -> str: ...
    def publish(
        self, topic: Topic[Any], message: Any, parts: tuple[str, ...], robot: str | None
    ) -> None: ...
    def put_wish(
        self, topic: Topic[Any], message: Any, parts: tuple[str, ...], robot: str | None
    ) -> None: ...
    def watch(
        self,
        topic: Topic[M],
        parts: tuple[str, ...],
        seconds: float,
        robot: str | None,
        then: Callable[..., None] | None,
    ) -> Watch[M]: ...
    def request(
        self,
        request: Request[Any, R],
        params: Any,
        then: Callable[[R | Refused], None],
        timeout_s: float,
        robot: str | None,
    ) -> None: ...
    def get(
        self,
        topic: Topic[M],
        parts: tuple[str, ...],
        then: Callable[[dict[tuple[str, ...], M]], None],
        robot: str | None,
    ) -> None: ...
    def work(self, fn: Callable[[], T], then: Callable[[T], None] | None) -> None: ...
    def call_soon(self, fn: Callable[[], None], *, urgent: bool) -> None: ...
    def count(self, name: str, number: int) -> None: ...
    def set_health(self, state: str, message: str) -> None: ...
    def close_watch(self, watch: Watch[Any]) -> None: ...


class Service:
    """Base of all services; subclasses set `name` and bind methods by the decorators above."""

    name: ClassVar[str]
    """The service's name, as in `health/<name>`."""
    all_robots: ClassVar[bool] = False
    """Whether it listens to the clocks of all robots."""
    own_time: TimeSource | None = None
    """Set in `__init__` by the service that owns robot time (`base`) instead of following `clock`."""

    _port: Port

    def bind(self, port: Port) -> None:
        """Tie the service to its node (called by the runtime)."""
        self._port = port

    def start(self) -> None:
        """Called once when the node is bound, before any other method: watch topics, read state."""

    def stop(self) -> None:
        """Called once at the end (SIGTERM too): say the last word, save what must be saved."""

    def epoch_began(self) -> None:
        """Called when `base` began a new run: what was measured before it no longer counts."""

    # What it knows.
    @property
    def robot(self) -> str:
        """The robot's name."""
        return self._port.robot

    @property
    def now_ns(self) -> int | None:
        """Robot time [ns], None while unknown."""
        return self._port.time_of(self._port.robot).now(self._port.monotonic_ns)

    @property
    def stamp_ns(self) -> int:
        """Robot time for a message's stamp: 0 while unknown."""
        return self.now_ns or 0

    @property
    def epoch_ns(self) -> int:
        """Robot time [ns] at which the present run of `base` began."""
        return self._port.time_of(self._port.robot).epoch

    @property
    def monotonic_ns(self) -> int:
        """The local monotonic clock [ns] (simulated in lock-step)."""
        return self._port.monotonic_ns

    @property
    def arrived_ns(self) -> int:
        """Local monotonic time at which the message in hand arrived."""
        return self._port.arrived_ns

    def time_of(self, robot: str) -> TimeSource:
        """The clock of another robot (only where `all_robots` is set)."""
        return self._port.time_of(robot)

    @property
    def unix_ns(self) -> int:
        """The host's clock [ns since 1970], synchronised or not (0 at the start of lock-step)."""
        return self._port.unix_ns

    def utc_now(self) -> str | None:
        """UTC as ISO 8601, None until the host's clock is synchronised (and in lock-step)."""
        return self._port.utc_now()

    def new_id(self) -> str:
        """A fresh id of 12 characters [a-z0-9] (from the seed in lock-step)."""
        return self._port.new_id()

    @property
    def state(self) -> StateFolder:
        """The folder of this robot's state."""
        return self._port.state

    @property
    def maps(self) -> StateFolder:
        """The folder of this host's maps."""
        return self._port.maps

    @property
    def log(self) -> Log:
        """The structured log: `self.log.info("Map loaded", map=name)`."""
        return self._port.log

    # What it does.
    def publish(self, topic: Topic[M], message: M, *parts: str, robot: str | None = None) -> None:
        """Publish a message and keep it for `get`; `parts` fill the topic's varying chunks."""
        self._port.publish(topic, message, parts, robot)

    def put_wish(
        self, topic: Topic[M], message: M | None, *parts: str, robot: str | None = None
    ) -> None:
        """Ask the owner of a stored key to store `message`, or to delete it (None)."""
        self._port.put_wish(topic, message, parts, robot)

    def watch(
        self,
        topic: Topic[M],
        *parts: str,
        seconds: float = 0.0,
        robot: str | None = None,
        then: Callable[..., None] | None = None,
    ) -> Watch[M]:
        """Keep what is known of a topic; see `on` for `parts`, `robot` and the arguments of `then`."""
        return self._port.watch(topic, parts, seconds, robot, then)

    def close_watch(self, watch: Watch[Any]) -> None:
        """Stop watching."""
        self._port.close_watch(watch)

    def request(
        self,
        request: Request[P, R],
        params: P,
        then: Callable[[R | Refused], None],
        timeout_s: float = 2.0,
        robot: str | None = None,
    ) -> None:
        """Ask another service; `then` gets its reply, or the refusal (`not_ready` if nobody answers)."""
        self._port.request(request, params, then, timeout_s, robot)

    def get(
        self,
        topic: Topic[M],
        *parts: str,
        then: Callable[[dict[tuple[str, ...], M]], None],
        robot: str | None = None,
    ) -> None:
        """Read the latest values of a topic from its owner; `then` gets them by varying chunks."""
        self._port.get(topic, parts, then, robot)

    @overload
    def work(self, fn: Callable[[], object]) -> None: ...
    @overload
    def work(self, fn: Callable[[], T], then: Callable[[T], None]) -> None: ...
    def work(self, fn: Callable[[], Any], then: Callable[[Any], None] | None = None) -> None:
        """Run `fn` aside (at once in lock-step), one after another, then call `then` with its result.

        `fn` may touch files, but nothing of the service. An exception of `fn` that `then` should
        see is returned by `fn` as a value.
        """
        self._port.work(fn, then)

    def call_soon(self, fn: Callable[[], None], *, urgent: bool = False) -> None:
        """Call `fn` on the service's thread; the one method that any other thread may call.

        Calls keep their order; an `urgent` one goes before everything that waits. Where thousands
        of arrivals wait already, one that is not urgent is dropped and counted as `inbox/dropped`.
        """
        self._port.call_soon(fn, urgent=urgent)

    def later(self) -> "Later[Any]":
        """Return this from a request's method to answer it within 2 s."""
        return Later()

    def count(self, name: str, number: int = 1) -> None:
        """Add to a counter of `health`."""
        self._port.count(name, number)

    def set_health(self, state: Literal["ok", "degraded", "failed"], message: str = "") -> None:
        """Set what `health` says from now on."""
        self._port.set_health(state, message)


def bindings_of(service: Service) -> list[tuple[Binding, Callable[..., Any]]]:
    """Every bound method of a service, in the order of definition."""
    found: list[tuple[Binding, Callable[..., Any]]] = []
    seen: set[str] = set()
    members: Mapping[str, Any]
    for cls in type(service).__mro__:
        members = vars(cls)
        for name, member in members.items():
            if name not in seen:
                seen.add(name)
                found += [
                    (binding, getattr(service, name)) for binding in getattr(member, BINDINGS, ())
                ]
    return found
