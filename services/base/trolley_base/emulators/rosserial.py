"""The device's side of rosserial: frames out, and the receiver of the C++ client library.

The receiver follows `ros_lib/ros/node_handle.h`: a frame that has not arrived 20 ms after its first
byte is forgotten, a wrong length checksum drops the header, a wrong data checksum the frame.

Source:
    rosserial protocol v2, as in rosserial_client's node_handle.h.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass

PUBLISHER, SUBSCRIBER, LOG, TIME, STOP = 0, 1, 7, 10, 11
"""Reserved topic ids."""
FRAME_NS = 20_000_000
BUFFER_BYTES = 512


@dataclass(frozen=True, slots=True)
class Message:
    """A frame's content."""

    topic: int
    payload: bytes


def encode(topic: int, payload: bytes) -> bytes:
    """Frame a payload."""
    size = struct.pack("<H", len(payload))
    body = struct.pack("<H", topic) + payload
    return b"".join(
        (b"\xff\xfe", size, bytes([255 - sum(size) % 256]), body, bytes([255 - sum(body) % 256]))
    )


def encode_string(text: str) -> bytes:
    """A `string` field: its length as u32, then its bytes."""
    data = text.encode()
    return struct.pack("<I", len(data)) + data


def topic_info(topic: int, name: str, kind: str, md5: str) -> bytes:
    """The payload of a TopicInfo."""
    return b"".join(
        (
            struct.pack("<H", topic),
            encode_string(name),
            encode_string(kind),
            encode_string(md5),
            struct.pack("<i", BUFFER_BYTES),
        )
    )


class Receiver:
    """Finds the host's frames among the bytes, as the firmware does."""

    def __init__(self) -> None:
        self._pending = bytearray()
        self._began_ns = 0
        self.late = 0
        """Frames that were not complete within 20 ms."""
        self.refused = 0
        """Headers and frames with a wrong checksum."""
        self.too_long = 0
        """Frames that would have overrun the firmware's buffer."""

    def clear(self) -> None:
        """Forget what has arrived of a frame."""
        self._pending.clear()

    def take(self, data: bytes, now_ns: int) -> Iterator[Message]:
        """Yield the frames that these bytes complete."""
        if self._pending and now_ns - self._began_ns > FRAME_NS:
            self._pending.clear()
            self.late += 1
        for byte in data:
            if not self._pending:
                if byte == 0xFF:
                    self._began_ns = now_ns
                    self._pending.append(byte)
                continue
            self._pending.append(byte)
            message = self._look()
            if message is not None:
                yield message

    def _look(self) -> Message | None:
        """Check the frame so far; return it once it is complete and valid."""
        frame = self._pending
        have = len(frame)
        if have == 2 and frame[1] != 0xFE:
            frame.clear()
        elif have == 5 and sum(frame[2:5]) % 256 != 255:
            frame.clear()
            self.refused += 1
        elif have == 5 and frame[2] + 256 * frame[3] > BUFFER_BYTES:
            frame.clear()
            self.too_long += 1
        elif have >= 8 and have == frame[2] + 256 * frame[3] + 8:
            whole = bytes(frame)
            frame.clear()
            if sum(whole[5:]) % 256 == 255:
                return Message(whole[5] + 256 * whole[6], whole[7:-1])
            self.refused += 1
        return None
