"""What the sources of overlays and plots say now: subscribed to only while somebody wants them."""

from collections.abc import Callable, Iterable, Set
from dataclasses import dataclass, field
from typing import Any

import msgspec

from trolley.geometry import MissingLink
from trolley.geometry.relation import Frames, Relation, relation
from trolley.runtime.service import Watch
from trolley.topics import Topic
from trolley_viz.overlays.history import History
from trolley_viz.overlays.source import (
    BadSource,
    FieldSource,
    FrameSource,
    Source,
    Value,
    parse_source,
    read_field,
)
from trolley_viz.robots.frames import why_nowhere

SILENT_NS = 3_000_000_000
"""What is published all the time and has been silent for so long is called dead."""
SAMPLE_NS = 100_000_000
"""How often distance and bearing are taken [ns]."""

OpenWatch = Callable[[Topic[Any], tuple[str, ...], Callable[..., None]], Watch[Any]]
"""Watches a topic and calls back with each message, none left out."""


@dataclass
class Reading:
    """What is known of one source."""

    source: Source | None
    """None: it cannot be understood."""
    problem: str = ""
    """Why there is no value, in one sentence."""
    value: Value = None
    arrived_ns: int | None = None
    """Local monotonic time of the newest value."""
    relation: Relation | None = None
    """Relation of the two frames."""
    history: History = field(default_factory=History)

    def age_s(self, now_ns: int) -> float | None:
        """For how long nothing has come [s]; None while nothing ever did."""
        return None if self.arrived_ns is None else (now_ns - self.arrived_ns) * 1e-9

    def is_silent(self, now_ns: int, silent: Set[str] = frozenset(), *, is_away: bool) -> bool:
        """Whether what should go on coming has stopped; `silent` services say nothing more."""
        source = self.source
        if self.arrived_ns is None:
            return False
        goes_on = not isinstance(source, FieldSource) or source.is_periodic or is_away
        if isinstance(source, FieldSource) and source.topic.first_owner in silent:
            goes_on = True
        return goes_on and now_ns - self.arrived_ns > SILENT_NS


class Readings:
    """The sources that are wanted now, of one robot.

    Args:
        open_watch: subscribes.
        close_watch: ends a subscription.
        arrived_ns: local monotonic time at which the message in hand arrived.
    """

    def __init__(
        self,
        open_watch: OpenWatch,
        close_watch: Callable[[Watch[Any]], None],
        arrived_ns: Callable[[], int],
    ) -> None:
        self._open = open_watch
        self._close = close_watch
        self._arrived_ns = arrived_ns
        self._readings: dict[str, Reading] = {}
        self._watches: dict[tuple[str, tuple[str, ...]], Watch[Any]] = {}
        self._sampled_ns: int | None = None

    def follow(self, texts: Iterable[str]) -> None:
        """Follow exactly these sources from now on; what is known of the others is forgotten."""
        wanted = set(texts)
        for text in self._readings.keys() - wanted:
            del self._readings[text]
        for text in wanted - self._readings.keys():
            self._readings[text] = _new_reading(text)
        needed = {
            (one.source.topic.name, one.source.parts): one.source
            for one in self._readings.values()
            if isinstance(one.source, FieldSource)
        }
        for key in self._watches.keys() - needed.keys():
            self._close(self._watches.pop(key))
        for key in needed.keys() - self._watches.keys():
            topic, parts = needed[key].topic, needed[key].parts

            def take(message: msgspec.Struct, *_: str, key: Any = key) -> None:
                self._hear(key, message)

            self._watches[key] = self._open(topic, parts, take)

    def drop_all(self) -> None:
        """Follow nothing and forget everything."""
        self.follow(())

    def of(self, text: str) -> Reading:
        """What is known of a source that is wanted."""
        return self._readings[text]

    def frames_wanted(self) -> set[str]:
        """The frames that sources tell of."""
        sources = [one.source for one in self._readings.values()]
        pairs = [one for one in sources if isinstance(one, FrameSource)]
        return {name for one in pairs for name in (one.parent, one.child)}

    def is_sampling_due(self, now_ns: int) -> bool:
        """Whether distances and bearings are to be taken again."""
        return self._sampled_ns is None or now_ns - self._sampled_ns >= SAMPLE_NS

    def sample(self, frames: Frames, now_ns: int) -> None:
        """Take distances and bearings."""
        self._sampled_ns = now_ns
        for reading in self._readings.values():
            if isinstance(reading.source, FrameSource):
                _measure(reading, reading.source, frames, now_ns)

    def _hear(self, key: tuple[str, tuple[str, ...]], message: msgspec.Struct) -> None:
        now_ns = self._arrived_ns()
        for reading in self._readings.values():
            source = reading.source
            if not isinstance(source, FieldSource) or (source.topic.name, source.parts) != key:
                continue
            try:
                reading.value, reading.problem = read_field(source, message), ""
            except BadSource as problem:
                reading.value, reading.problem = None, str(problem)
            reading.arrived_ns = now_ns
            number = None if isinstance(reading.value, str) else reading.value
            reading.history.add(now_ns, getattr(message, "stamp_ns", 0), number)


def _new_reading(text: str) -> Reading:
    try:
        return Reading(parse_source(text))
    except BadSource as problem:
        return Reading(None, str(problem))


def _measure(reading: Reading, source: FrameSource, frames: Frames, now_ns: int) -> None:
    try:
        found = relation(frames, source.parent, source.child)
    except MissingLink as missing:
        reading.relation, reading.value = None, None
        reading.problem = why_nowhere(frames, missing)
        return
    if found.stale:  # the last value stays, and ages
        return
    reading.relation, reading.problem = found, ""
    reading.value = found.distance if source.what == "distance" else found.bearing
    reading.arrived_ns = now_ns
    reading.history.add(now_ns, frames.now_ns or 0, reading.value)
