"""Keyframes, where they were taken, and the edges between them."""

import heapq
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley_mapper.slam.keyframe import Keyframe
from trolley_mapper.slam.pose_graph import (
    SCAN_MATCH,
    Edge,
    averaged,
    between,
    chained,
    compose,
    inverted,
)


@dataclass(frozen=True, slots=True)
class KeyframeStoreParams:
    """How keyframes nearby are chosen. Set by hand."""

    min_edge_m: float = 0.15
    """Least length that an edge counts as: two keyframes that see the same drift, too [m]."""
    metres_per_dev: float = 20.0
    """Length that each metre of an edge's standard deviation counts as: as much as drifts by that.
    A scan that was matched in a bare corridor shows beside which wall it was taken, not how far
    along it [m/m]."""
    alike_distance_m: float = 2.0
    """Distance along edges within which similar keyframes are searched for [m]."""
    turn_m: float = 0.3
    """Distance that a turn by 1 rad counts as: a keyframe with another heading shows less of what
    is seen from here [m/rad]."""
    apart_turn_m: float = 0.5
    """Distance that a turn by 1 rad between chosen keyframes counts as [m/rad]."""
    min_apart_m: float = 0.2
    """Least distance between chosen keyframes [m]."""
    well_tied: int = 6
    """Number of keyframes with an edge to one from which on what a dissolved keyframe said of it is
    not kept: repeats of the same scans err as one."""


PARAMS = KeyframeStoreParams()


class KeyframeStore:
    """All keyframes in the order in which they were taken.

    Edges join them into parts. The first keyframe's part is the map; the other parts are loose:
    where they lie on it is not known yet.
    """

    def __init__(self) -> None:
        self.keyframes: list[Keyframe] = []
        self.rows: dict[int, int] = {}
        self.poses = np.empty((0, 3))
        self.edges: list[Edge] = []
        # Of the odometry's distances, as it is known now.
        self.scale = 1.0
        self._neighbours: dict[int, dict[int, float]] = {}
        # The lowest number of the part that a keyframe is in.
        self._parts: dict[int, int] = {}

    @property
    def num_bytes(self) -> int:
        """What keyframes and edges take, about."""
        return sum(one.num_bytes for one in self.keyframes) + 500 * len(self.edges)

    def __len__(self) -> int:
        return len(self.keyframes)

    @property
    def newest(self) -> Keyframe:
        """The keyframe taken last."""
        return self.keyframes[-1]

    def copy(self) -> "KeyframeStore":
        """Return a copy that can be changed on its own; the keyframes never change."""
        other = KeyframeStore()
        other.keyframes, other.rows = list(self.keyframes), dict(self.rows)
        other.poses, other.edges = self.poses.copy(), list(self.edges)
        other.scale = self.scale
        other._neighbours = {number: dict(near) for number, near in self._neighbours.items()}
        other._parts = dict(self._parts)
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
        self._parts[keyframe.number] = keyframe.number
        for edge in edges:
            self.link(edge)

    # Parts.

    def part_of(self, number: int) -> list[int]:
        """Return the keyframes connected with one by edges, itself included, the oldest first."""
        part = self._parts[number]
        return [one.number for one in self.keyframes if self._parts[one.number] == part]

    def is_loose(self, number: int) -> bool:
        """Say whether no edges lead from the first keyframe to this one."""
        return self._parts[number] != self._parts[self.keyframes[0].number]

    @property
    def loose(self) -> NDArray[np.bool_]:
        """(n,) which keyframes belong to loose parts."""
        return np.array([self.is_loose(one.number) for one in self.keyframes], bool)

    @property
    def anchored_rows(self) -> list[int]:
        """The first row of each part: its pose stays when the others are optimised."""
        parts = [self._parts[one.number] for one in self.keyframes]
        return [parts.index(part) for part in dict.fromkeys(parts)]

    @property
    def prior(self) -> int | None:
        """Number of the earlier map, if there is one."""
        first = self.keyframes[0] if self.keyframes else None
        return first.number if first is not None and first.is_prior else None

    def has(self, edge: Edge) -> bool:
        """Say whether both ends of an edge are here."""
        return edge.first in self.rows and edge.second in self.rows

    def link(self, edge: Edge) -> None:
        """Add an edge between two keyframes."""
        self._connect(edge)
        one, other = sorted((self._parts[edge.first], self._parts[edge.second]))
        if one != other:
            self._parts.update({n: one for n, part in self._parts.items() if part == other})

    def cut(self, edges: Sequence[Edge]) -> None:
        """Remove edges; whatever only they joined becomes a loose part."""
        self._reconnect([edge for edge in self.edges if all(edge is not one for one in edges)])

    def _connect(self, edge: Edge) -> None:
        self.edges.append(edge)
        # A map made before is as large as it is: its origin lies anywhere.
        length = 0.0 if edge.first == self.prior else math.hypot(edge.step[0], edge.step[1])
        cost = max(length, PARAMS.min_edge_m)
        if edge.kind == SCAN_MATCH:
            cost = max(cost, PARAMS.metres_per_dev * _deviation_m(edge))
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
        self._reconnect(edges)

    def _reconnect(self, edges: list[Edge]) -> None:
        """Take these edges in place of all that there are."""
        self.edges, self._neighbours = [], {number: {} for number in self.rows}
        for edge in edges:
            self._connect(edge)
        self._parts = {}
        for number in sorted(self.rows):
            if number not in self._parts:
                self._parts.update(dict.fromkeys(self.distances_from(number, math.inf), number))

    def dissolve(self, number: int) -> None:
        """Forget a keyframe, but keep what its edges say of the others.

        All its neighbours get edges from the one that its best edge leads to: a star in place of
        the clique of a full marginalisation, less what is well tied without, so that the number of
        edges does not grow.

        Source:
            Carlevaris-Bianco, Kaess, Eustice, Generic Node Removal for Factor-Graph SLAM (2014), of
            the sparse ones; dropping what is well tied is our own.
        """
        own = [e.settled(self.scale) for e in self.edges if number in (e.first, e.second)]
        away = [e if e.first == number else inverted(e) for e in own]
        if len(away) > 1:
            hub = max(away, key=lambda e: float(np.linalg.det(e.information)))
            for edge in away:
                if edge.second != hub.second and not self._are_well_tied(hub.second, edge.second):
                    self._merge(chained(inverted(hub), edge))
        self.remove([number])

    def _are_well_tied(self, one: int, other: int) -> bool:
        """Say whether two keyframes have many edges, and a third one ties them to each other."""
        near, far = self._neighbours[one], self._neighbours[other]
        if other in near or min(len(near), len(far)) <= PARAMS.well_tied:
            return False
        return len(near.keys() & far.keys()) > 1

    def _merge(self, edge: Edge) -> None:
        """Add an edge, or average it with the one there is between the same keyframes."""
        for row, other in enumerate(self.edges):
            if (other.first, other.second) == (edge.first, edge.second):
                self.edges[row] = averaged(other.settled(self.scale), edge)
                return
            if (other.second, other.first) == (edge.first, edge.second):
                self.edges[row] = averaged(other.settled(self.scale), inverted(edge))
                return
        self.link(edge if edge.first < edge.second else inverted(edge))

    def alike(self, away_m: float, turned_rad: float) -> list[int]:
        """Return the keyframes, the newest among them, that lie that near to the newest."""
        near = [
            n
            for n in self.distances_from(self.newest.number, PARAMS.alike_distance_m)
            if n != self.prior
        ]
        steps = between(self.poses[-1], self.poses[[self.rows[n] for n in near]])
        is_near = np.hypot(steps[:, 0], steps[:, 1]) < away_m
        is_alike = is_near & (np.abs(steps[:, 2]) < turned_rad)
        return sorted(number for number, same in zip(near, is_alike, strict=True) if same)

    def most_crowded(self, numbers: Sequence[int], among: Sequence[int]) -> int:
        """Return that of some keyframes that has another one of `among` nearest to it."""
        poses = self.poses[[self.rows[number] for number in numbers]]
        others = self.poses[[self.rows[number] for number in among]]
        steps = between(poses[:, None], others[None])
        away = np.hypot(steps[..., 0], steps[..., 1]) + PARAMS.apart_turn_m * np.abs(steps[..., 2])
        away[np.equal.outer(numbers, among)] = math.inf
        return numbers[int(np.argmin(away.min(axis=1)))]

    def nearest(self, pose: NDArray[np.float64]) -> int:
        """Return the number of the keyframe nearest to a pose (3,), the prior where no other."""
        away = np.hypot(*(self.poses[:, :2] - pose[:2]).T)
        if self.prior is not None and len(away) > 1:
            away[0] = math.inf
        return self.keyframes[int(np.argmin(away))].number

    def move_to(self, other: "KeyframeStore") -> tuple[NDArray[np.float64], list[Keyframe]]:
        """Take over the poses of an optimised copy; keyframes added since move along.

        Returns:
            The motion (3,) of the newest keyframes, new_map_T_old_map, and the keyframes that the
            copy does not have.
        """
        shared = [one.number for one in self.keyframes if one.number in other.rows]
        last = shared[-1]
        correction = compose(other.pose(last), between(self.pose(last), np.zeros(3)))
        later = [one for one in self.keyframes if one.number not in other.rows]
        for one in later:
            self.poses[self.rows[one.number]] = compose(correction, self.pose(one.number))
        for number in shared:
            self.poses[self.rows[number]] = other.pose(number)
        return correction, later

    def distances_from(self, number: int, limit_m: float) -> dict[int, float]:
        """Return how far other keyframes are along edges [m], as far as `limit_m`."""
        distances: dict[int, float] = {}
        queue = [(0.0, number)]
        while queue:
            distance_m, at = heapq.heappop(queue)
            if at in distances:
                continue
            distances[at] = distance_m
            for other, cost in self._neighbours[at].items():
                if other not in distances and distance_m + cost <= limit_m:
                    heapq.heappush(queue, (distance_m + cost, other))
        return distances

    def around(
        self, number: int, pose: NDArray[np.float64], distance_m: float, most: int
    ) -> list[int]:
        """Choose keyframes near a pose (3,) within a distance along edges from one [m]."""
        distances = self.distances_from(number, distance_m)
        always = [number]
        if self.prior is not None and self.prior in distances and number != self.prior:
            always.append(self.prior)
        return self.choose_near(distances, pose, most, always)

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
        some = [
            number
            for number in numbers
            if number != self.prior and not self.keyframes[self.rows[number]].is_blind
        ]
        if not some:
            return sorted(always)
        poses = self.poses[[self.rows[number] for number in some]]
        steps = between(pose, poses)
        far = np.hypot(steps[:, 0], steps[:, 1]) + PARAMS.turn_m * np.abs(steps[:, 2])
        order: list[int] = np.argsort(far).tolist()
        chosen: list[int] = list(always)
        kept = [self.pose(number) for number in always if number != self.prior]
        for row in order:
            if len(chosen) >= most:
                break
            if some[row] in chosen:
                continue
            apart = between(poses[row][None], np.array(kept).reshape(-1, 3))
            away = np.hypot(apart[:, 0], apart[:, 1]) + PARAMS.apart_turn_m * np.abs(apart[:, 2])
            if np.any(away < PARAMS.min_apart_m):
                continue
            chosen.append(some[row])
            kept.append(poses[row])
        return sorted(chosen)


def _deviation_m(edge: Edge) -> float:
    """Return the standard deviation of an edge's place in its least sure direction [m]."""
    (xx, xy, _), (_, yy, _), _ = edge.information.tolist()
    least = 0.5 * (xx + yy) - math.hypot(0.5 * (xx - yy), xy)
    return 1.0 / math.sqrt(max(least, 1e-6))
