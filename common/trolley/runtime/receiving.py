"""The receiving half of a node: watches fed from the bus, everything validated before it counts."""

import dataclasses
import unicodedata
from collections.abc import Callable
from typing import Any

from trolley import topics
from trolley.codes import Refused
from trolley.runtime import codec
from trolley.runtime.bus import Bus, Closer, Reply, Sample, has_wildcard, matches
from trolley.runtime.inbox import Inbox
from trolley.runtime.log import Log
from trolley.runtime.replies import Gathering
from trolley.runtime.robot_time import TimeSource
from trolley.runtime.watch import Watch
from trolley.topics import Kind, Qos, Topic

GET_TIMEOUT_S = 1.5
"""A request that is answered after a look at somebody else's values is still answered in time."""


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


@dataclasses.dataclass(eq=False)
class Watching:
    """A watch and how it is fed."""

    watch: Watch[Any]
    robot: str | None
    parts: tuple[str, ...]
    then: Callable[..., None] | None = None
    on_delete: Callable[..., None] | None = None
    is_wish: bool = False
    """Whether it takes wishes to store something: no latest value is read, and none is kept."""
    closer: Closer | None = None

    def where(self, robot: str, parts: tuple[str, ...]) -> tuple[str, ...]:
        """The varying chunks as its handler gets them: the robot first where all are watched."""
        return (robot, *parts) if self.robot == "*" else parts


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
            size = len(sample.payload)
            if size > topic.max_bytes:  # only its size is worth keeping
                sample = dataclasses.replace(sample, payload=b"")
            context.inbox.push(
                lambda arrived_ns: self._receive(watching, sample, size, arrived_ns),
                slot,
                size=len(sample.payload),
            )

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

    def forget_epoch(self, robot: str, epoch_ns: int) -> None:
        """Drop what was measured before the run of the robot's base that began at `epoch_ns`."""
        for watching in self._watching:
            if watching.robot != "*" and (watching.robot or self._context.robot) != robot:
                continue
            topic, every_robot = watching.watch.topic, watching.robot == "*"

            def is_gone(
                where: tuple[str, ...],
                message: Any,
                topic: Topic[Any] = topic,
                every_robot: bool = every_robot,
            ) -> bool:
                if every_robot and where[0] != robot:
                    return False
                parts = where[1:] if every_robot else where
                return _is_of_epoch(topic, parts) and message.stamp_ns < epoch_ns

            watching.watch.forget(is_gone)

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
                sample = Sample(reply.key, reply.payload, reply.encoding)
                message = self._decode(topic, sample, len(reply.payload))
                if message is not None and not self._is_of_earlier_run(topic, *matched, message):
                    found[matched[1]] = message
            then(found)

        key = topic.key(robot, *parts)
        if "?" in key or "#" in key:  # such a name cannot exist, and in a selector it would cut
            self._context.inbox.push(lambda _: then({}), own=True)
            return
        self._ask(key, finish)

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
        if topic.qos is not Qos.STATE or watching.is_wish or watching.on_delete is not None:
            return
        asked_ns = self._context.inbox.now_ns()

        def finish(replies: list[Reply], _timed_out: bool) -> None:
            for reply in replies:
                if not reply.is_error:
                    sample = Sample(reply.key, reply.payload, reply.encoding)
                    self._take(watching, sample, len(reply.payload), asked_ns, is_read=True)

        self._ask(topic.key(watching.robot or self._context.robot, *watching.parts), finish)

    def _receive(self, watching: Watching, sample: Sample, size: int, arrived_ns: int) -> None:
        if watching not in self._watching:
            return
        if sample.is_delete:
            self._take_delete(watching, sample)
        elif watching.on_delete is None:
            self._take(watching, sample, size, arrived_ns)

    def _take(
        self, watching: Watching, sample: Sample, size: int, time_ns: int, *, is_read: bool = False
    ) -> None:
        """Take a message that arrived at `time_ns`, or that was read (asked for at `time_ns`)."""
        topic, watch = watching.watch.topic, watching.watch
        matched = None if has_wildcard(sample.key) else topic.match(sample.key)
        if matched is None:
            self._drop(topic, "key", sample.key, "a key with a wildcard cannot be put")
            return
        message = self._decode(topic, sample, size)
        if message is None or self._is_of_earlier_run(topic, *matched, message):
            return
        where = watching.where(*matched)
        if is_read and _is_newer(watch, where, message, time_ns):
            return
        if not watching.is_wish and not watch.take(message, where, time_ns, size):
            self._drop(topic, "too_many", sample.key, "too much is known already")
            return
        if watching.then is not None:
            self._call(topic, watching.then, message, *where)

    def _take_delete(self, watching: Watching, sample: Sample) -> None:
        topic = watching.watch.topic
        key = unicodedata.normalize("NFC", sample.key)
        if topic.kind is not Kind.STORED:  # what is measured or said once would be lost for good
            self._drop(topic, "key", sample.key, "only what is stored can be deleted")
            return
        if has_wildcard(key) and topic not in (topics.MARKER, topics.OVERLAY):
            if watching.on_delete is not None:  # else somebody else counts it
                why = "a wildcard delete is allowed for markers and overlays only"
                self._drop(topic, "key", sample.key, why)
            return
        if watching.on_delete is not None:
            self._call(topic, watching.on_delete, *key.split("/")[3:])
            return
        robot = watching.robot or self._context.robot

        def is_gone(where: tuple[str, ...], _message: Any) -> bool:
            of_robot, parts = (where[0], where[1:]) if robot == "*" else (robot, where)
            return matches(key, topic.key(of_robot, *parts))

        watching.watch.forget(is_gone)

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

    def _decode(self, topic: Topic[Any], sample: Sample, size: int) -> Any | None:
        if size > topic.max_bytes:
            why = f"{size} bytes, {topic.max_bytes} at most"
            self._drop(topic, "too_large", sample.key, why)
            return None
        try:
            return codec.decode(topic.message, sample.payload, sample.encoding)
        except codec.BadPayload as problem:
            self._drop(topic, "invalid", sample.key, str(problem))
            return None

    def _is_of_earlier_run(
        self, topic: Topic[Any], robot: str, parts: tuple[str, ...], message: Any
    ) -> bool:
        if not _is_of_epoch(topic, parts):
            return False
        if message.stamp_ns >= self._context.time_of(robot).epoch:
            return False
        self._context.count(f"{topic.chunks[0]}/earlier_run")
        return True

    def _drop(self, topic: Topic[Any], reason: str, key: str, message: str) -> None:
        self._context.count(f"{topic.chunks[0]}/{reason}")
        self._context.log.limited(f"{topic.name}/{reason}", "Dropped", key=key, why=message)


def _is_of_epoch(topic: Topic[Any], parts: tuple[str, ...]) -> bool:
    """Whether a message of this key holds for one run of base only."""
    return topic.of_epoch or (topic is topics.TF and parts == ("odom",))


def _is_newer(watch: Watch[Any], where: tuple[str, ...], read: Any, asked_ns: int) -> bool:
    """Whether what is known of a key is to be kept rather than what was read from its owner.

    What came before the owner was asked is as old as its answer or older, whatever the stamps say:
    they are 0 without robot time. What came since then may be the newer.
    """
    known, arrived_ns = watch.by_parts.get(where), watch.arrived(where)
    if known is None or arrived_ns is None:
        return False
    if arrived_ns < asked_ns:
        return bool(known == read)
    return getattr(known, "stamp_ns", 1) >= getattr(read, "stamp_ns", 0)
