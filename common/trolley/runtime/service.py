"""What a service is: a class whose methods are bound to topics, periods and requests.

A service has no loop, thread or clock of its own. A runtime binds it to a bus, calls `start`, and
then calls its methods one at a time: on a message (`@on`), at a period (`@every`), for a request
(`@answers`), for a `get` of its topics (`@gets`). Methods never block; files and long work go
through `work`. The same class runs as a process over Zenoh and in the lock-step runtime.

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

A service that does several things consists of parts: plain objects, made in `__init__` and named in
`parts`, whose decorated methods the runtime binds as it binds the service's own. A part is given
the service it belongs to as a `Service`: it sees the wire, the clocks and the files, nothing else.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, ClassVar, Literal, TypeVar, overload

import msgspec

from trolley.codes import Refused
from trolley.requests import Request
from trolley.runtime import codec
from trolley.runtime.bindings import (
    Binding,
    TimerClock,
    answers,
    bindings_of,
    every,
    gets,
    on,
    on_delete,
)
from trolley.runtime.bus import Reply
from trolley.runtime.host import Host
from trolley.runtime.log import Log
from trolley.runtime.receiving import Watch
from trolley.runtime.replies import outcome
from trolley.runtime.robot_time import TimeSource
from trolley.runtime.saves import Saves
from trolley.runtime.serving import Later
from trolley.runtime.state import StateFolder
from trolley.runtime.timers import Deadline
from trolley.runtime.wire import Wire
from trolley.topics import Topic

__all__ = [
    "Binding",
    "Deadline",
    "Later",
    "Service",
    "TimerClock",
    "Watch",
    "answers",
    "bindings_of",
    "every",
    "gets",
    "on",
    "on_delete",
]

M = TypeVar("M", bound=msgspec.Struct)
P = TypeVar("P", bound=msgspec.Struct)
R = TypeVar("R")
T = TypeVar("T")


class Service:
    """Base of all services; subclasses set `name` and bind methods by the decorators above."""

    name: ClassVar[str]
    """The service's name, as in `health/<name>`."""
    all_robots: ClassVar[bool] = False
    """Whether it listens to the clocks of all robots."""
    one_per_host: ClassVar[bool] = False
    """Whether each host may run one of its own, told apart by the host's name in `health`."""
    hears_apart: ClassVar[bool] = False
    """Whether a flood of what it watches must not delay what it is asked, such as a stop."""
    own_time: TimeSource | None = None
    """Set in `__init__` by the service that owns robot time (`base`); the others follow `clock`."""
    is_spent: bool = False
    """Set by a service that should begin anew as a fresh program in the same process: what large
    libraries have taken is given back only so."""
    parts: tuple[object, ...] = ()
    """Set in `__init__`: the objects whose decorated methods are bound after the service's own."""

    _wire: Wire
    _host: Host
    _saves: Saves

    def bind(self, wire: Wire, host: Host) -> None:
        """Connect the service to a bus and a host (called by the runtime)."""
        self._wire, self._host = wire, host
        self._saves = Saves(host.state, lambda fn, then: self.work(fn, then))

    def prepare(self) -> None:
        """Called once before anything is watched or served, for slow things such as compiling.

        Until it is done, requests fail at once with `not_ready`.
        """

    def start(self) -> None:
        """Called once when all is bound, before any other method: watch topics, read state."""

    def stop(self) -> None:
        """Called once at the end, also on SIGTERM: publish and save what is still to be."""

    def epoch_began(self) -> None:
        """Called when `base` began a new run: what was measured before it no longer counts."""

    # What it knows.
    @property
    def robot(self) -> str:
        """The robot's name."""
        return self._wire.context.robot

    @property
    def now_ns(self) -> int | None:
        """Robot time [ns], None while unknown."""
        return self._wire.context.clocks.own.now(self._host.monotonic_ns())

    @property
    def stamp_ns(self) -> int:
        """Robot time for a message's stamp: 0 while unknown."""
        return self.now_ns or 0

    @property
    def epoch_ns(self) -> int:
        """Robot time [ns] at which the present run of `base` began."""
        return self._wire.context.clocks.own.epoch

    @property
    def monotonic_ns(self) -> int:
        """The local monotonic clock [ns] (simulated in lock-step)."""
        return self._host.monotonic_ns()

    @property
    def since_boot_ns(self) -> int:
        """Time since the computer was started [ns], which goes on while it sleeps."""
        return self._host.since_boot_ns()

    @property
    def arrived_ns(self) -> int:
        """Local monotonic time at which the message in hand arrived."""
        return self._wire.context.inbox.arrived_ns

    def time_of(self, robot: str) -> TimeSource:
        """The clock of another robot (only where `all_robots` is set)."""
        return self._wire.context.clocks.of(robot)

    @property
    def unix_ns(self) -> int:
        """The host's clock [ns since 1970], synchronised or not (0 at the start of lock-step)."""
        return self._host.unix_ns()

    def utc_now(self) -> str | None:
        """UTC as ISO 8601, None until the host's clock is synchronised (and in lock-step)."""
        return self._host.utc_now()

    def new_id(self) -> str:
        """A fresh id of 12 characters [a-z0-9] (from the seed in lock-step)."""
        return self._host.new_id()

    @property
    def state(self) -> StateFolder:
        """The folder of this robot's state."""
        return self._host.state

    @property
    def maps(self) -> StateFolder:
        """The folder of this host's maps."""
        return self._host.maps

    @property
    def log(self) -> Log:
        """The structured log: `self.log.info("Map loaded", map=name)`."""
        return self._wire.context.log

    # What it does.
    def publish(self, topic: Topic[M], message: M, *parts: str, robot: str | None = None) -> None:
        """Publish a message and keep it for `get`; `parts` fill the topic's varying chunks."""
        self._wire.server.publish(topic, message, parts, robot)

    def publish_if_heard(self, topic: Topic[M], make: Callable[[], M], *parts: str) -> None:
        """Publish what `make()` returns on a sensor stream, if anybody listens.

        Where nobody does it is made when it is asked for, which may be long after: `make` reads
        nothing that changes unless a newer value is as good.
        """
        self._wire.server.publish_if_heard(topic, make, parts)

    def withdraw(self, topic: Topic[Any], *parts: str) -> None:
        """Stop answering `get` of a topic until it is published again: another owns it now."""
        self._wire.server.withdraw(topic, parts)

    def put_wish(
        self, topic: Topic[M], message: M | None, *parts: str, robot: str | None = None
    ) -> None:
        """Ask the owner of a stored key to store `message`, or to delete it (None)."""
        self._wire.server.put_wish(topic, message, parts, robot)

    def watch(
        self,
        topic: Topic[M],
        *parts: str,
        seconds: float = 0.0,
        robot: str | None = None,
        then: Callable[..., None] | None = None,
    ) -> Watch[M]:
        """Keep what is known of a topic; `parts`, `robot` and `then` are as for `on`."""
        return self._wire.receiver.watch(topic, parts, seconds, robot, then)

    def close_watch(self, watch: Watch[Any]) -> None:
        """Stop watching."""
        self._wire.receiver.close(watch)

    def request(
        self,
        request: Request[P, R],
        params: P,
        then: Callable[[R | Refused], None],
        timeout_s: float = 2.0,
        robot: str | None = None,
    ) -> None:
        """Ask another service; `then` gets its reply or refusal (`not_ready` if nobody answers)."""

        def finish(replies: list[Reply], timed_out: bool) -> None:
            then(outcome(request, replies, timed_out))

        self._wire.context.ask(
            f"{request.key(robot or self.robot)}?format=msgpack",
            timeout_s,
            finish,
            codec.encode_parameters(params),
            codec.MIME["msgpack"],
        )

    def get(
        self,
        topic: Topic[M],
        *parts: str,
        then: Callable[[dict[tuple[str, ...], M]], None],
        robot: str | None = None,
    ) -> None:
        """Read the latest values of a topic from its owner; `then` gets them by varying chunks."""
        self._wire.receiver.get(topic, robot or self.robot, parts, then)

    @overload
    def work(self, fn: Callable[[], object]) -> None: ...
    @overload
    def work(self, fn: Callable[[], T], then: Callable[[T], None]) -> None: ...
    def work(self, fn: Callable[[], Any], then: Callable[[Any], None] | None = None) -> None:
        """Run `fn` in the background (at once in lock-step), then `then` with its result.

        Jobs run one after another. `fn` may touch files, but nothing of the service. An exception
        of `fn` that `then` should see is returned by `fn` as a value.
        """
        inbox = self._wire.context.inbox

        def hand_over(result: Any) -> None:
            if then is not None:
                then(result)

        def done(result: Any) -> None:
            inbox.push(lambda _: hand_over(result), own=True)

        self._host.work(fn, done)

    def save(
        self,
        name: str,
        value: msgspec.Struct,
        then: Callable[[OSError | None], None] | None = None,
        *,
        is_secret: bool = False,
    ) -> None:
        """Write a state file in the background, whole or not at all; `then` gets None or an error.

        A value that was superseded while it waited is not written; its `then` hears of the newer.
        Without `then` a failure is counted as `state/not_saved` and logged.
        """
        heard = then or partial(self.say_not_saved, name)
        self._saves.save(name, value, heard, is_secret=is_secret)

    def say_not_saved(self, name: str, error: OSError | None) -> None:
        """Count and log that a state file was not written, if so: for a `then` of `save`."""
        if error is not None:
            self.count("state/not_saved")
            self.log.limited(name, "Not saved", file=name, why=error.strerror)

    def call_soon(
        self, fn: Callable[[], None], *, urgent: bool = False, kept: bool = False
    ) -> None:
        """Call `fn` on the service's thread; the one method that any other thread may call.

        Calls keep their order; an `urgent` one goes before everything that waits. Where thousands
        of arrivals wait already, a call is dropped and counted as `inbox/dropped`, but not one that
        is `kept`: who makes it sees to it that only few wait.
        """
        self._wire.context.inbox.push(lambda _: fn(), urgent=urgent, own=kept)

    def deadline(self, call: Callable[[], None]) -> Deadline:
        """Return a deadline that calls back once it is set and not cleared in time."""
        context = self._wire.context
        return context.timers.deadline(context.inbox.now_ns, call)

    def later(self) -> Later[Any]:
        """Return this from a request's method to answer it within 2 s."""
        return Later()

    def count(self, name: str, number: int = 1) -> None:
        """Add to a counter of `health`."""
        self._wire.context.count(name, number)

    def set_figure(self, name: str, value: float) -> None:
        """Set a figure of `health`: something that the service measures of itself now."""
        self._wire.context.figures[name] = value

    def set_health(self, state: Literal["ok", "degraded", "failed"], message: str = "") -> None:
        """Set state and message of `health`; state files that could not be read are named there."""
        problems = self.state.problems.values()
        if problems and state == "ok":
            state = "degraded"
        self._wire.health.set(state, " ".join([*filter(None, [message]), *problems]))
