"""Finding frames in a stream of bytes: whatever the chunks, exactly those that the rule accepts.

The rule: at each position, if a header matches there and the frame's check holds, the frame is
accepted and the search goes on behind it; otherwise it goes on at the next byte. A position whose
frame has not arrived in full waits for the rest.

Counts: `lidar/bad_checksum`, headers that match at a frame whose check fails;
`lidar/skipped_bytes`, bytes that belong to no accepted frame.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
Indices = NDArray[np.int64]
Flags = NDArray[np.bool_]

BAD_CHECKSUM = "lidar/bad_checksum"
SKIPPED_BYTES = "lidar/skipped_bytes"


@dataclass(frozen=True, slots=True)
class FrameFormat:
    """What a frame looks like.

    Attributes:
        head_bytes: so many bytes tell whether a frame begins here, and how long it is.
        most_bytes: length of the longest frame.
        lengths: of (n, head_bytes) heads: (n,) lengths of the frames, 0 where none begins.
        check: of (n, most_bytes) frames, what lies behind a shorter one being anything: (n,)
            whether the check holds.
    """

    head_bytes: int
    most_bytes: int
    lengths: Callable[[Bytes], Indices]
    check: Callable[[Bytes], Flags]


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """Accepted frames, in order.

    Attributes:
        data: (n, most_bytes) uint8; behind a shorter frame lies anything.
        lengths: (n,) bytes.
        behind: (n,) bytes that had arrived behind the frame.
        joins: (n,) whether it began right where the frame before it ended.
    """

    data: Bytes
    lengths: Indices
    behind: Indices
    joins: Flags

    def __len__(self) -> int:
        return len(self.lengths)


class FrameFinder:
    """Finds the frames of one stream; keeps less than one frame between two calls.

    Args:
        form: what a frame looks like.
        counts: what goes wrong is added here.
    """

    def __init__(self, form: FrameFormat, counts: Counter[str]) -> None:
        self._form = form
        self._counts = counts
        self._rest: Bytes = np.empty(0, np.uint8)
        self._has_gap = True

    @property
    def held_bytes(self) -> int:
        """How many bytes wait for what follows them; less than the longest frame."""
        return len(self._rest)

    def feed(self, data: bytes) -> Frames:
        """Return the frames that these bytes complete."""
        buffer = np.concatenate([self._rest, np.frombuffer(data, np.uint8)])
        return self._feed_seamless(buffer) or self._search(buffer)

    def _feed_seamless(self, buffer: Bytes) -> Frames | None:
        """Return frames of the longest length that follow each other from the first byte on.

        It is what nearly all of a good line is, and takes a third of the search.

        Returns:
            None where anything else lies between or behind them.
        """
        form, size = self._form, self._form.most_bytes
        number = len(buffer) // size
        rest = buffer[number * size :]
        if number == 0 or 0 < len(rest) < form.head_bytes:
            return None
        whole = buffer[: number * size].reshape(number, size)
        heads = whole[:, : form.head_bytes]
        if len(rest):
            heads = np.concatenate([heads, rest[None, : form.head_bytes]])
        if not (form.lengths(heads) == size).all() or not form.check(whole).all():
            return None
        joins = np.ones(number, np.bool_)
        joins[0] = not self._has_gap
        self._has_gap = False
        self._rest = rest.copy()
        behind = len(buffer) - size * np.arange(1, number + 1)
        return Frames(whole, np.full(number, size), behind, joins)

    def _search(self, buffer: Bytes) -> Frames:
        """Return the frames of a buffer that holds anything."""
        starts, ends = self._candidates(buffer)
        is_whole = ends <= len(buffer)
        whole, whole_ends = starts[is_whole], ends[is_whole]
        padded = np.concatenate([buffer, np.zeros(self._form.most_bytes, np.uint8)])
        windows = _windows(padded, self._form.most_bytes)[whole]
        good = self._form.check(windows)
        chosen = _chain(whole, whole_ends, good)
        undecided = len(buffer) - self._form.head_bytes + 1
        for start in starts[~is_whole].tolist():
            if not _covers(whole[chosen], whole_ends[chosen], start):
                chosen = chosen[whole[chosen] < start]
                undecided = start
                break
        first, last = whole[chosen], whole_ends[chosen]
        kept_from = max(undecided, int(last[-1]) if len(last) else 0, 0)
        self._count(whole[~good & (whole < kept_from)], first, last, kept_from)
        joins = self._join(first, last, kept_from)
        self._rest = buffer[kept_from:].copy()
        return Frames(windows[chosen], last - first, len(buffer) - last, joins)

    def _candidates(self, buffer: Bytes) -> tuple[Indices, Indices]:
        """Return where headers match, and where those frames end."""
        if len(buffer) < self._form.head_bytes:
            return np.empty(0, np.int64), np.empty(0, np.int64)
        lengths = self._form.lengths(_windows(buffer, self._form.head_bytes))
        starts = np.flatnonzero(lengths)
        return starts, starts + lengths[starts]

    def _count(self, bad: Indices, first: Indices, last: Indices, kept_from: int) -> None:
        """Count what lies in no accepted frame."""
        if skipped := kept_from - int((last - first).sum()):
            self._counts[SKIPPED_BYTES] += skipped
        if wrong := sum(not _covers(first, last, start) for start in bad.tolist()):
            self._counts[BAD_CHECKSUM] += wrong

    def _join(self, first: Indices, last: Indices, kept_from: int) -> Flags:
        if not len(first):
            self._has_gap |= kept_from > 0
            return np.empty(0, np.bool_)
        joins = np.empty(len(first), np.bool_)
        joins[0] = not self._has_gap and first[0] == 0
        joins[1:] = first[1:] == last[:-1]
        self._has_gap = bool(kept_from > last[-1])
        return joins


def _windows(buffer: Bytes, width: int) -> Bytes:
    """Return a view (n, width) of all that begins at each byte.

    numpy's `sliding_window_view` takes longer than all else that is done with a chunk.
    """
    return np.ndarray((len(buffer) - width + 1, width), np.uint8, buffer, strides=(1, 1))


def _chain(starts: Indices, ends: Indices, good: Flags) -> Indices:
    """Return which good frames are accepted: each the first behind the one before."""
    chosen = np.flatnonzero(good)
    if not (starts[chosen[1:]] < ends[chosen[:-1]]).any():
        return chosen
    kept: list[int] = []
    free = 0
    for index in chosen.tolist():
        if starts[index] >= free:
            kept.append(index)
            free = ends[index]
    return np.array(kept, np.int64)


def _covers(first: Indices, last: Indices, position: int) -> bool:
    """Say whether a position lies within one of these frames."""
    index = int(np.searchsorted(first, position, side="right")) - 1
    return index >= 0 and bool(last[index] > position)
