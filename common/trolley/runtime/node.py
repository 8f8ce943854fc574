"""The engine between a bus and a service: arrivals become calls, and calls messages.

Both runtimes use it. Bus callbacks (on any thread) only store in the inbox; `step` runs on the one
thread that calls the service's methods.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, cast

from trolley import topics
from trolley.messages import Clock, Health
from trolley.requests import Request
from trolley.runtime.bindings import Binding, bindings_of
from trolley.runtime.bus import Bus
from trolley.runtime.clock_follower import ClockFollower
from trolley.runtime.context import Context
from trolley.runtime.health import HealthReporter
from trolley.runtime.host import Host
from trolley.runtime.inbox import Inbox
from trolley.runtime.log import Log
from trolley.runtime.receiving import Feed, Receiver, Watch
from trolley.runtime.robot_time import RobotClocks
from trolley.runtime.service import Service
from trolley.runtime.serving import Server
from trolley.runtime.wire import Wire
from trolley.topics import Topic

HEALTH_PERIOD_S = 1.0
"""How often health is published where nothing changes."""
MAX_TASKS = 256
"""How many arrivals one `step` handles at most."""
OTHERS_ARE_BACK_S = 2.0
"""After this long the other services have found a restarted router, too."""


class Node:
    """Runs one service on a bus: its life, its methods and its periods."""

    def __init__(
        self,
        service: Service,
        robot: str,
        bus: Bus,
        host: Host,
        label: str | None = None,
        run: str = "",
    ) -> None:
        self.service = service
        self.inbox = Inbox(host.monotonic_ns)
        label = label or service.name
        clocks = RobotClocks(robot, service.own_time)
        self._own_time = clocks.own
        self._context = Context(robot, bus, self.inbox, Log(label), clocks)
        self._bindings = bindings_of(service, *service.parts)
        owned = {binding.topic for binding, _ in self._bindings if binding.kind == "gets"}
        self._receiver = Receiver(self._context, owned)
        self._clock_follower = ClockFollower(self._context, self._begin_epoch)
        self._clock: Watch[Clock] = Watch(topics.CLOCK, 0.0)
        self._server = Server(self._context)
        self._health = HealthReporter(self._context, self._server, label, host.usage, run)
        service.bind(Wire(self._context, self._receiver, self._server, self._health), host)

    @property
    def counters(self) -> dict[str, int]:
        """What the service counted."""
        return self._context.counters

    @property
    def health(self) -> Health:
        """What the service last said about itself."""
        return self._health.latest

    def open(self) -> None:
        """Start the service: `prepare`, then watches, requests and periods, then `start`."""
        service = self.service
        service.prepare()
        if service.own_time is None or service.all_robots:
            robots = "*" if service.all_robots else None
            self._receiver.open(Feed(self._clock, robots, (), then=self._follow_clock))
        for binding, method in self._bindings:
            self._open_binding(binding, method)
        service.start()
        if self._health.latest.state == "starting":
            service.set_health("ok")
        self._context.timers.every(HEALTH_PERIOD_S, self._look_after_itself, is_local=True)

    def close(self) -> None:
        """Let the service stop, and take everything off the bus."""
        self.service.stop()
        self.silence()

    def silence(self) -> None:
        """Take everything off the bus at once, as when the process dies."""
        self._server.close()
        self._receiver.close()

    def reconnected(self) -> None:
        """The bus is back (any thread): read again what was missed.

        Once more when the others, who look for the router at their own pace, are back as well.
        """

        def catch_up(_arrived_ns: int) -> None:
            self._receiver.catch_up()
            self._context.after(OTHERS_ARE_BACK_S, self._receiver.catch_up)

        self.inbox.push(catch_up, own=True)

    def step(self) -> bool:
        """Do what waits and is due, a limited number of things at once; True if anything was."""
        did = False
        for _ in range(MAX_TASKS):  # whoever calls has its own things to look after
            entry = self.inbox.pop()
            if entry is None:
                break
            task, arrived_ns = entry
            task(arrived_ns)
            did = True
            self._run_timers()  # a flood of messages must not starve the periods
        return did or self._run_timers()

    def next_due_ns(self) -> int:
        """Local monotonic time [ns] at which to step again."""
        context = self._context
        return context.timers.next_due_ns(self.inbox.now_ns(), self._own_time)

    def _open_binding(self, binding: Binding, method: Callable[..., Any]) -> None:
        match binding:
            case Binding(kind="every"):
                is_local = binding.clock == "local"
                timers, owner = self._context.timers, cast("Any", method).__self__
                when = (lambda: True) if binding.when is None else partial(binding.when, owner)
                timers.every(binding.seconds, method, is_local=is_local, when=when)
            case Binding(kind="answers", request=Request() as request):
                self._server.open_request(request, method)
            case Binding(kind="gets", topic=Topic() as topic):
                self._server.open_gets(topic, binding.parts, method)
            case Binding(kind="on", topic=Topic() as topic):
                watch = self._receiver.watch(topic, binding.parts, robot=binding.robot, then=method)
                watch.wakes = binding.wakes
            case Binding(topic=Topic() as topic):
                feed = Feed(Watch(topic, 0.0), None, binding.parts, on_delete=method)
                self._receiver.open(feed)
            case _:
                raise TypeError(f"{method.__qualname__}: a binding without topic or request")

    def _follow_clock(self, clock: Clock, robot: str | None = None) -> None:
        self._clock_follower.hear(robot or self._context.robot, clock, self.inbox.arrived_ns)
        self._clock.wakes = not self._has_time

    def _begin_epoch(self, robot: str, epoch_ns: int) -> None:
        self._receiver.forget_epoch(robot, epoch_ns)
        if robot == self._context.robot:
            self.service.epoch_began()

    @property
    def _has_time(self) -> bool:
        """Whether robot time runs: then one `clock` more can wait for something else to do."""
        return self._own_time.now(self.inbox.now_ns()) is not None

    def _look_after_itself(self) -> None:
        self._clock.wakes = not self._has_time
        self._server.restore_overwritten()
        self._health.measure()

    def _run_timers(self) -> bool:
        return self._context.timers.run(self.inbox.now_ns, self._own_time)
