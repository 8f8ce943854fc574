"""The client's side of micro-ROS: frames, streams and requests, as eProsima's C library has them.

A sketch is a generator that yields until when it sleeps; it is woken by a message, too. What blocks
in C is a generator here (`yield from client.publish(…)`), and gives up after the same time.

Source:
    eProsima Micro-XRCE-DDS-Client: stream_framing_protocol.c, session.c, session_info.c, ping.c,
    output_reliable_stream.c, input_reliable_stream.c, write_access.c, create_entities_bin.c;
    rmw_microxrcedds.
"""

import struct
from collections.abc import Callable, Generator
from dataclasses import dataclass

from trolley_base.units import NS_PER_MS

Sleep = Generator[int, None, bool]
"""A call that blocks: yields until when it waits, returns whether it went well."""

SESSION = 0x81
MTU = 508
"""Of 512 bytes the library needs 4 for itself."""
HISTORY = 4
"""RMW_UXRCE_STREAM_HISTORY: messages that are kept, of each direction."""
PARTICIPANT, TOPIC, PUBLISHER, SUBSCRIBER, WRITER, READER = range(1, 7)
RELIABLE_STREAM, BEST_EFFORT_STREAM = 0x80, 0x01
HEARTBEAT_NS = 100 * NS_PER_MS
SESSION_TRIES, SESSION_TRY_NS = 10, 100 * NS_PER_MS
ENTITY_NS = PUBLISH_NS = SYNC_NS = 1_000 * NS_PER_MS
"""RMW_UXRCE_ENTITY_CREATION_TIMEOUT, RMW_UXRCE_PUBLISH_RELIABLE_TIMEOUT, and the sketch's own."""


def crc_of(data: bytes) -> int:
    """CRC-16 with the polynomial 8005, bit by bit: bytes and sum with their lowest bit first."""
    crc = 0
    for byte in data:
        for place in range(8):
            is_odd = (crc ^ byte >> place) & 1
            crc >>= 1
            if is_odd:
                crc ^= 0xA001
    return crc


def framed(payload: bytes) -> bytes:
    """Put a message into a frame from address 0 to address 0."""
    crc = crc_of(payload)
    head = bytes((0, 0, len(payload) & 255, len(payload) >> 8))
    frame = bytearray((0x7E,))
    for octet in head + payload + bytes((crc & 255, crc >> 8)):
        frame += bytes((0x7D, octet ^ 0x20)) if octet in (0x7D, 0x7E) else bytes((octet,))
    return bytes(frame)


class FrameReceiver:
    """Finds the host's frames, octet by octet."""

    def __init__(self) -> None:
        self.refused = 0
        """Frames with a wrong sum."""
        self._octets: bytearray | None = None
        self._is_escaped = False

    def take(self, data: bytes) -> list[bytes]:
        """Return the messages that these bytes complete."""
        messages: list[bytes] = []
        for octet in data:
            if octet == 0x7E:
                self._octets, self._is_escaped = bytearray(), False
            elif self._octets is None:
                continue
            elif octet == 0x7D:
                self._is_escaped = True
            else:
                self._octets.append(octet ^ 0x20 if self._is_escaped else octet)
                self._is_escaped = False
                self._look(messages)
        return messages

    def _look(self, messages: list[bytes]) -> None:
        octets = self._octets
        if octets is None or len(octets) < 4:
            return
        length = octets[2] + 256 * octets[3]
        if length > MTU + 8 or octets[1] != 0:
            self._octets = None
        elif len(octets) == length + 6:
            payload = bytes(octets[4:-2])
            if crc_of(payload) == octets[-2] + 256 * octets[-1]:
                messages.append(payload)
            else:
                self.refused += 1
            self._octets = None


class Cdr:
    """Writes numbers and strings as CDR."""

    def __init__(self) -> None:
        self.data = b""

    def put(self, layout: str, *values: float) -> "Cdr":
        """Write numbers of one size, the first at a multiple of it."""
        size = struct.calcsize(f"<{layout[-1]}")
        self.data += bytes(-len(self.data) % size) + struct.pack(f"<{layout}", *values)
        return self

    def text(self, text: str) -> "Cdr":
        """Write a string."""
        octets = text.encode() + b"\0"
        self.put("I", len(octets))
        self.data += octets
        return self


def part(kind: int, payload: bytes, flags: int = 1) -> bytes:
    """A submessage."""
    return bytes((kind, flags, len(payload) & 255, len(payload) >> 8)) + payload


@dataclass(slots=True)
class Publisher:
    """A data writer: its number, and its stream."""

    writer: bytes
    is_reliable: bool


class ReliableOutput:
    """What is sent in order and kept until the agent acknowledges it.

    Args:
        number: of the next message.
    """

    def __init__(self, number: int = 0) -> None:
        self._written = self._acknowledged = number
        """Number of the next message, and of the first that is not acknowledged."""
        self.kept: dict[int, bytes] = {}
        """What is not acknowledged, by its number."""
        self.heartbeat_ns: int | None = None
        """When to ask for an acknowledgement, None while nothing is kept."""

    def keep(self, data: bytes, now_ns: int) -> int:
        """Keep a message, and return its number."""
        number, self._written = self._written, self._written + 1 & 0xFFFF
        self.kept[number] = data
        if self.heartbeat_ns is None:
            self.heartbeat_ns = now_ns + HEARTBEAT_NS
        return number

    def put_off(self, now_ns: int) -> None:
        """Something has been heard: the question for an acknowledgement waits anew."""
        if self.heartbeat_ns is not None:
            self.heartbeat_ns = now_ns + HEARTBEAT_NS

    def heartbeat(self, now_ns: int) -> bytes | None:
        """Return the question for an acknowledgement, None if it is not due."""
        if not self.kept:
            self.heartbeat_ns = None
        if self.heartbeat_ns is None or now_ns < self.heartbeat_ns:
            return None
        self.heartbeat_ns = now_ns + HEARTBEAT_NS
        last = self._written - 1 & 0xFFFF
        return struct.pack("<HHB", self._acknowledged, last, RELIABLE_STREAM)

    def acknowledge(self, first: int, now_ns: int) -> None:
        """Take what the agent has: all before `first`."""
        while self._acknowledged != first and self._acknowledged in self.kept:
            del self.kept[self._acknowledged]
            self._acknowledged = self._acknowledged + 1 & 0xFFFF
        self.heartbeat_ns = now_ns + HEARTBEAT_NS if self.kept else None


class ReliableInput:
    """What comes in order, however it arrives.

    Args:
        number: of the next message.
    """

    def __init__(self, number: int = 0) -> None:
        self._next = number
        self._last = number - 1 & 0xFFFF
        """Number of the last message that the agent is known to have sent."""
        self._early: dict[int, bytes] = {}

    def take(self, number: int, data: bytes) -> list[bytes]:
        """Take a message, and return those whose turn it is."""
        self.announce(number)
        if (number - self._next & 0xFFFF) < HISTORY:
            self._early[number] = data
        found: list[bytes] = []
        while self._next in self._early:
            found.append(self._early.pop(self._next))
            self._next = self._next + 1 & 0xFFFF
        return found

    def announce(self, last: int) -> None:
        """Take note of the last message that the agent has sent."""
        if _is_after(last, self._last):
            self._last = last

    def skip_to(self, first: int) -> None:
        """Wait no more for what the agent no longer has."""
        if _is_after(first, self._next):
            self._next = first

    def acknack(self) -> bytes:
        """Return which message is next, and which of those after it are missing."""
        bits, number, end = 0, self._next, self._last + 1 & 0xFFFF
        for place in range(16):
            if not _is_after(end, number):
                break
            if number not in self._early:
                bits |= 1 << place
            number = number + 1 & 0xFFFF
        return struct.pack("<HBBB", self._next, bits >> 8, bits & 255, RELIABLE_STREAM)


def _is_after(number: int, other: int) -> bool:
    """Say whether a number of a message comes after another one; they begin anew at 65536."""
    return (number - other + 0x8000 & 0xFFFF) > 0x8000


class MicroRosClient:
    """A session with an agent, from the board's side.

    Args:
        send: puts bytes on the line.
    """

    def __init__(self, send: Callable[[bytes], None]) -> None:
        self._put = send
        self.now_ns = 0
        self.epoch_ns: int | None = None
        """By what the agent's time is ahead of `now_ns`, once it is known."""
        self.on_data: Callable[[bytes, bytes], None] = lambda reader, body: None
        """Called with a reader's number and what it got."""
        self._receiver = FrameReceiver()
        self._inbox: list[bytes] = []
        self.begin(0)

    def begin(self, key: int) -> None:
        """Forget the session."""
        self._key = struct.pack(">I", key)
        self._request = 9
        self._output = ReliableOutput()
        self._input = ReliableInput()
        self._newest_best_effort = -1
        self._best_effort = 0
        self._statuses: dict[int, int] = {}
        self._session_status: int | None = None
        self._synchronized = False

    def resume(self, number: int, expected: int) -> None:
        """Be in the middle of a session with somebody else."""
        self._output = ReliableOutput(number)
        self._input = ReliableInput(expected)

    def receive(self, data: bytes) -> bool:
        """Take what came over the line; True if it holds a whole message."""
        messages = self._receiver.take(data)
        self._inbox += messages
        return bool(messages)

    # Blocking calls.
    def wait(self, duration_ns: int, is_done: Callable[[], bool] = lambda: False) -> Sleep:
        """Listen, and keep the streams going, until this is so."""
        until_ns = self.now_ns + duration_ns
        while True:
            while self._inbox:
                self._take(self._inbox.pop(0))
                self._output.put_off(self.now_ns)
            if is_done():
                return True
            if self.now_ns >= until_ns:
                return False
            told = self._output.heartbeat(self.now_ns)
            if told is not None:
                self._put(framed(self._header(0, 0) + part(11, told)))
            due_ns = self._output.heartbeat_ns
            yield until_ns if due_ns is None else min(until_ns, due_ns)

    def ping(self, timeout_ns: int, attempts: int) -> Sleep:
        """Look for an agent; whatever else comes meanwhile is thrown away, as in the library."""
        for _ in range(attempts):
            question = bytes((0x80, 0, 0, 0)) + part(2, bytes((0, 10, 0xFF, 0xFD, 2, 0, 0, 0)))
            self._put(framed(question))
            until_ns = self.now_ns + timeout_ns
            while True:
                while self._inbox:
                    if self._is_pong(self._inbox.pop(0)):
                        return True
                if self.now_ns >= until_ns:
                    break
                yield until_ns
        return False

    def open(self) -> Sleep:
        """Open a session."""
        wanted = b"XRCE" + bytes((1, 0, 1, 15)) + self._key + bytes((SESSION, 0)) + b"\xf8\x01"
        for _ in range(SESSION_TRIES):
            self._put(framed(bytes((0x80, 0, 0, 0)) + part(0, wanted)))
            if (yield from self.wait(SESSION_TRY_NS, lambda: self._session_status is not None)):
                return self._session_status == 0
        return False

    def close(self) -> None:
        """Say that the session has ended, and wait for nobody."""
        self._put(framed(self._header(0, 0) + part(3, bytes((0, 2, 0xFF, 0xFE)))))

    def create(self, kind: int, number: int, inner: bytes, parent: bytes) -> Sleep:
        """Create an object, described in binary."""
        request = self._next_request()
        name = object_id(kind, number)
        payload = struct.pack(">H", request) + name + bytes((kind, 3, 0, 0))
        payload += struct.pack("<I", len(inner)) + inner
        if kind == PARTICIPANT:
            payload += bytes(len(payload) % 2)
        self._write_reliably(part(1, payload + parent, flags=1 | 0b100))
        done = yield from self.wait(ENTITY_NS, lambda: request in self._statuses)
        return done and self._statuses[request] in (0, 1)

    def request_data(self, reader: bytes, stream: int) -> None:
        """Ask for what a reader is to get, for ever."""
        request = struct.pack(">H", self._next_request())
        unlimited = struct.pack("<BBBBHHHH", stream, 0, 0, 1, 0xFFFF, 0xFFFF, 0xFFFF, 0)
        self._write_reliably(part(8, request + reader + unlimited))

    def synchronize(self) -> Sleep:
        """Ask for the time."""
        self._synchronized = False
        seconds, rest = divmod(self.now_ns, 1_000_000_000)
        self._put(framed(self._header(0, 0) + part(14, struct.pack("<iI", seconds, rest))))
        return (yield from self.wait(SYNC_NS, lambda: self._synchronized))

    def publish(self, publisher: Publisher, body: bytes) -> Sleep:
        """Publish a message, in fragments if it is long; wait until it is acknowledged."""
        request = struct.pack(">H", self._next_request())
        whole = part(7, request + publisher.writer + body)
        if len(whole) <= MTU - 4 and not publisher.is_reliable:
            number, self._best_effort = self._best_effort, (self._best_effort + 1) & 0xFFFF
            self._put(framed(self._header(BEST_EFFORT_STREAM, number) + whole))
            return True
        room = MTU - 4 - 4
        pieces = (
            [whole]
            if len(whole) <= MTU - 4
            else [
                part(13, whole[at : at + room], flags=1 | (2 if at + room >= len(whole) else 0))
                for at in range(0, len(whole), room)
            ]
        )
        if len(self._output.kept) + len(pieces) > HISTORY and not (yield from self._confirmed()):
            return False
        for piece in pieces:
            self._write_reliably(piece)
        # What is too long for one message takes the reliable stream in any case.
        return True if not publisher.is_reliable else (yield from self._confirmed())

    def _confirmed(self) -> Sleep:
        return (yield from self.wait(PUBLISH_NS, lambda: not self._output.kept))

    # The line.
    def _next_request(self) -> int:
        self._request += 1
        return self._request

    def _header(self, stream: int, number: int) -> bytes:
        return bytes((SESSION, stream, number & 255, number >> 8))

    def _write_reliably(self, data: bytes) -> None:
        number = self._output.keep(data, self.now_ns)
        self._put(framed(self._header(RELIABLE_STREAM, number) + data))

    def _take(self, message: bytes) -> None:
        if len(message) <= 8 or message[0] != SESSION:
            return
        stream, number = message[1], message[2] + 256 * message[3]
        if stream == 0:
            self._take_parts(message[4:])
        elif stream >= 0x80:
            for data in self._input.take(number, message[4:]):
                self._take_parts(data)
            self._acknowledge()
        elif number > self._newest_best_effort:
            self._newest_best_effort = number
            self._take_parts(message[4:])

    def _acknowledge(self) -> None:
        self._put(framed(self._header(0, 0) + part(10, self._input.acknack())))

    def _take_parts(self, data: bytes) -> None:
        at = 0
        while at + 4 <= len(data):
            kind, length = data[at], data[at + 2] + 256 * data[at + 3]
            payload = data[at + 4 : at + 4 + length]
            if len(payload) < length:
                return
            self._take_part(kind, payload)
            at = (at + 4 + length + 3) // 4 * 4

    def _take_part(self, kind: int, payload: bytes) -> None:
        match kind:
            case 4:
                self._session_status = payload[0]
            case 5:
                self._statuses[payload[0] * 256 + payload[1]] = payload[4]
            case 9:
                self.on_data(payload[2:4], payload[4:])
            case 10:
                self._take_acknack(payload)
            case 11:
                first, last, _stream = struct.unpack("<HHB", payload)
                self._input.skip_to(first)
                self._input.announce(last)
                self._acknowledge()
            case 15:
                self._take_time(payload)
            case _:
                pass

    def _take_acknack(self, payload: bytes) -> None:
        first, high, low, stream = struct.unpack("<HBBB", payload)
        if stream != RELIABLE_STREAM:
            return
        self._output.acknowledge(first, self.now_ns)
        if high or low:
            for number, data in self._output.kept.items():
                self._put(framed(self._header(RELIABLE_STREAM, number) + data))

    def _take_time(self, payload: bytes) -> None:
        sent, received, asked = (
            seconds * 1_000_000_000 + rest for seconds, rest in struct.iter_unpack("<iI", payload)
        )
        self.epoch_ns = -((asked + self.now_ns) - (received + sent)) // 2
        self._synchronized = True

    @staticmethod
    def _is_pong(message: bytes) -> bool:
        """Whether an agent is there: INFO whose activity says that it is available."""
        if len(message) < 20 or message[4] != 6 or len(message) < (30 if message[14] else 20):
            return False
        payload = message[8:]
        # The agent's configuration may come first: its kind, cookie, version, vendor, no more.
        at = 17 if payload[6] else 7
        return payload[at] == 1 and payload[at + 1] == 0x0D and payload[at + 3] == 1


def object_id(kind: int, number: int) -> bytes:
    """An object's number in bytes."""
    return struct.pack(">H", number << 4 | kind)
