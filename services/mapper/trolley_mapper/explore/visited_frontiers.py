"""What came of the places that a robot explored: so that it does not try one for ever."""

import math
from dataclasses import dataclass

SAME_M = 0.6
"""Frontiers nearer to each other than this are one place."""
MOST_ARRIVALS = 2
"""A frontier that is still there after the robot has stood before it so often stays unknown."""
MOST_FAILURES = 2


@dataclass(slots=True)
class Entry:
    """One place and what came of it."""

    x: float
    """In the map [m]."""
    y: float
    arrivals: int = 0
    failures: int = 0

    @property
    def is_given_up(self) -> bool:
        """Whether it is not tried any more."""
        return self.arrivals >= MOST_ARRIVALS or self.failures >= MOST_FAILURES


class Notebook:
    """The places that did not simply vanish when the robot came."""

    def __init__(self) -> None:
        self._entries: list[Entry] = []

    def __len__(self) -> int:
        return len(self._entries)

    def find(self, x: float, y: float) -> Entry | None:
        """Return what is noted of a place in the map [m]."""
        nearest = min(self._entries, key=lambda one: _apart(one, x, y), default=None)
        return nearest if nearest is not None and _apart(nearest, x, y) <= SAME_M else None

    def note(self, x: float, y: float) -> Entry:
        """Return the entry of a place in the map [m], a new one if it has none."""
        entry = self.find(x, y)
        if entry is None:
            entry = Entry(x, y)
            self._entries.append(entry)
        return entry

    @property
    def num_failed(self) -> int:
        """Number of places that could not be reached."""
        return sum(one.failures > 0 and one.arrivals == 0 for one in self._entries)


def _apart(entry: Entry, x: float, y: float) -> float:
    return math.hypot(entry.x - x, entry.y - y)
