"""The frames in which a micro-ROS board sends its messages over a serial line; datagrams over UDP.

    7E | source u8 | destination u8 | length u16 | message | crc u16

All behind the first byte is escaped: 7E and 7D become 7D and the byte XOR 20. The sum, CRC-16/ARC,
is of the message alone, before it is escaped. Integers are little-endian. Counts: `bad_checksum`,
`skipped_bytes` (what belonged to no frame). Over UDP a datagram is a message and nothing else.

Source:
    eProsima Micro-XRCE-DDS-Client, stream_framing_protocol.c, udp_transport.c.
"""

import struct
from collections.abc import Callable
from typing import NamedTuple

from trolley_base.drivers.boards.xrce_messages import parse_header, submessages

BEGIN, ESCAPE, FLIP = 0x7E, 0x7D, 0x20
AGENT = 0
"""The agent's address."""
HEAD, OVERHEAD = 4, 6
"""Bytes of a frame before and besides its message, without the first."""
LAST_KIND = 15
"""No submessage is of a higher one."""
MOST_MESSAGE = 4096
"""micro-ROS sends 512 as it is delivered; a longer one is rubbish."""


def _table() -> tuple[int, ...]:
    table = list(range(256))
    for _ in range(8):
        table = [value >> 1 ^ (0xA001 if value & 1 else 0) for value in table]
    return tuple(table)


CRC_TABLE = _table()


class Frame(NamedTuple):
    """One frame.

    Attributes:
        source: the address of whoever sent it.
        message: what it carries.
        following: bytes from the frame's start to the end of what had arrived with it.
    """

    source: int
    message: bytes
    following: int


def crc16(data: bytes) -> int:
    """Return the sum of a message: CRC-16/ARC."""
    crc = 0
    for byte in data:
        crc = crc >> 8 ^ CRC_TABLE[(crc ^ byte) & 0xFF]
    return crc


def encode(message: bytes, destination: int) -> bytes:
    """Return a frame from the agent."""
    plain = struct.pack("<BBH", AGENT, destination, len(message)) + message
    plain += struct.pack("<H", crc16(message))
    # The escape first: what it escapes holds it again.
    escaped = plain.replace(b"\x7d", b"\x7d\x5d").replace(b"\x7e", b"\x7d\x5e")
    return b"\x7e" + escaped


class FrameDecoder:
    """Finds frames in a stream of bytes, however it is cut; keeps at most one unfinished frame.

    A 7E begins a frame, and ends one that is unfinished.

    Args:
        count: adds to a counter.
    """

    def __init__(self, count: Callable[[str, int], None]) -> None:
        self._count = count
        self._waiting = b""

    @property
    def waiting(self) -> int:
        """How many bytes wait for more."""
        return len(self._waiting)

    def reset(self) -> None:
        """Forget an unfinished frame."""
        self._waiting = b""

    def feed(self, data: bytes) -> list[Frame]:
        """Return the frames that are complete now."""
        data = self._waiting + data
        frames: list[Frame] = []
        skipped = 0
        start = data.find(BEGIN)
        if start < 0:
            start = len(data)
        skipped += start
        while start < len(data):
            end = data.find(BEGIN, start + 1)
            is_last = end < 0
            end = len(data) if is_last else end
            plain, size = _unescape(data[start + 1 : end])
            if size is None and is_last:
                break
            if plain and crc16(plain[HEAD:-2]) == plain[-2] | plain[-1] << 8:
                frames.append(Frame(plain[0], plain[HEAD:-2], len(data) - start))
                skipped += end - start - 1 - (size or 0)
            else:
                if plain:
                    self._count("bad_checksum", 1)
                skipped += end - start
            start = end
        self._waiting = data[start:]
        if skipped:
            self._count("skipped_bytes", skipped)
        return frames


def _unescape(escaped: bytes) -> tuple[bytes, int | None]:
    """Return the frame that these bytes begin with, and how many of them it takes.

    Returns:
        b"" and a size if they can begin none; b"" and None if more must come.
    """
    plain = bytearray()
    length = MOST_MESSAGE
    at = 0
    while at < len(escaped):
        byte = escaped[at]
        at += 1
        if byte == ESCAPE:
            if at == len(escaped):
                return b"", None
            byte = escaped[at] ^ FLIP
            at += 1
        plain.append(byte)
        if len(plain) == HEAD:
            length = plain[2] | plain[3] << 8
            if length > MOST_MESSAGE:
                return b"", at
        if len(plain) == length + OVERHEAD:
            return bytes(plain), at
    return b"", None


class MessageDatagrams:
    """Messages as datagrams (`trolley_base.drivers.dialogue.Datagrams`)."""

    def join(self, datagram: bytes) -> bytes:
        """Return a message in a frame; b"" for what is no message at all."""
        parsed = parse_header(datagram)
        if parsed is None or len(datagram) > MOST_MESSAGE:
            return b""
        is_message = any(part.kind <= LAST_KIND for part in submessages(datagram, parsed[1]))
        return encode(datagram, AGENT) if is_message else b""

    def cut(self, data: bytes) -> list[bytes]:
        """Return the messages of whole frames."""
        return [frame.message for frame in FrameDecoder(_count_nothing).feed(data)]


def _count_nothing(_name: str, _number: int) -> None:
    """Frames of our own are sound."""
