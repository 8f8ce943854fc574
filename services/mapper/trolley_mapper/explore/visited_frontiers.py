"""What became of the frontiers that a robot drove to, so that it does not try one forever."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

from trolley_mapper.explore.frontiers import Frontier


@dataclass(frozen=True, slots=True)
class Patience:
    """How often a place is tried. Set by hand."""

    by_goal: bool = False
    """Whether the places are those of the goals, not those that they are to show."""
    same_m: float = 0.6
    """Distance within which these are one place [m]."""
    max_arrivals: int = 2
    """Number of times that the robot stands before a frontier before it stays unknown."""
    max_failures: int = 2
    """Number of failures after which a frontier is not tried again."""
    region_m: float = 1.5
    """Distance from failed goals within which frontiers belong to the same region [m]."""
    max_barren: int = 2
    """Number of goals without new floor after which a region is dropped: behind a mirror the
    frontiers move on, and what is seen there comes and goes."""


PATIENCE = Patience()
SQUEEZED = Patience(by_goal=True, same_m=0.08, max_arrivals=1, max_barren=3)
"""Where the robot squeezes: from a little farther in a door much more is seen, and many a goal
comes to lie in a wall as the map grows."""


@dataclass(slots=True)
class Visits:
    """What came of the goals at one place."""

    x: float
    """x of the place in the map [m]."""
    y: float
    """y of the place in the map [m]."""
    arrivals: int = 0
    failures: int = 0


class VisitedFrontiers:
    """The places that goals were sent to and that did not simply vanish when the robot came."""

    def __init__(self, patience: Patience = PATIENCE) -> None:
        self._patience = patience
        self._places: list[Visits] = []
        self._barren: list[Visits] = []

    def __len__(self) -> int:
        return len(self._places)

    def find(self, frontier: Frontier) -> Visits | None:
        """Return what is known of the place of a frontier."""
        x, y = self._place(frontier)
        nearest = min(self._places, key=lambda one: _distance(one, x, y), default=None)
        if nearest is None or _distance(nearest, x, y) > self._patience.same_m:
            return None
        return nearest

    def find_or_add(self, frontier: Frontier) -> Visits:
        """Return what is known of the place of a frontier, as yet nothing if it is new."""
        visits = self.find(frontier)
        if visits is None:
            visits = Visits(*self._place(frontier))
            self._places.append(visits)
        return visits

    def has_failed(self, frontier: Frontier) -> bool:
        """Say whether a frontier could not be reached so far."""
        visits = self.find(frontier)
        return visits is not None and visits.failures > 0 and visits.arrivals == 0

    def add_barren(self, frontier: Frontier) -> None:
        """Note that a goal added no floor."""
        self._barren.append(Visits(*self._place(frontier)))

    def is_given_up(self, frontier: Frontier) -> bool:
        """Say whether a frontier, or the region round it, is not tried any more."""
        patience, visits, (x, y) = self._patience, self.find(frontier), self._place(frontier)
        near = sum(_distance(one, x, y) <= patience.region_m for one in self._barren)
        if near >= patience.max_barren:
            return True
        return visits is not None and (
            visits.arrivals >= patience.max_arrivals or visits.failures >= patience.max_failures
        )

    def _place(self, frontier: Frontier) -> tuple[float, float]:
        """Return x and y in the map [m]."""
        at = frontier.goal if self._patience.by_goal else frontier
        return at.x, at.y


def num_places(points: Iterable[tuple[float, float]]) -> int:
    """Return how many places there are, where those near each other in the map [m] are one."""
    places: list[Visits] = []
    for x, y in points:
        if all(_distance(one, x, y) > PATIENCE.same_m for one in places):
            places.append(Visits(x, y))
    return len(places)


def _distance(visits: Visits, x: float, y: float) -> float:
    return math.hypot(visits.x - x, visits.y - y)
