"""What a service receives: watches fed from the bus, with everything validated first."""

import dataclasses
from collections import deque
from collections.abc import Callable, Collection
from functools import partial
from typing import Any, Generic, TypeVar

import msgspec

from trolley.codes import Refused
from trolley.names import canonical
from trolley.runtime import codec
from trolley.runtime.bus import Closer, Reply, Sample, has_wildcard, matches
from trolley.runtime.context import Context
from trolley.topics import Kind, Qos, Topic

M = TypeVar("M", bound=msgspec.Struct)

GET_TIMEOUT_S = 1.5
"""How long a read may take, so that a request that depends on one is still answered in time."""
MAX_HISTORY = 5000


class Watch(Generic[M]):
    """What is known of a topic: the latest message of each key, and the last seconds if asked."""

    def __init__(self, topic: Topic[M], seconds: float) -> None:
        self.topic = topic
        self.latest: M | None = None
        """The newest message of all keys."""
        self.arrived_ns: int | None = None
        """Local monotonic time of its arrival."""
        self.count = 0
        """How many messages arrived so far."""
        self.by_parts: dict[tuple[str, ...], M] = {}
        """The newest message per varying chunks (the robot first where all are watched)."""
        self.history: deque[M] = deque(maxlen=MAX_HISTORY)
        """The messages of the last `seconds`, oldest first; empty unless asked for."""
        self.is_full = False
        """Whether messages were refused since something was last forgotten: there is too much."""
        self.wakes = True
        """Whether a message is taken in as it comes; else before the next thing that the service
        does, within a second. May be set at any time; a watch that calls nobody does not wake."""
        self._seconds = seconds
        self._arrivals: dict[tuple[str, ...], int] = {}  # the one silent longest first
        self._sizes: dict[tuple[str, ...], int] = {}
        self._num_bytes = 0
        self._marks: deque[tuple[int, tuple[str, ...]]] = deque(maxlen=MAX_HISTORY)

    @property
    def keeps_history(self) -> bool:
        """Whether every message counts, not just the newest."""
        return self._seconds > 0.0

    def arrived(self, parts: tuple[str, ...]) -> int | None:
        """Local monotonic time [ns] at which the newest message of a key arrived."""
        return self._arrivals.get(parts)

    def take(self, message: M, parts: tuple[str, ...], arrived_ns: int, num_bytes: int) -> bool:
        """Store a message (called by the runtime); False: too much is kept already.

        Of what is measured or commanded the newest counts: there the key that was silent longest
        makes room, else whoever came first could keep others out.
        """
        has_room = parts in self.by_parts or len(self.by_parts) < self.topic.max_keys
        if not has_room and self.topic.qos is not Qos.STATE:
            self._drop_key(next(iter(self._arrivals)))
            has_room = True
        all_bytes = self._num_bytes - self._sizes.get(parts, 0) + num_bytes
        if not has_room or all_bytes > self.topic.max_kept_bytes:
            self.is_full = True
            return False
        self._sizes[parts], self._num_bytes = num_bytes, all_bytes
        self.count += 1
        self.latest = message
        self.arrived_ns = arrived_ns
        self.by_parts[parts] = message
        self._arrivals.pop(parts, None)
        self._arrivals[parts] = arrived_ns
        if self._seconds > 0.0:
            self.history.append(message)
            self._marks.append((arrived_ns, parts))
            while arrived_ns - self._marks[0][0] > self._seconds * 1e9:
                self.history.popleft()
                self._marks.popleft()
        return True

    def forget(self, is_gone: Callable[[tuple[str, ...], M], bool]) -> None:
        """Drop what `is_gone(varying_chunks, message)` says of (called by the runtime)."""
        for parts in [parts for parts, message in self.by_parts.items() if is_gone(parts, message)]:
            self._drop_key(parts)
        kept = [
            (message, mark)
            for message, mark in zip(self.history, self._marks, strict=True)
            if not is_gone(mark[1], message)
        ]
        self.history.clear()
        self.history.extend(message for message, _ in kept)
        self._marks.clear()
        self._marks.extend(mark for _, mark in kept)
        newest = max(self._arrivals, key=self._arrivals.__getitem__, default=None)
        self.latest = None if newest is None else self.by_parts[newest]
        self.arrived_ns = None if newest is None else self._arrivals[newest]

    def _drop_key(self, parts: tuple[str, ...]) -> None:
        del self.by_parts[parts], self._arrivals[parts]
        self._num_bytes -= self._sizes.pop(parts)
        self.is_full = False


@dataclasses.dataclass(eq=False)
class Feed:
    """A watch and where its messages come from."""

    watch: Watch[Any]
    robot: str | None
    parts: tuple[str, ...]
    then: Callable[..., None] | None = None
    on_delete: Callable[..., None] | None = None
    is_wish: bool = False
    """Whether it takes wishes to store something: no latest value is read, and none is kept."""
    closer: Closer | None = None
    _known: tuple[str, tuple[str, tuple[str, ...]]] | None = None

    def matched(self, key: str) -> tuple[str, tuple[str, ...]] | None:
        """The robot and the varying chunks of a key that may be put; mostly it is the last one."""
        known = self._known
        if known is not None and known[0] == key:
            return known[1]
        found = None if has_wildcard(key) else self.watch.topic.match(key)
        self._known = None if found is None else (key, found)
        return found

    def where(self, robot: str, parts: tuple[str, ...]) -> tuple[str, ...]:
        """The varying chunks as its handler gets them: the robot first where all are watched."""
        return (robot, *parts) if self.robot == "*" else parts


class Receiver:
    """Subscribes, decodes, drops what is invalid or of an earlier run, and calls the handlers."""

    def __init__(self, context: Context, owned: Collection[Topic[Any] | None] = ()) -> None:
        """Begin with nothing; `owned` are the stored keys whose wishes come to this service."""
        self._context = context
        self._owned = owned
        self._feeds: list[Feed] = []

    def watch(
        self,
        topic: Topic[M],
        parts: tuple[str, ...],
        seconds: float = 0.0,
        robot: str | None = None,
        then: Callable[..., None] | None = None,
    ) -> Watch[M]:
        """Subscribe, and read what is there already."""
        watch = Watch(topic, seconds)
        watch.wakes = then is not None
        is_wish = topic.kind is Kind.STORED and topic in self._owned
        self.open(Feed(watch, robot, parts, then, is_wish=is_wish))
        return watch

    def open(self, feed: Feed) -> None:
        """Subscribe, then read what is there already."""
        context, topic = self._context, feed.watch.topic
        newest_only = topic.qos is not Qos.STATE and not feed.watch.keeps_history
        push, take, watch = context.inbox.push, self._receive, feed.watch

        def receive(sample: Sample) -> None:
            size = kept = len(sample.payload)
            if size > topic.max_bytes:  # only its size is worth keeping
                sample, kept = msgspec.structs.replace(sample, payload=b""), 0
            push(
                partial(take, feed, sample, size),
                (feed, sample.key) if newest_only else None,
                size=kept,
                wakes=watch.wakes,
            )

        key = topic.key(feed.robot or context.robot, *feed.parts)
        feed.closer = context.bus.subscribe(key, receive)
        self._feeds.append(feed)
        self._catch_up(feed)

    def close(self, watch: Watch[Any] | None = None) -> None:
        """Stop one watch, or all."""
        for feed in [one for one in self._feeds if watch is None or one.watch is watch]:
            self._feeds.remove(feed)
            if feed.closer is not None:
                feed.closer.close()

    def catch_up(self) -> None:
        """Read again what may have been missed while the bus was away."""
        for feed in self._feeds:
            self._catch_up(feed)

    def forget_epoch(self, robot: str, epoch_ns: int) -> None:
        """Drop what was measured before the run of the robot's base that began at `epoch_ns`."""
        for feed in self._feeds:
            if feed.robot != "*" and (feed.robot or self._context.robot) != robot:
                continue
            topic, every_robot = feed.watch.topic, feed.robot == "*"

            def is_gone(
                where: tuple[str, ...],
                message: Any,
                topic: Topic[Any] = topic,
                every_robot: bool = every_robot,
            ) -> bool:
                if every_robot and where[0] != robot:
                    return False
                parts = where[1:] if every_robot else where
                return topic.is_of_epoch(parts) and message.stamp_ns < epoch_ns

            feed.watch.forget(is_gone)

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
        self._context.ask(f"{key}?format=msgpack", GET_TIMEOUT_S, finish)

    def _catch_up(self, feed: Feed) -> None:
        """A late joiner subscribes, then gets, and keeps the newer."""
        topic = feed.watch.topic
        if topic.qos is not Qos.STATE or feed.is_wish or feed.on_delete is not None:
            return
        asked_ns = self._context.inbox.now_ns()

        def finish(replies: list[Reply], _timed_out: bool) -> None:
            if feed not in self._feeds:
                return
            for reply in replies:
                if not reply.is_error:
                    sample = Sample(reply.key, reply.payload, reply.encoding)
                    self._accept(feed, sample, len(reply.payload), asked_ns, is_read=True)

        key = topic.key(feed.robot or self._context.robot, *feed.parts)
        self._context.ask(f"{key}?format=msgpack", GET_TIMEOUT_S, finish)

    def _receive(self, feed: Feed, sample: Sample, size: int, arrived_ns: int) -> None:
        if feed not in self._feeds:
            return
        if sample.is_delete:
            self._accept_delete(feed, sample)
        elif feed.on_delete is None:
            self._accept(feed, sample, size, arrived_ns)

    def _accept(
        self, feed: Feed, sample: Sample, size: int, time_ns: int, *, is_read: bool = False
    ) -> None:
        """Take a message that arrived at `time_ns`, or that was read (asked for at `time_ns`)."""
        topic, watch = feed.watch.topic, feed.watch
        matched = feed.matched(sample.key)
        if matched is None:
            self._drop(topic, "key", sample.key, "a key with a wildcard cannot be put")
            return
        message = self._decode(topic, sample, size)
        if message is None or self._is_of_earlier_run(topic, *matched, message):
            return
        where = feed.where(*matched)
        if is_read and _is_newer(watch, where, message, time_ns):
            return
        if not feed.is_wish and not watch.take(message, where, time_ns, size):
            self._drop(topic, "too_many", sample.key, "too much is kept already")
            return
        if feed.then is not None:
            self._call(topic, feed.then, message, *where)

    def _accept_delete(self, feed: Feed, sample: Sample) -> None:
        topic = feed.watch.topic
        key = canonical(sample.key)
        if topic.kind is not Kind.STORED:  # what is measured or said once would be lost for good
            self._drop(topic, "key", sample.key, "only what is stored can be deleted")
            return
        # By its own name: one of everything would be understood by some, and not by others.
        is_named = key.split("/")[2:3] == [topic.chunks[0]]
        if has_wildcard(key) and not (topic.is_drawing and is_named):
            if feed.on_delete is not None:  # else somebody else counts it
                why = "a wildcard delete is allowed below markers and overlays only"
                self._drop(topic, "key", sample.key, why)
            return
        if feed.on_delete is not None:
            self._call(topic, feed.on_delete, *key.split("/")[3:])
            return
        robot = feed.robot or self._context.robot

        def is_gone(where: tuple[str, ...], _message: Any) -> bool:
            of_robot, parts = (where[0], where[1:]) if robot == "*" else (robot, where)
            return matches(key, topic.key(of_robot, *parts))

        feed.watch.forget(is_gone)

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
        if not topic.is_of_epoch(parts):
            return False
        if message.stamp_ns >= self._context.clocks.epoch_of(robot):
            return False
        self._context.count(f"{topic.chunks[0]}/earlier_run")
        return True

    def _drop(self, topic: Topic[Any], reason: str, key: str, message: str) -> None:
        self._context.count(f"{topic.chunks[0]}/{reason}")
        self._context.log.limited(f"{topic.name}/{reason}", "Dropped", key=key, why=message)


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
