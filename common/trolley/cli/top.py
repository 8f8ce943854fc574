"""`trolley top`: services and topics live, as `top` shows processes."""

import shutil
import sys
import threading
import time
from collections import deque
from collections.abc import Mapping
from typing import Any, TypeVar

import click
import msgspec

from trolley import topics
from trolley.cli import exits
from trolley.cli.options import given, json_option, where_options
from trolley.cli.printing import say
from trolley.cli.robot_sentence import robot_sentence
from trolley.cli.robots import reports_errors
from trolley.cli.show import Progress, print_json
from trolley.cli.terminal import Terminal, TerminalGone
from trolley.cli.top_picture import (
    SILENT_S,
    Order,
    Picture,
    ServiceView,
    lines_of,
    topic_views,
)
from trolley.client import STALE_AFTER_S
from trolley.connection import GET_TIMEOUT_S, Connection, RobotUnreachable, find_target
from trolley.doctor.computer_facts import Host
from trolley.doctor.units import read_units
from trolley.runtime import codec
from trolley.runtime.bus import Reply, has_wildcard
from trolley.topics import Topic
from trolley.traffic import Flow, Tally, Traffic, flows

M = TypeVar("M", bound=msgspec.Struct)

PERIOD_S = 0.5
WINDOW_S = 3.0
"""Rates are those of so long a time."""
MOST_RUNS = 1000
CTRL_C, CTRL_Z = b"\x03", b"\x1a"
ORDERS: dict[bytes, Order] = {b"b": "bytes", b"r": "rate", b"n": "name"}


class Watcher:
    """Counts what robots publish and which services come and go.

    Args:
        connection: to their router.
        robot: the robot to watch, None for all.
        units_restarts: how often systemd has started each service of this host again.
    """

    def __init__(
        self, connection: Connection, robot: str | None, units_restarts: Mapping[str, int]
    ) -> None:
        self._traffic = Traffic()
        self._known: dict[str, Tally] = {}
        """What was said last before it began to listen."""
        self._past: deque[tuple[float, dict[str, Tally]]] = deque([(time.monotonic(), {})])
        self._lock = threading.Lock()
        self._alive: dict[tuple[str, str], set[str]] = {}
        self._seen: dict[tuple[str, str], set[str]] = {}
        self._units_restarts = units_restarts
        wanted = robot or "*"
        self._closers = [
            connection.listen("/".join((topics.ROOT, wanted, "**")), self._traffic.take),
            connection.bus.watch_tokens(topics.ALIVE.key(wanted), self._see),
        ]
        # Paused, over or idle, these are not said again.
        for topic in (topics.GOAL, topics.TOUR):
            selector = f"{topic.key(wanted)}?format=msgpack"
            connection.bus.get(selector, b"", "", GET_TIMEOUT_S, self._keep, lambda: None)

    def close(self) -> None:
        """Stop listening."""
        for closer in self._closers:
            closer.close()

    def _keep(self, reply: Reply) -> None:
        if not reply.is_error:
            self._known[reply.key] = Tally(last=(reply.payload, reply.encoding))

    def _see(self, key: str, is_there: bool) -> None:
        row = topics.ALIVE.match(key)
        if row is None or has_wildcard(key):
            return
        robot, (service, run) = row
        with self._lock:
            alive = self._alive.setdefault((robot, service), set())
            seen = self._seen.setdefault((robot, service), set())
            if not is_there:
                alive.discard(run)
            elif len(seen) < MOST_RUNS:
                alive.add(run)
                seen.add(run)

    def look(self, order: Order) -> Picture:
        """What there is now."""
        now_s, tallies = time.monotonic(), self._traffic.so_far()
        self._past.append((now_s, tallies))
        while len(self._past) > 2 and now_s - self._past[1][0] >= WINDOW_S:
            self._past.popleft()
        then_s, before = self._past[0]
        flowing = flows(before, tallies, max(now_s - then_s, 1e-3), now_s)
        services = self._services(tallies, flowing)
        robots = sorted({one.robot for one in services})
        clocks = {robot: _newest(tallies, topics.CLOCK, robot) for robot in robots}
        rates = {robot: clock.rate for robot, clock in clocks.items() if clock is not None}
        sentences = {robot: sentence_of(self._known | tallies, robot, now_s) for robot in robots}
        return Picture(sentences, services, topic_views(flowing, rates, order))

    def _services(
        self, tallies: Mapping[str, Tally], flowing: Mapping[str, Flow]
    ) -> list[ServiceView]:
        with self._lock:
            alive = {who: sorted(runs) for who, runs in self._alive.items()}
            seen = {who: len(runs) for who, runs in self._seen.items()}
        return [
            ServiceView(
                robot,
                service,
                bool(runs),
                _newest(tallies, topics.HEALTH, robot, service),
                flowing.get(topics.HEALTH.key(robot, service)),
                max(0, seen[robot, service] - 1) + self._units_restarts.get(service, 0),
            )
            for (robot, service), runs in sorted(alive.items())
        ]


def _newest(tallies: Mapping[str, Tally], topic: Topic[M], robot: str, *parts: str) -> M | None:
    tally = tallies.get(topic.key(robot, *parts))
    if tally is None or tally.last is None:
        return None
    try:
        return codec.decode(topic.message, *tally.last)
    except codec.BadPayload:
        return None


def sentence_of(tallies: Mapping[str, Tally], robot: str, now_s: float) -> str:
    """What a robot does, by what was heard of it until `now_s` (local monotonic clock)."""
    pose_tally = tallies.get(topics.POSE.key(robot))
    is_stale = pose_tally is not None and now_s - pose_tally.last_s > STALE_AFTER_S
    base_tally = tallies.get(topics.BASE.key(robot))
    is_heard = base_tally is not None and now_s - base_tally.last_s < SILENT_S
    return robot_sentence(
        _newest(tallies, topics.BASE, robot) if is_heard else None,
        _newest(tallies, topics.POSE, robot),
        _newest(tallies, topics.GOAL, robot),
        _newest(tallies, topics.TOUR, robot),
        is_stale=is_stale,
    )


@click.command(name="top")
@click.option("--all", "everybody", is_flag=True, help="All robots of the network.")
@click.option("--once", is_flag=True, help="Measure once, print the result, and exit.")
@click.option(
    "--sort",
    "order",
    type=click.Choice(("bytes", "rate", "name")),
    default="bytes",
    show_default=True,
    help="Which topics come first.",
)
@where_options
@json_option
@reports_errors
def top_command(everybody: bool, once: bool, order: Order, as_json: bool) -> None:
    """Watch services and topics live: rates, age, processor, memory, restarts.

    If no robot is named, all on the network are shown. RESTARTS counts the restarts seen while
    watching and those by this computer's systemd. Without a terminal it measures once.
    """
    target = find_target(given("robot"), given("connect"), given("config"))
    units = read_units(Host()) or []
    restarts = {unit.service: unit.restarts for unit in units}
    with Connection(target.endpoints) as connection:
        robot = None if everybody else target.robot
        if not connection.services(robot or "*"):
            if robot is not None:
                raise connection.unknown_robot(robot)
            where = ", ".join(target.endpoints)
            raise RobotUnreachable(f"no robot is on the network at {where}")
        watcher = Watcher(connection, robot, restarts)
        try:
            if once or as_json or not (sys.stdin.isatty() and sys.stdout.isatty()):
                _print_once(watcher, order, as_json=as_json)
            else:
                _show(watcher, order)
        finally:
            watcher.close()


def _print_once(watcher: Watcher, order: Order, *, as_json: bool) -> None:
    progress = Progress()
    progress.show(f"Listening for {WINDOW_S:g} s ...")
    time.sleep(WINDOW_S)
    picture = watcher.look(order)
    progress.clear()
    if as_json:
        print_json(_plain(picture))
        return
    for text, colour in lines_of(picture, shutil.get_terminal_size().columns, None):
        say(text, fg=colour)


def _plain(picture: Picture) -> dict[str, Any]:
    return {
        "robots": picture.sentences,
        "services": [
            {
                "robot": one.robot,
                "service": one.name,
                "state": one.state,
                "up_s": one.up_s,
                "restarts": one.restarts,
                "health": one.health,
            }
            for one in picture.services
        ],
        "topics": [
            {
                "robot": one.robot,
                "topic": one.name,
                "hz": round(one.flow.hz, 2),
                "expected": {"low": one.wanted.low, "high": one.wanted.high},
                "age_s": round(one.flow.age_s, 3),
                "bytes_per_s": round(one.flow.bytes_per_s, 1),
            }
            for one in picture.topics
        ],
    }


def _show(watcher: Watcher, order: Order) -> None:
    """Show live until `q`, Ctrl-C or a signal."""
    try:
        with Terminal(whole_screen=True) as terminal:
            while True:
                size = shutil.get_terminal_size()
                terminal.show(*lines_of(watcher.look(order), size.columns - 1, size.lines))
                keys = terminal.read(PERIOD_S)
                if CTRL_C in keys or terminal.ended_by is not None:
                    raise SystemExit(exits.INTERRUPTED)
                if b"q" in keys:
                    return
                if CTRL_Z in keys or terminal.wants_pause:
                    terminal.pause()
                for key, chosen in ORDERS.items():
                    order = chosen if key in keys else order
    except TerminalGone as gone:
        raise SystemExit(exits.INTERRUPTED) from gone
