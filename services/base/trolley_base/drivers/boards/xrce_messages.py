"""The messages of DDS-XRCE, as far as a micro-ROS board and its agent exchange them.

A message is a header (session, stream, number, and the client's key where the session is below
80) and submessages, each of which begins at a multiple of 4. Requests and objects are numbered
big-endian, everything else by a flag, which in micro-ROS says little-endian.

Source:
    OMG DDS-XRCE 1.0; eProsima Micro-XRCE-DDS-Client, xrce_types.c, session.c; Micro-XRCE-DDS-Agent,
    Processor.cpp.
"""

import re
import struct
from collections.abc import Iterator
from typing import NamedTuple

CREATE_CLIENT, CREATE, GET_INFO, DELETE = 0, 1, 2, 3
STATUS_AGENT, STATUS, INFO, WRITE_DATA, READ_DATA, DATA = 4, 5, 6, 7, 8, 9
ACKNACK, HEARTBEAT, FRAGMENT, TIMESTAMP, TIMESTAMP_REPLY = 10, 11, 13, 14, 15
"""Kinds of submessages."""
LITTLE_ENDIAN, LAST_FRAGMENT = 0b01, 0b10
"""Flags."""
NO_STREAM, BEST_EFFORT, RELIABLE = 0, 1, 0x80
"""Streams; from `RELIABLE` on each message is acknowledged."""
KEYLESS = 0x80
"""A session from here on needs no key in its messages; this one is no session at all."""
TOPIC, WRITER, READER, CLIENT = 2, 5, 6, 14
"""Kinds of objects: the lowest four bits of their numbers."""
REFERENCE, XML, BINARY = 1, 2, 3
"""How an object is described."""

COOKIE = b"XRCE"
IDENTITY = COOKIE + bytes((1, 0, 1, 0x0F, 0))
"""An agent of version 1.0, in eProsima's name: old boards read it as that agent writes it."""
OK = bytes((0, 0))

NAME_IN_XML = re.compile(rb"<name>([^<]{1,200})</name>\s*<dataType>([^<]{1,200})</dataType>")


class Header(NamedTuple):
    """Of a message: its session, stream and number, and the key or b""."""

    session: int
    stream: int
    number: int
    key: bytes = b""

    def encode(self) -> bytes:
        """Return its bytes."""
        return struct.pack("<BBH", self.session, self.stream, self.number) + self.key


class Submessage(NamedTuple):
    """One of a message's parts."""

    kind: int
    flags: int
    payload: bytes


class Creation(NamedTuple):
    """A request to create an object.

    Attributes:
        request: its number, as it stands in the message.
        object: the object's number, likewise.
        topic: the number of the topic that a writer or reader is of; b"" where it is not told.
        name: of a topic, or of a writer's or reader's; "" where it is not told.
        type_name: of its messages; "" where it is not told.
    """

    request: bytes
    object: bytes
    topic: bytes = b""
    name: str = ""
    type_name: str = ""

    @property
    def kind(self) -> int:
        """What is created."""
        return self.object[1] & 0x0F


def parse_header(message: bytes) -> tuple[Header, int] | None:
    """Return a message's header and where its submessages begin; None if it is none."""
    if len(message) < 4:
        return None
    session, stream, number = struct.unpack_from("<BBH", message)
    if session >= KEYLESS:
        return Header(session, stream, number), 4
    return (Header(session, stream, number, message[4:8]), 8) if len(message) >= 8 else None


def submessages(data: bytes, at: int = 0) -> Iterator[Submessage]:
    """Yield submessages, up to the first that is not whole or not little-endian."""
    while at + 4 <= len(data):
        kind, flags, length = struct.unpack_from("<BBH", data, at)
        payload = data[at + 4 : at + 4 + length]
        if len(payload) < length or not flags & LITTLE_ENDIAN:
            return
        yield Submessage(kind, flags, payload)
        at += 4 + length
        at += -at % 4


def submessage(kind: int, payload: bytes, flags: int = LITTLE_ENDIAN) -> bytes:
    """Return a submessage."""
    return struct.pack("<BBH", kind, flags, len(payload)) + payload


def info(request_and_object: bytes, *, has_session: bool) -> bytes:
    """Return the answer to a ping.

    Args:
        request_and_object: the first four bytes of the question.
        has_session: whether the board has a session here.
    """
    agent = bytes((1, 0x0D)) + IDENTITY
    activity = struct.pack("<BBxhxxI", 1, 0x0D, 1, 0)
    return submessage(INFO, request_and_object + bytes((0, has_session)) + agent + activity)


def acknack(first_missing: int, missing: int, stream: int) -> bytes:
    """Return what acknowledges a stream.

    Args:
        first_missing: number of the first message that has not come.
        missing: bit i: message `first_missing` + i has not come, but a later one has.
        stream: which one.
    """
    return submessage(
        ACKNACK, struct.pack("<HBBB", first_missing, missing >> 8, missing & 255, stream)
    )


def parse_acknack(payload: bytes) -> tuple[int, int, int] | None:
    """Return `first_missing`, `missing` and `stream` of an acknowledgement; None if it is none."""
    if len(payload) < 5:
        return None
    first, high, low, stream = struct.unpack_from("<HBBB", payload)
    return first, high << 8 | low, stream


def heartbeat(first: int, last: int, stream: int) -> bytes:
    """Return what asks for an acknowledgement of messages `first` to `last`."""
    return submessage(HEARTBEAT, struct.pack("<HHB", first, last, stream))


def parse_heartbeat(payload: bytes) -> tuple[int, int, int] | None:
    """Return `first`, `last` and `stream`; None if it is none."""
    return struct.unpack_from("<HHB", payload) if len(payload) >= 5 else None


def cancels(payload: bytes) -> bool:
    """Whether a request for a reader's data asks for none: control of delivery, and 0 samples."""
    return payload[6:10] == bytes((0, 1, 0, 0))


def timestamp_reply(transmitted: bytes, now_ns: int) -> bytes:
    """Return the answer to a question for the time.

    Args:
        transmitted: the question's payload: when the board asked.
        now_ns: when it came, and is answered.
    """
    return submessage(TIMESTAMP_REPLY, 2 * _time(now_ns) + transmitted[:8])


def _time(now_ns: int) -> bytes:
    seconds, nanoseconds = divmod(now_ns, 1_000_000_000)
    return struct.pack("<II", seconds & 0xFFFF_FFFF, nanoseconds)


def parse_creation(payload: bytes) -> Creation | None:
    """Read a request to create an object, however it is described; None if it is none."""
    if len(payload) < 8:
        return None
    creation = Creation(payload[0:2], payload[2:4])
    try:
        return _described(creation, payload)
    except (struct.error, UnicodeDecodeError):
        return None


def _described(creation: Creation, payload: bytes) -> Creation:
    kind, form = payload[4], payload[5]
    (length,) = struct.unpack_from("<I", payload, 8) if len(payload) >= 12 else (0,)
    inner = payload[12 : 12 + length]
    if len(inner) < length or kind not in (TOPIC, WRITER, READER):
        return creation
    if form == BINARY:
        if kind != TOPIC:
            return creation._replace(topic=inner[:2])
        name, at = _string(inner, 0)
        _, at = _optional_string(inner, at)  # a reference to its type
        return creation._replace(name=name, type_name=_optional_string(inner, at)[0])
    text = inner.rstrip(b"\0")
    if form == XML:
        found = NAME_IN_XML.search(text)
        if found:
            return creation._replace(name=found[1].decode(), type_name=found[2].decode())
    if form == REFERENCE:
        return creation._replace(name=re.sub("__(t|dw|dr)$", "", text.decode()))
    return creation


def _optional_string(data: bytes, at: int) -> tuple[str, int]:
    """Return a string that is there if the byte before it says so, else "", and where it ends."""
    return _string(data, at + 1) if data[at : at + 1] == b"\x01" else ("", at + 1)


def _string(data: bytes, at: int) -> tuple[str, int]:
    """Return a string and where it ends."""
    at += -at % 4
    (length,) = struct.unpack_from("<I", data, at)
    (text,) = struct.unpack_from(f"{length}s", data, at + 4)
    return text.rstrip(b"\0").decode(), at + 4 + length
