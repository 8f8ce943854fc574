"""A planned path: points a few centimetres apart in frame `grid`, and where along it things are."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

SPACING_M = 0.05
"""Distance of neighbouring points."""


@dataclass(frozen=True, slots=True, eq=False)
class PlannedPath:
    """A path to the goal.

    Attributes:
        points: (n, 2) x, y [m] in `grid`, from the robot to the goal.
        remaining_m: (n,) length of the path from each point on.
        vias: for each via point that it leads through, the index of its point.
        cost: of the whole, in metres of free floor.
        is_tight: whether it leads where the robot fits only with less clearance than usual.
    """

    points: NDArray[np.float64]
    remaining_m: NDArray[np.float64]
    vias: tuple[int, ...]
    cost: float
    is_tight: bool = False

    @classmethod
    def join(
        cls, legs: list[NDArray[np.float64]], cost: float, is_tight: bool = False
    ) -> "PlannedPath":
        """Make a path of legs (n, 2) [m], each of which begins where the one before ended."""
        points = np.concatenate([legs[0], *(leg[1:] for leg in legs[1:])])
        steps: NDArray[np.float64] = np.diff(points, axis=0)
        lengths = np.hypot(steps[:, 0], steps[:, 1])
        remaining = np.append(np.cumsum(lengths[::-1])[::-1], 0.0)
        ends = np.cumsum([len(leg) - 1 for leg in legs])[:-1]
        return cls(points, remaining, tuple(int(end) for end in ends), cost, is_tight)

    @property
    def length_m(self) -> float:
        """Length of the whole path [m]."""
        return float(self.remaining_m[0])

    def without_first_via(self) -> "PlannedPath":
        """Return the same path after its first via point was passed."""
        return replace(self, vias=self.vias[1:])

    def nearest(self, x: float, y: float, first: int, reach_m: float) -> int:
        """Return the index of the nearest point among those up to `reach_m` on from `first`."""
        last = self.ahead(first, reach_m)
        part = self.points[first : last + 1]
        return first + int(np.argmin(np.hypot(part[:, 0] - x, part[:, 1] - y)))

    def ahead(self, first: int, length_m: float) -> int:
        """Return the index of the last point at most `length_m` on from index `first`."""
        wanted = self.remaining_m[first] - length_m
        beyond = int(np.searchsorted(-self.remaining_m, -float(wanted), side="right"))
        return max(first, beyond - 1)

    def headings(self, goal_yaw: float) -> NDArray[np.float64]:
        """Return the direction of travel at each point [rad], at the end that of the goal."""
        if len(self.points) < 2:
            return np.array([goal_yaw])
        steps = np.diff(self.points, axis=0)
        return np.append(np.arctan2(steps[:, 1], steps[:, 0]), goal_yaw)
