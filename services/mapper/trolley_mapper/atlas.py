"""Keyframes, where they were taken, and the edges between them."""

import heapq
import math
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from trolley_mapper.graph import Edge, between
from trolley_mapper.keyframe import Keyframe

# Drift between two keyframes that see the same is at least that of so long a way [m].
_LEAST_COST_M = 0.15


class Atlas:
    """All keyframes in the order in which they were taken."""

    def __init__(self) -> None:
        self.keyframes: list[Keyframe] = []
        self.rows: dict[int, int] = {}
        self.poses = np.empty((0, 3))
        self.edges: list[Edge] = []
        self._neighbours: dict[int, dict[int, float]] = {}

    def __len__(self) -> int:
        return len(self.keyframes)

    @property
    def newest(self) -> Keyframe:
        """The keyframe taken last."""
        return self.keyframes[-1]

    def copy(self) -> "Atlas":
        """Return one that can be changed apart; the keyframes never change."""
        other = Atlas()
        other.keyframes, other.rows = list(self.keyframes), dict(self.rows)
        other.poses, other.edges = self.poses.copy(), list(self.edges)
        other._neighbours = {number: dict(near) for number, near in self._neighbours.items()}
        return other

    def pose(self, number: int) -> NDArray[np.float64]:
        """Return map_T_base (3,) of a keyframe."""
        return self.poses[self.rows[number]]

    def add(self, keyframe: Keyframe, pose: NDArray[np.float64], edges: Iterable[Edge]) -> None:
        """Append a keyframe with its edges to earlier ones."""
        self.rows[keyframe.number] = len(self.keyframes)
        self.keyframes.append(keyframe)
        self.poses = np.vstack([self.poses, pose])
        self._neighbours[keyframe.number] = {}
        for edge in edges:
            self.link(edge)

    def link(self, edge: Edge) -> None:
        """Add an edge between two keyframes."""
        self.edges.append(edge)
        cost = max(math.hypot(edge.step[0], edge.step[1]), _LEAST_COST_M)
        for one, other in ((edge.first, edge.second), (edge.second, edge.first)):
            near = self._neighbours[one]
            near[other] = min(cost, near.get(other, math.inf))

    def remove(self, numbers: Iterable[int]) -> None:
        """Forget keyframes and their edges."""
        gone = set(numbers)
        kept = [row for row, one in enumerate(self.keyframes) if one.number not in gone]
        self.keyframes = [self.keyframes[row] for row in kept]
        self.poses = self.poses[kept]
        self.rows = {one.number: row for row, one in enumerate(self.keyframes)}
        edges = [e for e in self.edges if e.first not in gone and e.second not in gone]
        self.edges, self._neighbours = [], {number: {} for number in self.rows}
        for edge in edges:
            self.link(edge)

    def degree(self, number: int) -> int:
        """Return to how many keyframes one is tied."""
        return len(self._neighbours[number])

    def ways_from(self, number: int, limit_m: float) -> dict[int, float]:
        """Return how far other keyframes are along edges [m], as far as `limit_m`."""
        ways: dict[int, float] = {}
        queue = [(0.0, number)]
        while queue:
            way, at = heapq.heappop(queue)
            if at in ways:
                continue
            ways[at] = way
            for other, cost in self._neighbours[at].items():
                if other not in ways and way + cost <= limit_m:
                    heapq.heappush(queue, (way + cost, other))
        return ways

    def choose_near(
        self,
        numbers: Iterable[int],
        pose: NDArray[np.float64],
        most: int,
        always: Sequence[int] = (),
    ) -> list[int]:
        """Choose keyframes near a pose that lie apart from each other, the oldest first.

        Args:
            numbers: to choose from.
            pose: (3,) map_T_base.
            most: how many at most.
            always: chosen first.
        """
        some = list(numbers)
        if not some:
            return []
        poses = self.poses[[self.rows[number] for number in some]]
        steps = between(pose, poses)
        # A keyframe that looks another way shows less of what is seen from here.
        order = np.argsort(np.hypot(steps[:, 0], steps[:, 1]) + 0.3 * np.abs(steps[:, 2]))
        chosen, kept = list(always), [self.pose(number) for number in always]
        for row in order:
            if len(chosen) >= most:
                break
            if some[row] in chosen:
                continue
            apart = between(poses[row], np.array(kept).reshape(-1, 3))
            if np.any(np.hypot(apart[:, 0], apart[:, 1]) + 0.5 * np.abs(apart[:, 2]) < 0.2):
                continue
            chosen.append(some[row])
            kept.append(poses[row])
        return sorted(chosen)
