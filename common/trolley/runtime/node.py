"""The engine between a bus and a service: arrivals become calls, and calls messages.

Both runtimes use it. Bus callbacks (on any thread) only store in the inbox; `step` runs on the one
thread that calls the service's methods.
"""

from collections.abc import Callable
from typing import Any, Protocol, TypeVar

import msgspec

from trolley import topics
from trolley.messages import Clock, Health
from trolley.requests import Request
from trolley.runtime import codec
from trolley.runtime.bus import Bus
from trolley.runtime.inbox import Inbox
from trolley.runtime.log import Log
from trolley.runtime.receiving import Context, Receiver, Watching
from trolley.runtime.replies import Gathering, outcome
from trolley.runtime.robot_time import FollowedTime, TimeSource
from trolley.runtime.service import Binding, Service, Watch, bindings_of
from trolley.runtime.serving import Server
from trolley.runtime.state import StateFolder
from trolley.runtime.timers import Timers
from trolley.topics import Kind, Topic

M = TypeVar("M", bound=msgspec.Struct)

HEALTH_PERIOD_S = 1.0
MAX_TASKS = 256
OTHERS_ARE_BACK_S = 2.0


class Host(Protocol):
    """What a runtime provides besides the bus: time, files, ids, a worker."""

    @property
    def state(self) -> StateFolder:
        """This robot's state."""
        ...

    @property
    def maps(self) -> StateFolder:
        """The host's maps."""
        ...

    def monotonic_ns(self) -> int:
        """The local monotonic clock."""
        ...

    def unix_ns(self) -> int:
        """The host's clock, synchronised or not."""
        ...

    def utc_now(self) -> str | None:
        """UTC as ISO 8601, None until synchronised."""
        ...

    def new_id(self) -> str:
        """A fresh id."""
        ...

    def work(self, fn: Callable[[], Any], done: Callable[[Any], None]) -> None:
        """Run `fn` aside, then call `done` (on any thread) with its result."""
        ...

    def usage(self) -> tuple[float, int]:
        """Share of one core since the last call, resident bytes."""
        ...


class Node:
    """One service on a bus; `trolley.runtime.service.Service` says what it can ask of it."""

    def __init__(
        self, service: Service, robot: str, bus: Bus, host: Host, label: str | None = None
    ) -> None:
        self.service = service
        self.robot = robot
        self.label = label or service.name
        self.log = Log(self.label)
        self.inbox = Inbox(host.monotonic_ns)
        self.counters: dict[str, int] = {}
        self.arrived_ns = 0
        self._bus = bus
        self._host = host
        self._timers = Timers()
        self._times: dict[str, FollowedTime] = {}
        self._owned: set[Topic[Any] | None] = set()
        self._health = Health(stamp_ns=0, state="starting")
        self._usage = (0.0, 0)
        context = Context(robot, bus, self.inbox, self.log, self.count, self.time_of, self._after)
        self._receiver = Receiver(context)
        self._server = Server(context)

    # Life.
    def open(self) -> None:
        """Bind the service: `prepare`, then watches, requests and periods, then `start`."""
        self.service.bind(self)
        self.service.prepare()
        if self.service.own_time is None or self.service.all_robots:
            everybody = "*" if self.service.all_robots else None
            clocks = Watching(Watch(topics.CLOCK, 0.0), everybody, (), then=self._hear_clock)
            self._receiver.open(clocks)
        bindings = bindings_of(self.service, *self.service.parts)
        self._owned = {binding.topic for binding, _ in bindings if binding.kind == "gets"}
        for binding, method in bindings:
            self._open_binding(binding, method)
        self.service.start()
        if self._health.state == "starting":
            self.set_health("ok", "")
        self._timers.every(HEALTH_PERIOD_S, self._measure_health, is_local=True)

    def close(self) -> None:
        """Let the service say its last word and take everything off the bus."""
        self.service.stop()
        self.silence()

    def silence(self) -> None:
        """Take everything off the bus without a word, as when the process dies."""
        self._server.close()
        self._receiver.close()

    def reconnected(self) -> None:
        """The bus is back (any thread): read again what was missed.

        Once more when the others, who look for the router at their own pace, are back as well.
        """

        def catch_up(_arrived_ns: int) -> None:
            self._receiver.catch_up()
            self._after(OTHERS_ARE_BACK_S, self._receiver.catch_up)

        self.inbox.push(catch_up, own=True)

    def step(self) -> bool:
        """Do what waits and is due, a limited number of things at once; True if anything was."""
        did = False
        for _ in range(MAX_TASKS):  # whoever calls has its own things to look after
            entry = self.inbox.pop()
            if entry is None:
                break
            task, self.arrived_ns = entry
            task(self.arrived_ns)
            did = True
            self._run_timers()  # a flood of messages must not starve the periods
        return self._run_timers() or did

    def next_due_ns(self) -> int:
        """Local monotonic time [ns] at which to step again."""
        return self._timers.next_due_ns(self.monotonic_ns, self.time_of(self.robot))

    # What the service asks for.
    @property
    def state(self) -> StateFolder:
        """This robot's state."""
        return self._host.state

    @property
    def maps(self) -> StateFolder:
        """The host's maps."""
        return self._host.maps

    @property
    def monotonic_ns(self) -> int:
        """The local monotonic clock."""
        return self._host.monotonic_ns()

    def time_of(self, robot: str) -> TimeSource:
        """The clock of a robot."""
        if robot == self.robot and self.service.own_time is not None:
            return self.service.own_time
        if robot not in self._times:
            self._times[robot] = FollowedTime()
        return self._times[robot]

    @property
    def unix_ns(self) -> int:
        """The host's clock, synchronised or not."""
        return self._host.unix_ns()

    def utc_now(self) -> str | None:
        """UTC as ISO 8601."""
        return self._host.utc_now()

    def new_id(self) -> str:
        """A fresh id."""
        return self._host.new_id()

    def count(self, name: str, number: int = 1) -> None:
        """Add to a counter."""
        self.counters[name] = self.counters.get(name, 0) + number

    def set_health(self, state: str, message: str) -> None:
        """Set state and message of `health`; a change is published at once."""
        changed = (self._health.state, self._health.message) != (state, message)
        self._health = msgspec.structs.replace(self._health, state=state, message=message)
        if changed:
            self._publish_health()

    def publish(
        self, topic: Topic[Any], message: Any, parts: tuple[str, ...], robot: str | None
    ) -> None:
        """Publish and keep for `get`."""
        key = topic.key(robot or self.robot, *parts)
        self._server.keep(topic, key, message)
        self._bus.put(key, codec.encode(message, "msgpack"), codec.MIME["msgpack"], topic.qos)

    def withdraw(self, topic: Topic[Any], parts: tuple[str, ...]) -> None:
        """Answer `get` no more."""
        self._server.withdraw(topic.key(self.robot, *parts))

    def put_wish(
        self, topic: Topic[Any], message: Any, parts: tuple[str, ...], robot: str | None
    ) -> None:
        """Put or delete a key that another service owns."""
        key = topic.key(robot or self.robot, *parts)
        if message is None:
            self._bus.delete(key)
        else:
            self._bus.put(key, codec.encode(message, "msgpack"), codec.MIME["msgpack"], topic.qos)

    def watch(
        self,
        topic: Topic[M],
        parts: tuple[str, ...],
        seconds: float,
        robot: str | None,
        then: Callable[..., None] | None,
    ) -> Watch[M]:
        """Subscribe, and read what is there already."""
        watch = Watch(topic, seconds)
        is_wish = topic.kind is Kind.STORED and topic in self._owned
        self._receiver.open(Watching(watch, robot, parts, then, is_wish=is_wish))
        return watch

    def close_watch(self, watch: Watch[Any]) -> None:
        """Stop watching."""
        self._receiver.close(watch)

    def request(
        self,
        request: Request[Any, Any],
        params: Any,
        then: Callable[[Any], None],
        timeout_s: float,
        robot: str | None,
    ) -> None:
        """Ask; `then` gets the reply or a `Refused`."""
        gathering = Gathering(
            self.inbox, lambda replies, late: then(outcome(request, replies, late))
        )
        self._after(timeout_s, lambda: gathering.end(timed_out=True))
        self._bus.get(
            request.key(robot or self.robot) + "?format=msgpack",
            codec.encode(params, "msgpack"),
            codec.MIME["msgpack"],
            timeout_s,
            gathering.add,
            gathering.done,
        )

    def get(
        self,
        topic: Topic[Any],
        parts: tuple[str, ...],
        then: Callable[[dict[tuple[str, ...], Any]], None],
        robot: str | None,
    ) -> None:
        """Read latest values by varying chunks."""
        self._receiver.get(topic, robot or self.robot, parts, then)

    def work(self, fn: Callable[[], Any], then: Callable[[Any], None] | None) -> None:
        """Run `fn` aside, then `then` on the service's thread."""

        def hand_over(result: Any) -> None:
            if then is not None:
                then(result)

        def done(result: Any) -> None:
            self.inbox.push(lambda _: hand_over(result), own=True)

        self._host.work(fn, done)

    def call_soon(self, fn: Callable[[], None], *, urgent: bool) -> None:
        """Call `fn` on the service's thread (any thread)."""
        self.inbox.push(lambda _: fn(), urgent=urgent)

    # Inside.
    def _open_binding(self, binding: Binding, method: Callable[..., Any]) -> None:
        match binding:
            case Binding(kind="every"):
                self._timers.every(binding.seconds, method, is_local=binding.clock == "local")
            case Binding(kind="answers", request=Request() as request):
                self._server.open_request(request, method)
            case Binding(kind="gets", topic=Topic() as topic):
                self._server.open_gets(topic, binding.parts, method)
            case Binding(kind="on", topic=Topic() as topic):
                self.watch(topic, binding.parts, 0.0, binding.robot, method)
            case Binding(topic=Topic() as topic):
                watch = Watch(topic, 0.0)
                self._receiver.open(Watching(watch, None, binding.parts, on_delete=method))
            case _:
                raise TypeError(f"{method.__qualname__}: a binding without topic or request")

    def _hear_clock(self, clock: Clock, robot: str | None = None) -> None:
        time = self._times.setdefault(robot or self.robot, FollowedTime())
        if not time.hear(clock, self.arrived_ns):
            return
        self._receiver.forget_epoch(robot or self.robot, clock.epoch)
        if (robot or self.robot) == self.robot:
            self.service.epoch_began()

    def _measure_health(self) -> None:
        self._server.say_again()
        self._usage = self._host.usage()
        self._publish_health()

    def _publish_health(self) -> None:
        cpu, rss = self._usage
        counters = dict(self.counters)
        if self.inbox.dropped:
            counters["inbox/dropped"] = self.inbox.dropped
        stamp_ns = self.time_of(self.robot).now(self.monotonic_ns) or 0
        health = msgspec.structs.replace(
            self._health, stamp_ns=stamp_ns, counters=counters, cpu=cpu, rss=rss
        )
        self.publish(topics.HEALTH, health, (self.label,), None)

    def _run_timers(self) -> bool:
        return self._timers.run(self._host.monotonic_ns, self.time_of(self.robot))

    def _after(self, seconds: float, call: Callable[[], None]) -> None:
        self._timers.at(self.monotonic_ns + int(seconds * 1e9), call)
