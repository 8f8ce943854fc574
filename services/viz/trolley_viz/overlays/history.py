"""The last minutes of a value: every one that came, thinned out only for drawing."""

import csv
import io
import math
from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

MAX_POINTS = 6000
KEPT_NS = 600 * 10**9
"""How long ago is forgotten [ns]."""
GAP_S = 2.0
"""Where nothing came for longer than this, and than three times the usual, the line is broken."""


class Point(NamedTuple):
    """A value and when it came."""

    arrived_ns: int
    """By the local monotonic clock."""
    stamp_ns: int
    """Robot time, 0 where the sender had none."""
    value: float
    """NaN: nothing known."""


class History:
    """Values in the order of their arrival, at most 6000 of the last 10 minutes."""

    def __init__(self) -> None:
        self._points: deque[Point] = deque(maxlen=MAX_POINTS)

    def __len__(self) -> int:
        return len(self._points)

    def add(self, arrived_ns: int, stamp_ns: int, value: float | None) -> None:
        """Take a value; None breaks the line."""
        self._points.append(Point(arrived_ns, stamp_ns, math.nan if value is None else value))
        while arrived_ns - self._points[0].arrived_ns > KEPT_NS:
            self._points.popleft()

    def clear(self) -> None:
        """Forget everything."""
        self._points.clear()

    def lines(
        self, now_ns: int, window_s: float, columns: int
    ) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
        """The last seconds as unbroken lines.

        Args:
            now_ns: local monotonic time.
            window_s: how far back.
            columns: how many pixels wide it is drawn; of more points than two a pixel only the
                highest and the lowest of each pixel are kept.

        Returns:
            For each line the times [s], 0 now and negative before, and the values.
        """
        since_ns = now_ns - int(window_s * 1e9)
        recent = [one for one in self._points if one.arrived_ns >= since_ns]
        if not recent:
            return []
        times = np.array([(one.arrived_ns - now_ns) * 1e-9 for one in recent])
        values = np.array([one.value for one in recent])
        steps = np.diff(times)
        gap_s = max(GAP_S, 3.0 * float(np.median(steps))) if len(steps) else GAP_S
        known = np.isfinite(values)
        group = np.concatenate([[0], np.cumsum((steps > gap_s) | ~known[1:] | ~known[:-1])])
        times, values, group = times[known], values[known], group[known]
        starts = np.flatnonzero(np.diff(group, prepend=-1))
        return [
            _thinned(t, v, window_s, columns)
            for t, v in zip(np.split(times, starts[1:]), np.split(values, starts[1:]), strict=True)
            if len(t)
        ]

    def csv(self, scale: float = 1.0) -> str:
        """All that is kept, times `scale`, as a table; an unknown value is an empty cell."""
        out = io.StringIO()
        table = csv.writer(out, lineterminator="\n")
        table.writerow(["stamp_ns", "value"])
        table.writerows(
            (one.stamp_ns, "" if math.isnan(one.value) else one.value * scale)
            for one in self._points
        )
        return out.getvalue()


def _thinned(
    times: NDArray[np.float64], values: NDArray[np.float64], window_s: float, columns: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    if len(times) <= 2 * columns:
        return times, values
    column = np.floor((times + window_s) / window_s * columns).astype(np.int64)
    starts = np.flatnonzero(np.diff(column, prepend=-1))
    keep = {0, len(times) - 1}
    for start, piece in zip(starts.tolist(), np.split(values, starts[1:]), strict=True):
        keep.update((start + int(piece.argmin()), start + int(piece.argmax())))
    kept = np.array(sorted(keep))
    return times[kept], values[kept]
