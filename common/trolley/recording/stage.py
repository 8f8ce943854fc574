"""Stands in on the network for the robot that a recording is played as."""

import time
from collections.abc import Callable
from typing import Any

from trolley import topics
from trolley.connection import Connection
from trolley.messages import Clock
from trolley.recording.layout import DRAWINGS, key_of
from trolley.recording.playback import Replica
from trolley.recording.reader import Entry
from trolley.runtime import codec
from trolley.runtime.clash import Run, is_one_per_host
from trolley.runtime.context import Context
from trolley.runtime.inbox import Inbox
from trolley.runtime.log import Log
from trolley.runtime.robot_time import RobotClocks
from trolley.runtime.serving import Server
from trolley.topics import Kind, Topic

SERVICE = "replay"


class Stage:
    """Publishes under a robot's name, shows that it is there, and answers `get`; close it.

    Requests are not answered: a recording obeys nobody.
    """

    def __init__(self, connection: Connection, name: str) -> None:
        self.name = name
        self.usurper: str | None = None
        """A service of a robot of the same name that has come up since."""
        self.replica = Replica(name, 0)
        self._clock: Clock | None = None
        self._connection = connection
        self._inbox = Inbox(time.monotonic_ns)
        run = str(Run.here())
        self._own = topics.ALIVE.key(name, SERVICE, run)
        connection.bus.declare_token(self._own)
        connection.bus.watch_tokens(topics.ALIVE.key(name), self._see)
        context = Context(name, connection.bus, self._inbox, Log(SERVICE), RobotClocks(name))
        self._server = Server(context)
        for topic in topics.TOPICS:
            if topic.kind is Kind.STREAM or topic in DRAWINGS:
                self._server.open_gets(topic, (), self._getter(topic))

    def close(self) -> None:
        """Leave."""
        self._server.close()

    def publish(self, entry: Entry) -> None:
        """Publish a message as it was, or delete its key."""
        key = key_of(self.name, entry.name)
        if entry.is_delete:
            self._connection.bus.delete(key)
        else:
            encoding = entry.encoding or codec.MIME["msgpack"]
            self._connection.bus.put(key, entry.payload, encoding, entry.topic.qos)

    def publish_clock(self, clock: Clock) -> None:
        """Publish robot time."""
        self._clock = clock
        self._connection.publish(self.name, topics.CLOCK, clock)

    def serve(self, timeout_s: float) -> None:
        """Answer queries for at most this long."""
        end_s = time.monotonic() + timeout_s
        while True:
            while (waiting := self._inbox.pop()) is not None:
                task, arrived_ns = waiting
                task(arrived_ns)
            left_s = end_s - time.monotonic()
            if left_s <= 0.0:
                return
            self._inbox.wait(left_s)

    def _getter(self, topic: Topic[Any]) -> Callable[[dict[str, str]], dict[tuple[str, ...], Any]]:
        def get(_parameters: dict[str, str]) -> dict[tuple[str, ...], Any]:
            found: dict[tuple[str, ...], Any] = {}
            if topic is topics.CLOCK and self._clock is not None:
                found[()] = self._clock
            for entry in self.replica.latest.values():
                matched = topic.match(key_of(self.name, entry.name))
                if entry.topic is not topic or matched is None:
                    continue
                try:
                    message = codec.decode(topic.message, entry.payload, entry.encoding)
                except codec.BadPayload:
                    continue
                found[matched[1]] = message
            return found

        return get

    def _see(self, key: str, is_there: bool) -> None:
        matched = topics.ALIVE.match(key)
        if matched is None or key == self._own or not is_there:
            return
        label = matched[1][0]
        if not is_one_per_host(label):  # who looks at a robot is not the robot
            self.usurper = label
