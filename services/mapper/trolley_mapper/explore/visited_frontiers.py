"""What became of the frontiers that a robot drove to, so that it does not try one forever."""

import math
from dataclasses import dataclass

SAME_M = 0.6
"""Distance within which frontiers are one place [m]."""
MAX_ARRIVALS = 2
"""Number of times that the robot stands before a frontier before it stays unknown."""
MAX_FAILURES = 2
"""Number of failures after which a frontier is not tried again."""
REGION_M = 1.5
"""Distance from failed goals within which frontiers belong to the same region [m]."""
MAX_BARREN = 2
"""Number of goals without new floor after which a region is dropped: behind a mirror the frontiers
move on, and what is seen there comes and goes."""


@dataclass(slots=True)
class Visits:
    """What came of the goals at one place."""

    x: float
    """x of the place in the map [m]."""
    y: float
    """y of the place in the map [m]."""
    arrivals: int = 0
    failures: int = 0

    def is_given_up(self, *, is_squeezed: bool) -> bool:
        """Say whether it is not tried any more; once more where the robot squeezes into it."""
        return self.arrivals >= MAX_ARRIVALS + is_squeezed or self.failures >= MAX_FAILURES


class VisitedFrontiers:
    """The places that goals were sent to and that did not simply vanish when the robot came."""

    def __init__(self) -> None:
        self._places: list[Visits] = []
        self._barren: list[Visits] = []

    def __len__(self) -> int:
        return len(self._places)

    def find(self, x: float, y: float) -> Visits | None:
        """Return what is known of a place in the map [m]."""
        nearest = min(self._places, key=lambda one: _distance(one, x, y), default=None)
        return nearest if nearest is not None and _distance(nearest, x, y) <= SAME_M else None

    def find_or_add(self, x: float, y: float) -> Visits:
        """Return what is known of a place in the map [m], as yet nothing if it is new."""
        visits = self.find(x, y)
        if visits is None:
            visits = Visits(x, y)
            self._places.append(visits)
        return visits

    def add_barren(self, x: float, y: float) -> None:
        """Note that a goal at a place in the map [m] added no floor."""
        self._barren.append(Visits(x, y))

    def is_barren(self, x: float, y: float, *, is_squeezed: bool) -> bool:
        """Say whether the region round a place in the map [m] is not worth another goal.

        From before a narrow door little is seen: where the robot squeezes it is worth one more.
        """
        near = sum(_distance(one, x, y) <= REGION_M for one in self._barren)
        return near >= MAX_BARREN + is_squeezed

    @property
    def num_failed(self) -> int:
        """Number of places that could not be reached."""
        return sum(one.failures > 0 and one.arrivals == 0 for one in self._places)


def _distance(visits: Visits, x: float, y: float) -> float:
    return math.hypot(visits.x - x, visits.y - y)
