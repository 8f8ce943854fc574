"""The last minutes of a value: every one that came, thinned out only for drawing."""

import csv
import io
import math

import numpy as np
from numpy.typing import NDArray

MAX_POINTS = 6000
KEPT_NS = 600 * 10**9
"""Older values are forgotten [ns]."""
GAP_S = 2.0
"""The line is broken where nothing came for longer than this and than three times the usual gap."""


class History:
    """Values in the order of their arrival, at most 6000 of the last 10 minutes."""

    def __init__(self) -> None:
        # Twice as many as are kept, so that what is kept lies in one piece and is seldom moved.
        self._arrived_ns = np.zeros(2 * MAX_POINTS, np.int64)
        self._stamps_ns = np.zeros(2 * MAX_POINTS, np.int64)
        self._values = np.zeros(2 * MAX_POINTS, np.float64)
        self._kept = slice(0, 0)

    def __len__(self) -> int:
        return self._kept.stop - self._kept.start

    def add(self, arrived_ns: int, stamp_ns: int, value: float | None) -> None:
        """Take a value.

        Args:
            arrived_ns: when it came, by the local monotonic clock.
            stamp_ns: robot time that it holds for, 0 where the sender had none.
            value: None breaks the line.
        """
        start, end = self._kept.start, self._kept.stop
        if end == 2 * MAX_POINTS:
            for column in (self._arrived_ns, self._stamps_ns, self._values):
                column[: end - start] = column[start:end]
            start, end = 0, end - start
        self._arrived_ns[end], self._stamps_ns[end] = arrived_ns, stamp_ns
        self._values[end] = math.nan if value is None else value
        start = max(start, end + 1 - MAX_POINTS)
        while arrived_ns - self._arrived_ns[start] > KEPT_NS:
            start += 1
        self._kept = slice(start, end + 1)

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
        arrived_ns = self._arrived_ns[self._kept]
        first = int(np.searchsorted(arrived_ns, now_ns - int(window_s * 1e9)))
        times = (arrived_ns[first:] - now_ns).astype(np.float64) * 1e-9
        values = self._values[self._kept][first:].copy()
        if not len(times):
            return []
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
        stamps_ns, values = self._stamps_ns[self._kept].tolist(), self._values[self._kept].tolist()
        table.writerows(
            (stamp_ns, "" if math.isnan(value) else value * scale)
            for stamp_ns, value in zip(stamps_ns, values, strict=True)
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
