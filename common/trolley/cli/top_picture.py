"""What `trolley top` shows, as lines of text: services and topics of robots at one moment."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Literal

from trolley import topics
from trolley.cli.columns import Column, table_lines
from trolley.messages import Health
from trolley.sanitize import sanitize
from trolley.traffic import Expected, Flow, expected

Order = Literal["bytes", "rate", "name"]
SILENT_S = 3.0
"""Time without `health` after which a service hangs, or its connection is lost [s]."""
GONE_S = 30.0
"""Topics that have been silent longer are not listed unless they should come."""
LOW, HIGH = 0.7, 1.5
LONGEST_NAME = 40
KEYS = "q quit, b bytes first, r rate first, n by name"

SERVICE_COLUMNS = (
    Column("SERVICE", is_number=False),
    Column("STATE", 9, is_number=False),
    Column("CPU", 8),
    Column("MEMORY", 7),
    Column("UP", 6),
    Column("RESTARTS", 5),
    Column("HEALTH", 4),
)
TOPIC_COLUMNS = (
    Column("TOPIC", is_number=False),
    Column("RATE", 9),
    Column("EXPECTED", 6),
    Column("AGE", 8),
    Column("BYTES/S", 7),
)


@dataclasses.dataclass(frozen=True)
class ServiceView:
    """A service of a robot."""

    robot: str
    name: str
    is_alive: bool
    health: Health | None
    flow: Flow | None
    """Flow of its `health`."""
    restarts: int = 0

    @property
    def up_s(self) -> float | None:
        """How long it has been running, None where it does not tell, or is gone."""
        return self.health.up if self.health is not None and self.is_alive else None

    @property
    def state(self) -> str:
        """How it is, in a word."""
        if not self.is_alive:
            return "gone"
        if self.health is None:
            return "starting"
        if self.flow is None or self.flow.age_s > SILENT_S:
            return "silent"
        return self.health.state


@dataclasses.dataclass(frozen=True)
class TopicView:
    """A topic of a robot."""

    robot: str
    name: str
    flow: Flow
    wanted: Expected

    @property
    def is_wrong(self) -> bool:
        """Whether it comes too rarely or too often."""
        low, high = self.wanted.low, self.wanted.high
        too_few = low is not None and self.flow.hz < LOW * low - 0.5
        return too_few or (high is not None and self.flow.hz > HIGH * high + 0.5)


@dataclasses.dataclass(frozen=True)
class Picture:
    """Robots at one moment."""

    sentences: Mapping[str, str]
    """What each robot does."""
    services: Sequence[ServiceView]
    topics: Sequence[TopicView]


def topic_views(
    flows: Mapping[str, Flow], rates: Mapping[str, float], order: Order
) -> list[TopicView]:
    """The streams among what was heard, in an order.

    Args:
        flows: what was heard, by key.
        rates: how many of its seconds pass in a real one, by robot.
        order: what comes first.
    """
    found: list[TopicView] = []
    for key, flow in flows.items():
        row = topics.find(key)
        if row is None:
            continue
        topic, robot, _ = row
        wanted = Expected() if topic.when_driving else expected(topic)
        if wanted.is_each_scan:
            scan = flows.get(topics.SCAN.key(robot))
            wanted = Expected(low=None if scan is None else round(scan.hz, 1))
        elif not topic.real_time:
            wanted = _times(wanted, rates.get(robot, 1.0))
        if flow.age_s < GONE_S or wanted.low is not None:
            name = "/".join(key.split("/")[2:])
            found.append(TopicView(robot, name, flow, wanted))
    return sorted(found, key=lambda one: (_rank(one, order), one.robot, one.name))


def _rank(one: TopicView, order: Order) -> float:
    return {"bytes": -one.flow.bytes_per_s, "rate": -one.flow.hz, "name": 0.0}[order]


def _times(wanted: Expected, rate: float) -> Expected:
    """The rate in real seconds: a simulation may run faster or slower."""
    if rate == 1.0:
        return wanted
    return Expected(
        None if wanted.low is None else round(wanted.low * rate, 1),
        None if wanted.high is None else round(wanted.high * rate, 1),
    )


def lines_of(picture: Picture, width: int, height: int | None) -> list[tuple[str, str | None]]:
    """The lines with their colours; `height` None: as many as there are."""
    lines: list[tuple[str, str | None]] = []
    for robot, sentence in picture.sentences.items():
        lines.append((sanitize(f"{robot}: {sentence}", width), None))
    several = len(picture.sentences) > 1
    lines += [("", None), *_service_lines(picture.services, width, several=several)]
    lines += [("", None), *_topic_lines(picture.topics, width, several=several)]
    if height is None or len(lines) <= height - 1:
        return lines if height is None else [*lines, (KEYS[:width], "bright_black")]
    hidden = len(lines) - (height - 1)
    return [*lines[: height - 1], (f"{hidden} more lines; {KEYS}"[:width], "bright_black")]


def _service_lines(
    services: Sequence[ServiceView], width: int, *, several: bool
) -> list[tuple[str, str | None]]:
    rows = [
        (
            _name(one.robot, one.name, several=several),
            one.state,
            "-" if one.health is None else f"{one.health.cpu:.0%}",
            "-" if one.health is None else f"{one.health.rss / 1e6:.0f} MB",
            "-" if one.up_s is None else short_time(one.up_s),
            str(one.restarts),
            "-" if one.flow is None else f"{one.flow.hz:.1f}/s",
        )
        for one in services
    ]
    head, lines = table_lines(SERVICE_COLUMNS, rows, width)
    colours = [
        None
        if one.state == "ok"
        else "red"
        if one.state in ("gone", "silent", "failed")
        else "yellow"
        for one in services
    ]
    return [(head, "bright_black"), *zip(lines, colours, strict=True)]


def _topic_lines(
    views: Sequence[TopicView], width: int, *, several: bool
) -> list[tuple[str, str | None]]:
    rows = [
        (
            _name(one.robot, one.name, several=several),
            f"{one.flow.hz:.1f}/s",
            str(one.wanted),
            short_time(one.flow.age_s),
            short_bytes(one.flow.bytes_per_s),
        )
        for one in views
    ]
    head, lines = table_lines(TOPIC_COLUMNS, rows, width)
    return [
        (head, "bright_black"),
        *((line, "red" if one.is_wrong else None) for line, one in zip(lines, views, strict=True)),
    ]


def _name(robot: str, name: str, *, several: bool) -> str:
    return sanitize(f"{robot}/{name}" if several else name, LONGEST_NAME)


def short_time(seconds: float) -> str:
    """A duration in few letters."""
    if seconds < 10.0:
        return f"{seconds:.1f} s"
    if seconds < 120.0:
        return f"{seconds:.0f} s"
    if seconds < 2 * 3600.0:
        return f"{seconds / 60.0:.0f} min"
    return f"{seconds / 3600.0:.0f} h" if seconds < 48 * 3600.0 else f"{seconds / 86_400.0:.0f} d"


def short_bytes(number: float) -> str:
    """An amount of bytes in few letters."""
    for unit, size in (("MB", 1e6), ("kB", 1e3)):
        if number >= size:
            amount = number / size
            return f"{amount:.1f} {unit}" if amount < 10.0 else f"{amount:.0f} {unit}"
    return f"{number:.0f} B"
