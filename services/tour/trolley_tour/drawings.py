"""Markers and overlays that programs drew, kept in memory for viewers that come later."""

import dataclasses
from typing import Generic, TypeVar

import msgspec
from msgspec import structs

from trolley import codes, topics
from trolley.codes import Refused
from trolley.messages import Marker, Overlay
from trolley.runtime.bus import matches
from trolley.runtime.service import Service, gets, on, on_delete
from trolley_tour.stored.checks import plain_name

M = TypeVar("M", bound=msgspec.Struct)
Chunks = tuple[str, ...]

MAX_MARKERS = topics.MARKER.max_keys
MAX_OVERLAYS = 500
MAX_BYTES = topics.MARKER.max_kept_bytes
"""Greatest size of all markers together, and of all overlays [bytes]."""


@dataclasses.dataclass(frozen=True)
class _Kept(Generic[M]):
    message: M
    num_bytes: int
    ends_ns: int | None


class DrawingStore(Generic[M]):
    """Drawings of one kind by the varying chunks of their keys; times are of the local clock."""

    def __init__(self, max_number: int, max_bytes: int = MAX_BYTES) -> None:
        self._max_number = max_number
        self._max_bytes = max_bytes
        self._kept: dict[Chunks, _Kept[M]] = {}
        self._num_bytes = 0

    def __len__(self) -> int:
        return len(self._kept)

    def put(self, chunks: Chunks, message: M, now_ns: int, lifetime_s: float = 0.0) -> None:
        """Keep a drawing, in place of the one under the same key; `lifetime_s` 0 = forever.

        Raises:
            Refused: A chunk of its key is not a valid name, or there are too many.
        """
        chunks = tuple(plain_name(chunk) for chunk in chunks)
        num_bytes = len(msgspec.msgpack.encode(message))
        before = self._kept.get(chunks)
        num_before = 0 if before is None else before.num_bytes
        self._drop_ended(now_ns)
        if before is None and len(self._kept) >= self._max_number:
            raise Refused(codes.TOO_LARGE, f"There are {self._max_number} already; delete some.")
        if self._num_bytes - num_before + num_bytes > self._max_bytes:
            raise Refused(
                codes.TOO_LARGE,
                f"They fill {self._max_bytes} bytes; delete some.",
            )
        self._remove(chunks)
        ends_ns = now_ns + int(lifetime_s * 1e9) if lifetime_s > 0.0 else None
        self._kept[chunks] = _Kept(message, num_bytes, ends_ns)
        self._num_bytes += num_bytes

    def delete(self, chunks: Chunks) -> None:
        """Delete a drawing, or all whose key these chunks with wildcards cover.

        Raises:
            Refused: There is no such drawing.
        """
        pattern = "/".join(chunks)
        covered = [key for key in self._kept if matches(pattern, "/".join(key))] if pattern else []
        if not covered and "*" not in pattern:
            raise Refused(codes.UNKNOWN_NAME, f"There is no {pattern!r}.")
        for key in covered:
            self._remove(key)

    def items(self, now_ns: int) -> dict[Chunks, tuple[M, float]]:
        """What is there, with the seconds that each has left (0 = forever)."""
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


class Drawings:
    """Keeps the markers and overlays until they are deleted or their lifetime ends."""

    def __init__(self, service: Service) -> None:
        self._service = service
        self._markers: DrawingStore[Marker] = DrawingStore(MAX_MARKERS)
        self._overlays: DrawingStore[Overlay] = DrawingStore(MAX_OVERLAYS)

    @on(topics.MARKER)
    def _put_marker(self, marker: Marker, ns: str, marker_id: str) -> None:
        now_ns = self._service.monotonic_ns
        self._markers.put((ns, marker_id), checked_marker(marker), now_ns, marker.lifetime)

    @on_delete(topics.MARKER)
    def _delete_markers(self, *chunks: str) -> None:
        self._markers.delete(chunks)

    @gets(topics.MARKER)
    def _get_markers(self, parameters: dict[str, str]) -> dict[Chunks, Marker]:
        del parameters
        return {
            chunks: structs.replace(marker, lifetime=left_s)
            for chunks, (marker, left_s) in self._markers.items(self._service.monotonic_ns).items()
        }

    @on(topics.OVERLAY)
    def _put_overlay(self, overlay: Overlay, overlay_id: str) -> None:
        self._overlays.put((overlay_id,), overlay, self._service.monotonic_ns)

    @on_delete(topics.OVERLAY)
    def _delete_overlays(self, *chunks: str) -> None:
        self._overlays.delete(chunks)

    @gets(topics.OVERLAY)
    def _get_overlays(self, parameters: dict[str, str]) -> dict[Chunks, Overlay]:
        del parameters
        kept = self._overlays.items(self._service.monotonic_ns)
        return {chunks: overlay for chunks, (overlay, _) in kept.items()}
