"""Markers and overlays that programs drew, kept in memory for viewers that come later."""

import dataclasses
from typing import Generic, TypeVar

import msgspec
from msgspec import structs

from trolley import codes, topics
from trolley.codes import Refused
from trolley.messages import Marker, Overlay
from trolley.runtime.bus import matches
from trolley_tour.stored.checks import plain_name

M = TypeVar("M", bound=msgspec.Struct)
Chunks = tuple[str, ...]

MAX_MARKERS = topics.MARKER.max_keys
MAX_OVERLAYS = 500
MAX_BYTES = topics.MARKER.max_kept_bytes
"""Of the markers, and of the overlays."""


@dataclasses.dataclass(frozen=True)
class _Kept(Generic[M]):
    message: M
    num_bytes: int
    ends_ns: int | None


class Drawings(Generic[M]):
    """Drawings of one kind by the varying chunks of their keys; times are of the local clock."""

    def __init__(self, max_number: int, max_bytes: int = MAX_BYTES) -> None:
        self._max_number = max_number
        self._max_bytes = max_bytes
        self._kept: dict[Chunks, _Kept[M]] = {}
        self._num_bytes = 0

    def __len__(self) -> int:
        return len(self._kept)

    def put(self, chunks: Chunks, message: M, now_ns: int, lifetime_s: float = 0.0) -> None:
        """Keep a drawing, in place of the one under the same key; `lifetime_s` 0 = for ever.

        Raises:
            Refused: A chunk of its key is no name, or there are too many.
        """
        chunks = tuple(plain_name(chunk) for chunk in chunks)
        num_bytes = len(msgspec.msgpack.encode(message))
        before = self._kept.get(chunks)
        num_before = 0 if before is None else before.num_bytes
        self._drop_ended(now_ns)
        if before is None and len(self._kept) >= self._max_number:
            raise Refused(codes.TOO_LARGE, f"There are {self._max_number} already: delete some.")
        if self._num_bytes - num_before + num_bytes > self._max_bytes:
            raise Refused(codes.TOO_LARGE, f"They fill {self._max_bytes} bytes: delete some.")
        self._remove(chunks)
        ends_ns = now_ns + int(lifetime_s * 1e9) if lifetime_s > 0.0 else None
        self._kept[chunks] = _Kept(message, num_bytes, ends_ns)
        self._num_bytes += num_bytes

    def delete(self, chunks: Chunks) -> None:
        """Forget a drawing, or all whose key these chunks with wildcards cover.

        Raises:
            Refused: They name nothing.
        """
        pattern = "/".join(chunks)
        covered = [key for key in self._kept if matches(pattern, "/".join(key))] if pattern else []
        if not covered and "*" not in pattern:
            raise Refused(codes.UNKNOWN_NAME, f"There is no {pattern!r}.")
        for key in covered:
            self._remove(key)

    def items(self, now_ns: int) -> dict[Chunks, tuple[M, float]]:
        """What is there, with the seconds that each has left (0 = for ever)."""
        self._drop_ended(now_ns)
        return {
            chunks: (kept.message, 0.0 if kept.ends_ns is None else (kept.ends_ns - now_ns) * 1e-9)
            for chunks, kept in self._kept.items()
        }

    def _drop_ended(self, now_ns: int) -> None:
        for chunks in [
            key for key, kept in self._kept.items() if kept.ends_ns and kept.ends_ns <= now_ns
        ]:
            self._remove(chunks)

    def _remove(self, chunks: Chunks) -> None:
        kept = self._kept.pop(chunks, None)
        if kept is not None:
            self._num_bytes -= kept.num_bytes


def checked_marker(marker: Marker) -> Marker:
    """A marker as it is kept: a leading slash of its frame, as ROS 1 wrote it, is dropped."""
    frame = marker.frame.lstrip("/")
    if not frame:
        raise Refused(codes.BAD_REQUEST, "The marker names no frame.")
    return structs.replace(marker, frame=frame, pose=marker.pose.wrapped())


def new_markers() -> Drawings[Marker]:
    """A place for markers."""
    return Drawings(MAX_MARKERS)


def new_overlays() -> Drawings[Overlay]:
    """A place for overlays."""
    return Drawings(MAX_OVERLAYS)
