"""A client of Foxglove's WebSocket protocol, and as much of protobuf as it takes to look inside."""

import json
import struct
import time
from types import TracebackType
from typing import Any, Self

from websockets.sync.client import connect
from websockets.typing import Subprotocol

from support.waiting import PATIENCE_S

MESSAGE_DATA = 1


class FoxgloveClient:
    """As Foxglove's app: it learns the channels, subscribes, and gets messages."""

    def __init__(self, port: int) -> None:
        self.channels: dict[str, dict[str, Any]] = {}
        self.info: dict[str, Any] = {}
        self.received: dict[str, list[tuple[int, bytes]]] = {}
        self._topics: dict[int, str] = {}
        self._socket = connect(
            f"ws://127.0.0.1:{port}", subprotocols=[Subprotocol("foxglove.sdk.v1")], max_size=None
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._socket.close()

    def subscribe(self, *topics: str) -> None:
        wishes = []
        for topic in topics:
            number = len(self._topics) + 1
            self._topics[number] = topic
            wishes.append({"id": number, "channelId": self.channels[topic]["id"]})
        self._socket.send(json.dumps({"op": "subscribe", "subscriptions": wishes}))

    def unsubscribe(self, topic: str) -> None:
        number = next(number for number, name in self._topics.items() if name == topic)
        self._socket.send(json.dumps({"op": "unsubscribe", "subscriptionIds": [number]}))

    def send(self, message: dict[str, Any]) -> None:
        self._socket.send(json.dumps(message))

    def wait_for(self, *topics: str) -> None:
        """Listen until each of these has brought a message."""
        self._listen(lambda: all(self.received.get(topic) for topic in topics), topics)

    def wait_for_channels(self, *topics: str) -> None:
        """Listen until these are offered."""
        self._listen(lambda: set(topics) <= self.channels.keys(), topics)

    def listen(self, seconds: float) -> None:
        """Listen for so long."""
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            self._receive(0.1)

    def _listen(self, is_done: Any, topics: tuple[str, ...]) -> None:
        end_s = time.monotonic() + PATIENCE_S
        while not is_done():
            missing = [topic for topic in topics if not self.received.get(topic)]
            assert time.monotonic() < end_s, f"nothing came of {missing}; {sorted(self.channels)}"
            self._receive(0.2)

    def _receive(self, seconds: float) -> None:
        try:
            frame = self._socket.recv(timeout=seconds)
        except TimeoutError:
            return
        if isinstance(frame, str):
            message = json.loads(frame)
            if message["op"] == "advertise":
                self.channels |= {one["topic"]: one for one in message["channels"]}
            elif message["op"] == "serverInfo":
                self.info = message
        elif frame[0] == MESSAGE_DATA:
            number, log_time = struct.unpack_from("<IQ", frame, 1)
            self.received.setdefault(self._topics[number], []).append((log_time, frame[13:]))


def fields(data: bytes) -> dict[int, list[Any]]:
    """The fields of a protobuf message by number: ints, 8 or 4 raw bytes, or inner bytes."""
    found: dict[int, list[Any]] = {}
    at = 0
    while at < len(data):
        tag, at = _varint(data, at)
        kind = tag & 7
        if kind == 0:
            value, at = _varint(data, at)
        else:
            length = {1: 8, 5: 4}.get(kind)
            if length is None:
                length, at = _varint(data, at)
            value, at = data[at : at + length], at + length
        found.setdefault(tag >> 3, []).append(value)
    return found


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = data[at]
        value |= (byte & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if not byte & 0x80:
            return value, at
