"""Frames of one length that begin with a known head, in a stream of bytes."""

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class FrameFormat:
    """What a frame looks like.

    Attributes:
        head: its first bytes.
        length: of a whole frame [bytes].
        is_sound: whether a whole frame holds what it must.
    """

    head: bytes
    length: int
    is_sound: Callable[[bytes], bool]


@dataclass(frozen=True, slots=True)
class FoundFrame:
    """A sound frame, and how many bytes had come since its first one."""

    data: bytes
    following: int


class FrameReader:
    """Finds frames, however the stream is cut; keeps less than one frame.

    Args:
        frame: what they look like.
        count: adds to a counter: `skipped_bytes`, which belong to no frame, and `bad_checksum`.
    """

    def __init__(self, frame: FrameFormat, count: Callable[[str, int], None]) -> None:
        self._format = frame
        self._count = count
        self._waiting = b""

    def reset(self) -> None:
        """Forget an unfinished frame."""
        self._waiting = b""

    def feed(self, data: bytes) -> tuple[list[FoundFrame], bool]:
        """Return the frames that are complete now, and whether bytes belonged to none."""
        head, length = self._format.head, self._format.length
        data = self._waiting + data
        frames: list[FoundFrame] = []
        at = skipped = 0
        while True:
            start = data.find(head, at)
            if start < 0:
                start = _begins(data, at, head)
            skipped += start - at
            at = start
            whole = data[at : at + length]
            if len(whole) < length:
                break
            if self._format.is_sound(whole):
                frames.append(FoundFrame(whole, len(data) - at))
                at += length
            else:
                self._count("bad_checksum", 1)
                skipped += 1
                at += 1
        self._waiting = data[at:]
        if skipped:
            self._count("skipped_bytes", skipped)
        return frames, skipped > 0


def _begins(data: bytes, at: int, head: bytes) -> int:
    """Return where a head has begun whose rest has not come; the end if none has."""
    for length in range(min(len(head) - 1, len(data) - at), 0, -1):
        if data.endswith(head[:length]):
            return len(data) - length
    return len(data)
