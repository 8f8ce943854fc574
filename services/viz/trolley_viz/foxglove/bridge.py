"""The robots' streams for Foxglove: a WebSocket server that its app connects to.

It only shows; nothing that a client sends has an effect. A stream is subscribed to while a client
wants a channel that needs it; before, only the robots are known. The server's threads hand over by
`call_soon`.
"""

import dataclasses
from typing import Any

import foxglove
from foxglove.websocket import ChannelView, Client, ServerListener

from trolley import topics
from trolley.config.viz import VizConfig
from trolley.foxglove.views import CHANNELS, MARKERS, Channel, Views
from trolley.messages import Robot
from trolley.runtime.service import Service, Watch
from trolley.topics import Topic

NAME = "Trolley"
MAX_ROBOTS = 32


@dataclasses.dataclass
class _Shown:
    """A robot, its channels, and what is subscribed to for them."""

    views: Views
    channels: dict[str, foxglove.Channel]
    watches: dict[str, Watch[Any]] = dataclasses.field(default_factory=dict[str, Watch[Any]])
    markers: list[bytes] = dataclasses.field(default_factory=list[bytes])
    """Those that have come at this moment."""


class FoxgloveBridge:
    """The WebSocket server for Foxglove; whoever makes it has to close it.

    Args:
        service: Whose thread and subscriptions are used.
        config: Where it listens.

    Raises:
        RuntimeError: It cannot listen there.
    """

    def __init__(self, service: Service, config: VizConfig) -> None:
        self._service = service
        self._shown: dict[str, _Shown] = {}
        self._wanted: dict[str, set[int]] = {}
        """The clients of each channel, by its full name."""
        self._context = foxglove.Context()
        self._server = foxglove.start_server(
            name=NAME,
            host=config.foxglove_host,
            port=config.foxglove_port,
            server_listener=_Listener(self),
            context=self._context,
        )
        service.watch(topics.ROBOT, robot="*", then=self._meet)
        service.log.info("Foxglove can connect", port=self._server.port)

    @property
    def subscribed(self) -> set[tuple[str, str]]:
        """The robots and topics that are subscribed to for clients."""
        return {(robot, name) for robot, shown in self._shown.items() for name in shown.watches}

    def close(self) -> None:
        """Stop serving."""
        self._server.stop()

    def hand_over_want(self, client_id: int, channel: str, *, wants: bool) -> None:
        """Note that a client wants a channel, or no more (any thread)."""
        self._service.call_soon(lambda: self._want(client_id, channel, wants), urgent=True)

    # On the service's thread.
    def _meet(self, _message: Robot, robot: str) -> None:
        if robot in self._shown or len(self._shown) >= MAX_ROBOTS:
            return
        channels = {
            name: foxglove.Channel(
                row.of(robot),
                message_encoding=row.encoding,
                schema=row.schema,
                context=self._context,
            )
            for name, row in CHANNELS.items()
        }
        self._shown[robot] = _Shown(Views(robot), channels)

    def _want(self, client_id: int, channel: str, wants: bool) -> None:
        clients = self._wanted.setdefault(channel, set())
        if wants:
            clients.add(client_id)
        else:
            clients.discard(client_id)
        robot, _, name = channel.removeprefix("/").partition("/")
        shown = self._shown.get(robot)
        if shown is None:
            return
        self._follow(robot, shown)
        if wants:
            self._repeat(robot, shown, CHANNELS[name])

    def _follow(self, robot: str, shown: _Shown) -> None:
        """Subscribe to what the wanted channels need, and to nothing else."""
        needed = {
            topic.name: topic
            for row in CHANNELS.values()
            if self._wanted.get(row.of(robot))
            for topic in row.topics
        }
        for name in shown.watches.keys() - needed.keys():
            self._service.close_watch(shown.watches.pop(name))
        for name in sorted(needed.keys() - shown.watches.keys()):
            topic = needed[name]

            def hear(message: Any, *parts: str, topic: Topic[Any] = topic) -> None:
                self._show(robot, shown, topic, parts, message)

            shown.watches[name] = self._service.watch(topic, robot=robot, then=hear)

    def _repeat(self, robot: str, shown: _Shown, row: Channel) -> None:
        """Tell a newcomer what is known already."""
        for topic in row.topics:
            for parts, message in shown.watches[topic.name].by_parts.items():
                self._show(robot, shown, topic, parts, message, only=row.name)

    def _show(
        self,
        robot: str,
        shown: _Shown,
        topic: Topic[Any],
        parts: tuple[str, ...],
        message: Any,
        only: str | None = None,
    ) -> None:
        now_ns = self._service.time_of(robot).now(self._service.monotonic_ns)
        at_ns = now_ns or getattr(message, "stamp_ns", 0) or self._service.unix_ns
        seen = list(shown.views.of(topic, parts, message, at_ns))
        if topic is topics.CLOCK and topics.MARKER.name in shown.watches:
            there = {"/".join(where) for where in shown.watches[topics.MARKER.name].by_parts}
            seen += shown.views.left(there, at_ns)
        for name, data in seen:
            if only not in (None, name) or not self._wanted.get(CHANNELS[name].of(robot)):
                continue
            if topic is topics.MARKER:
                if not shown.markers:
                    self._service.call_soon(lambda: self._show_markers(shown, at_ns))
                shown.markers.append(data)
                continue
            if name == MARKERS:  # some are gone: after those that have come before
                self._show_markers(shown, at_ns)
            shown.channels[name].log(data, log_time=at_ns)

    def _show_markers(self, shown: _Shown, at_ns: int) -> None:
        """Show all markers that have come in one message: of thousands, a client misses many.

        To protobuf, two messages one after the other are one with what both contain.
        """
        if shown.markers:
            shown.channels[MARKERS].log(b"".join(shown.markers), log_time=at_ns)
            shown.markers.clear()


class _Listener(ServerListener):
    """What the clients of the server do."""

    def __init__(self, bridge: FoxgloveBridge) -> None:
        self._bridge = bridge

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        """Begin to show."""
        self._bridge.hand_over_want(client.id, channel.topic, wants=True)

    def on_unsubscribe(self, client: Client, channel: ChannelView) -> None:
        """Show no more."""
        self._bridge.hand_over_want(client.id, channel.topic, wants=False)
