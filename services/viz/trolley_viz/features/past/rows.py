"""Rows of a table by time, oldest first, in memory of a fixed size."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

AT = "at_ns"
"""The column of the time [ns], which grows from row to row."""


class Rows:
    """The newest rows, or rows of all the time that lie farther and farther apart.

    Args:
        kind: the columns; one of them is `at_ns`.
        capacity: how many rows there are at most; two or more where it thins.
        thins: whether every second row goes where there is no room, instead of the oldest.
    """

    def __init__(self, kind: np.dtype[Any], capacity: int, *, thins: bool = False) -> None:
        self._kind, self._capacity, self._thins = kind, capacity, thins
        # Twice the room: rows stay in one piece, and are moved once in `capacity` rows.
        self._room = np.zeros(2 * capacity, kind)
        self._first = self._past = 0
        self.gap_ns = 0
        """The least time between two rows [ns], once some had to go."""

    @property
    def rows(self) -> NDArray[Any]:
        """All rows, as they stand in memory: they change with the next."""
        return self._room[self._first : self._past]

    @property
    def num_bytes(self) -> int:
        """How much memory it takes."""
        return self._room.nbytes

    def append(self, row: tuple[Any, ...]) -> bool:
        """Add a row; False where it comes too soon after the last one, or lies before it."""
        at_ns, rows = int(row[0]), self.rows
        if len(rows) and at_ns < int(rows[AT][-1]) + max(self.gap_ns, 1):
            return False
        if len(rows) == self._capacity:
            self._make_room()
        if self._past == len(self._room):
            self._move(self.rows)
        self._room[self._past] = row
        self._past += 1
        return True

    def drop_before(self, at_ns: int) -> None:
        """Forget what is older."""
        self._first += int(np.searchsorted(self.rows[AT], at_ns, side="left"))

    def index(self, at_ns: int) -> int:
        """The index of the newest row that is not newer than a time, -1 where there is none."""
        return int(np.searchsorted(self.rows[AT], at_ns, side="right")) - 1

    def copy(self) -> "Rows":
        """The same rows; nothing more is to be added to them."""
        copy = Rows(self._kind, 0)
        copy._room, copy._past, copy.gap_ns = self.rows.copy(), len(self.rows), self.gap_ns
        return copy

    def fill(self, rows: NDArray[Any], gap_ns: int) -> None:
        """Take rows in place of those that there are."""
        self._move(rows[-self._capacity :])
        self.gap_ns = gap_ns

    # Inside.
    def _make_room(self) -> None:
        if not self._thins:
            self._first += 1
            return
        self._move(self.rows[::2])
        times = self.rows[AT]
        self.gap_ns = int(times[-1] - times[0]) // max(len(times) - 1, 1)

    def _move(self, rows: NDArray[Any]) -> None:
        """Put rows, which may lie anywhere in the room, at its beginning."""
        rows = rows.copy()
        self._room[: len(rows)] = rows
        self._first, self._past = 0, len(rows)
