"""The frames of rosserial, protocol version 2, and the messages that it brings along.

    FF FE | length u16 | 255 - sum(length) % 256 | topic u16 | payload | 255 - sum(topic, payload)

All integers are little-endian. Counts: `bad_checksum` (a header that was right, but not what
followed it), `skipped_bytes` (what belonged to no frame).

Source:
    rosserial protocol, http://wiki.ros.org/rosserial/Overview/Protocol (since ROS Hydro).
"""

import struct
from collections.abc import Callable
from typing import NamedTuple

SYNC = b"\xff\xfe"
MOST_PAYLOAD = 512
"""Size of the boards' buffers; more overruns them."""
LENGTH_END, HEADER, OVERHEAD = 5, 7, 8
"""Bytes of a frame before and besides its payload."""

PUBLISHER, SUBSCRIBER, LOG, TIME, STOP = 0, 1, 7, 10, 11
FIRST_TOPIC = 100
"""Below are the protocol's own topics."""


class Frame(NamedTuple):
    """One frame.

    Attributes:
        topic_id: what it is about.
        payload: the serialized message.
        following: bytes from the frame's start to the end of what had arrived with it.
    """

    topic_id: int
    payload: bytes
    following: int


class TopicInfo(NamedTuple):
    """What a board announces of a topic that it publishes or subscribes to."""

    topic_id: int
    name: str
    type_name: str
    md5: str


class LogLine(NamedTuple):
    """A line of the board: level 0 debug, 1 info, 2 warning, 3 error, 4 fatal."""

    level: int
    text: str


def encode(topic_id: int, payload: bytes = b"") -> bytes:
    """Return a frame.

    Raises:
        ValueError: the payload is longer than 512 bytes, which would overrun a board's buffer.
    """
    if len(payload) > MOST_PAYLOAD:
        raise ValueError(f"a frame holds at most {MOST_PAYLOAD} bytes, not {len(payload)}")
    length = struct.pack("<H", len(payload))
    body = struct.pack("<H", topic_id) + payload
    return SYNC + length + _check(length) + body + _check(body)


def _check(covered: bytes) -> bytes:
    return bytes([255 - sum(covered) % 256])


TOPIC_REQUEST = encode(PUBLISHER)
STOP_REQUEST = encode(STOP)


def time_reply(now_ns: int) -> bytes:
    """Return the answer to a time request."""
    seconds, nanoseconds = divmod(now_ns, 1_000_000_000)
    return encode(TIME, struct.pack("<II", seconds & 0xFFFF_FFFF, nanoseconds))


def parse_topic_info(payload: bytes) -> TopicInfo | None:
    """Read `rosserial_msgs/TopicInfo`; None if it is none, or of a topic of the protocol's own."""
    try:
        (topic_id,) = struct.unpack_from("<H", payload)
        name, at = _string(payload, 2)
        type_name, at = _string(payload, at)
        md5, at = _string(payload, at)
        struct.unpack_from("<i", payload, at)  # the size of the buffer, which is ours anyway
    except struct.error:
        return None
    return TopicInfo(topic_id, name, type_name, md5) if topic_id >= FIRST_TOPIC else None


def parse_log(payload: bytes) -> LogLine | None:
    """Read `rosserial_msgs/Log`; None if it is none."""
    try:
        (level,) = struct.unpack_from("<B", payload)
        text, _ = _string(payload, 1)
    except struct.error:
        return None
    return LogLine(level, text)


def _string(payload: bytes, at: int) -> tuple[str, int]:
    """Return a string and where it ends."""
    (length,) = struct.unpack_from("<I", payload, at)
    (text,) = struct.unpack_from(f"{length}s", payload, at + 4)
    return text.decode("utf-8", "replace"), at + 4 + length


class FrameDecoder:
    """Finds frames in a stream of bytes, however it is cut.

    A frame begins at any `FF FE` whose length is at most 512 and has the right checksum; one whose
    data have a wrong checksum is none, and the search goes on at the byte after its `FF`. At most
    one unfinished frame is kept.

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
        at = skipped = 0
        while True:
            start = data.find(SYNC, at)
            if start < 0:  # its first byte may have come already
                start = len(data) - data.endswith(SYNC[:1], at)
            skipped += start - at
            at = start
            size = _size(data, at)
            if size is None:
                break
            if size and not _is_sound(data[at + LENGTH_END : at + size]):
                self._count("bad_checksum", 1)
                size = 0
            if size:
                (topic_id,) = struct.unpack_from("<H", data, at + LENGTH_END)
                payload = data[at + HEADER : at + size - 1]
                frames.append(Frame(topic_id, payload, len(data) - at))
            else:
                skipped += 1
            at += size or 1
        self._waiting = data[at:]
        if skipped:
            self._count("skipped_bytes", skipped)
        return frames


def _size(data: bytes, at: int) -> int | None:
    """Return the size of the frame that begins here, 0 if none does, None if more must come."""
    header = data[at : at + LENGTH_END]
    if len(header) < LENGTH_END:
        return None
    length = header[2] | header[3] << 8
    if length > MOST_PAYLOAD or not _is_sound(header[2:]):
        return 0
    size = length + OVERHEAD
    return size if at + size <= len(data) else None


def _is_sound(checked: bytes) -> bool:
    return sum(checked) % 256 == 255
