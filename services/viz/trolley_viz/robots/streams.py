"""The streams of one robot, subscribed to only while something that is shown needs them."""

from collections.abc import Callable, Iterable
from typing import Any, TypeVar

import msgspec

from trolley import topics
from trolley.runtime.service import Watch
from trolley.topics import Topic

M = TypeVar("M", bound=msgspec.Struct)

HISTORY_S: dict[str, float] = {
    topics.ODOM.name: 2.0,
    topics.SCAN.name: 0.6,
    topics.SIM_TRUTH.name: 1.0,
}
"""Topics of which more than the newest message is needed, and how much [s]."""

OpenWatch = Callable[[Topic[Any], float], Watch[Any]]
CloseWatch = Callable[[Watch[Any]], None]


class Streams:
    """Watches by topic, opened and closed on demand."""

    def __init__(self, open_watch: OpenWatch, close_watch: CloseWatch) -> None:
        self._open = open_watch
        self._close = close_watch
        self._watches: dict[str, Watch[Any]] = {}

    def follow(self, wanted: Iterable[Topic[Any]]) -> None:
        """Watch exactly these topics from now on."""
        by_name = {topic.name: topic for topic in wanted}
        for name in self._watches.keys() - by_name.keys():
            self._close(self._watches.pop(name))
        for name in sorted(by_name.keys() - self._watches.keys()):
            self._watches[name] = self._open(by_name[name], HISTORY_S.get(name, 0.0))

    def drop_all(self) -> None:
        """Stop watching and forget everything."""
        self.follow(())

    def watch(self, topic: Topic[M]) -> Watch[M] | None:
        """All that is known of a topic, None while it is not watched."""
        return self._watches.get(topic.name)

    def names(self) -> list[str]:
        """The topics being watched, sorted."""
        return sorted(self._watches)

    def latest(self, topic: Topic[M]) -> M | None:
        """The newest message of a topic, None if there is none or it is not watched."""
        watch = self._watches.get(topic.name)
        return None if watch is None else watch.latest

    def arrived_ns(self, topic: Topic[Any]) -> int | None:
        """Local monotonic time [ns] at which the newest message arrived."""
        watch = self._watches.get(topic.name)
        return None if watch is None else watch.arrived_ns

    def arrived_by_parts(self, topic: Topic[Any]) -> dict[tuple[str, ...], int]:
        """Local monotonic time [ns] of the newest arrival per varying chunk."""
        watch = self._watches.get(topic.name)
        if watch is None:
            return {}
        arrivals = {parts: watch.arrived(parts) for parts in watch.by_parts}
        return {parts: at for parts, at in arrivals.items() if at is not None}

    def counts(self) -> dict[str, int]:
        """How many messages of each watched topic arrived so far."""
        return {name: watch.count for name, watch in sorted(self._watches.items())}

    def history(self, topic: Topic[M]) -> list[M]:
        """The last messages of a topic, oldest first; see `HISTORY_S`."""
        watch = self._watches.get(topic.name)
        return [] if watch is None else list(watch.history)

    def by_parts(self, topic: Topic[M]) -> dict[tuple[str, ...], M]:
        """The newest message per varying chunk."""
        watch = self._watches.get(topic.name)
        return {} if watch is None else watch.by_parts
