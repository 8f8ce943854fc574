"""The receiving half of a node: watches fed from the bus, everything validated before it counts."""

import dataclasses
import unicodedata
from collections.abc import Callable
from typing import Any

from trolley import topics
from trolley.codes import Refused
from trolley.runtime import codec
from trolley.runtime.bus import Bus, Closer, Reply, Sample, has_wildcard
from trolley.runtime.gathering import Gathering
from trolley.runtime.inbox import Inbox
from trolley.runtime.log import Log
from trolley.runtime.robot_time import TimeSource
from trolley.runtime.service import Watch
from trolley.topics import Kind, Qos, Topic

GET_TIMEOUT_S = 2.0


@dataclasses.dataclass(frozen=True)
class Context:
    """What the halves of a node share."""

    robot: str
    bus: Bus
    inbox: Inbox
    log: Log
    count: Callable[[str], None]
    time_of: Callable[[str], TimeSource]
    after: Callable[[float, Callable[[], None]], None]


@dataclasses.dataclass
class Watching:
    """A watch and how it is fed."""

    watch: Watch[Any]
    robot: str | None
    parts: tuple[str, ...]
    then: Callable[..., None] | None = None
    on_delete: Callable[..., None] | None = None
    closer: Closer | None = None

    @property
    def is_wish(self) -> bool:
        """Whether it takes wishes to store something: these have no latest value to read."""
        return self.watch.topic.kind is Kind.STORED


class Receiver:
    """Subscribes, decodes, drops what is invalid or of an earlier run, and calls the handlers."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._watching: list[Watching] = []

    def open(self, watching: Watching) -> None:
        """Subscribe, then read what is there already."""
        context, topic = self._context, watching.watch.topic
        newest_only = topic.qos is not Qos.STATE and not watching.watch.keeps_history

        def receive(sample: Sample) -> None:
            slot = (id(watching), sample.key) if newest_only else None
            context.inbox.push(lambda arrived_ns: self._take(watching, sample, arrived_ns), slot)

        key = topic.key(watching.robot or context.robot, *watching.parts)
        watching.closer = context.bus.subscribe(key, receive)
        self._watching.append(watching)
        self._catch_up(watching)

    def close(self, watch: Watch[Any] | None = None) -> None:
        """Stop one watch, or all."""
        for watching in [one for one in self._watching if watch is None or one.watch is watch]:
            self._watching.remove(watching)
            if watching.closer is not None:
                watching.closer.close()

    def catch_up(self) -> None:
        """Read again what may have been missed while the bus was away."""
        for watching in self._watching:
            self._catch_up(watching)

    def forget_epoch(self) -> None:
        """Drop what was measured in an earlier run of base."""
        for watching in self._watching:
            if watching.watch.topic.of_epoch and watching.robot is None:
                watching.watch.forget()

    def get(
        self,
        topic: Topic[Any],
        robot: str,
        parts: tuple[str, ...],
        then: Callable[[dict[tuple[str, ...], Any]], None],
    ) -> None:
        """Read latest values; what does not decode is counted and left out."""

        def finish(replies: list[Reply], _timed_out: bool) -> None:
            found: dict[tuple[str, ...], Any] = {}
            for reply in replies:
                matched = None if reply.is_error else topic.match(reply.key)
                if matched is None:
                    continue
                message = self._decode(topic, Sample(reply.key, reply.payload, reply.encoding))
                if message is not None:
                    found[matched[1]] = message
            then(found)

        self._ask(topic.key(robot, *parts), finish)

    def _ask(self, key: str, finish: Callable[[list[Reply], bool], None]) -> None:
        context = self._context
        gathering = Gathering(context.inbox, finish)
        context.after(GET_TIMEOUT_S, lambda: gathering.end(timed_out=True))
        context.bus.get(
            f"{key}?format=msgpack", b"", "", GET_TIMEOUT_S, gathering.add, gathering.done
        )

    def _catch_up(self, watching: Watching) -> None:
        """A late joiner subscribes, then gets, and keeps the newer."""
        topic = watching.watch.topic
        if topic.qos is not Qos.STATE or watching.is_wish:
            return

        def finish(replies: list[Reply], _timed_out: bool) -> None:
            for reply in replies:
                if not reply.is_error:
                    sample = Sample(reply.key, reply.payload, reply.encoding)
                    self._take(watching, sample, self._context.inbox.now_ns(), is_old=True)

        self._ask(topic.key(watching.robot or self._context.robot, *watching.parts), finish)

    def _take(
        self, watching: Watching, sample: Sample, arrived_ns: int, *, is_old: bool = False
    ) -> None:
        topic = watching.watch.topic
        if watching not in self._watching:
            return
        if sample.is_delete:
            self._take_delete(watching, sample)
            return
        matched = None if has_wildcard(sample.key) else topic.match(sample.key)
        if matched is None:
            self._drop(topic, "key", sample.key, "a key with a wildcard cannot be put")
            return
        robot, parts = matched
        where = (robot, *parts) if watching.robot == "*" else parts
        message = self._decode(topic, sample)
        if message is None or self._is_of_earlier_run(topic, robot, parts, message):
            return
        if is_old and _is_newer(watching.watch.by_parts.get(where), message):
            return
        watching.watch.take(message, where, arrived_ns)
        if watching.then is not None:
            self._call(topic, watching.then, message, *where)

    def _take_delete(self, watching: Watching, sample: Sample) -> None:
        topic = watching.watch.topic
        if watching.on_delete is None:
            return
        if has_wildcard(sample.key) and topic not in (topics.MARKER, topics.OVERLAY):
            self._drop(
                topic,
                "key",
                sample.key,
                "a wildcard delete is allowed for markers and overlays only",
            )
            return
        chunks = unicodedata.normalize("NFC", sample.key).split("/")[3:]
        self._call(topic, watching.on_delete, *chunks)

    def _call(self, topic: Topic[Any], handler: Callable[..., None], *arguments: Any) -> None:
        try:
            handler(*arguments)
        except Refused as refused:  # a wish that its owner refuses
            self._drop(
                topic,
                refused.code,
                "/".join(map(str, arguments[-topic.num_parts :])),
                refused.message,
            )

    def _decode(self, topic: Topic[Any], sample: Sample) -> Any | None:
        if len(sample.payload) > topic.max_bytes:
            self._drop(
                topic,
                "too_large",
                sample.key,
                f"{len(sample.payload)} bytes, {topic.max_bytes} at most",
            )
            return None
        try:
            return codec.decode(topic.message, sample.payload, sample.encoding)
        except codec.BadPayload as problem:
            self._drop(topic, "invalid", sample.key, str(problem))
            return None

    def _is_of_earlier_run(
        self, topic: Topic[Any], robot: str, parts: tuple[str, ...], message: Any
    ) -> bool:
        if not topic.of_epoch and (topic is not topics.TF or parts != ("odom",)):
            return False
        if message.stamp_ns >= self._context.time_of(robot).epoch:
            return False
        self._context.count(f"{topic.chunks[0]}/earlier_run")
        return True

    def _drop(self, topic: Topic[Any], reason: str, key: str, message: str) -> None:
        self._context.count(f"{topic.chunks[0]}/{reason}")
        self._context.log.limited(f"{topic.name}/{reason}", "Dropped", key=key, why=message)


def _is_newer(known: Any | None, other: Any) -> bool:
    """Whether a known message is to be kept rather than one that was read afterwards."""
    if known is None:
        return False
    return getattr(known, "stamp_ns", 1) >= getattr(other, "stamp_ns", 0)
