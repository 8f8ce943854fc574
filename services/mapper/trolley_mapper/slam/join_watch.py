"""Whether what is seen bears out that it belongs where it lies on the map; if not, the cut.

That is doubted after a part was joined to the map, and after the robot stood: it may have been in a
lift, and from the door other floors look alike.
"""

import math
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from trolley.config.mapper import MapperConfig
from trolley.slices import Slices
from trolley_mapper.slam import sentences
from trolley_mapper.slam.agreement import count_explained
from trolley_mapper.slam.joining import PARAMS as JOINS
from trolley_mapper.slam.joining import Joint
from trolley_mapper.slam.keyframe_store import KeyframeStore
from trolley_mapper.slam.loop_closure import Closure, relax
from trolley_mapper.slam.occupancy_grid import LogOddsGrid, draw_map
from trolley_mapper.slam.pose_graph import ODOMETRY, Edge, between, compose


@dataclass(frozen=True, slots=True)
class WatchParams:
    """How long a join is doubted, and what speaks against it."""

    around_m: float = 6.0
    """Distance within which keyframes of both sides are compared [m]."""
    num_compared: int = 4
    """Number of keyframes on each side that are compared."""
    min_known: int = 60
    """Number of points in what the other side knows below which a comparison says nothing."""
    wrong_share: float = 0.75
    """Share of these points on surfaces of the other side below which a join is refuted: in
    generated buildings right joins had 0.97 and more, a wrong one between rooms alike 0.97 in the
    room, 0.8 before its door and 0.6 farther on. In between lies furniture that was moved."""
    moved_share: float = 0.6
    """The same after the robot stood, where the odometry bears its place out: another floor, behind
    a corridor like that of the first, had 0.4."""
    min_keyframes: int = 3
    """Number of keyframes that must have been compared."""
    over_m: float = 2.0
    """Distance driven over which that must be so [m]."""
    mended_devs: tuple[float, float, float] = (0.05, 0.05, 0.02)
    """Standard deviations of the step between keyframes of a part, when it is cut off where they
    hung on the map only [m, m, rad]."""
    until_m: float = 30.0
    """Distance driven after which a join is doubted no more [m]."""


PARAMS = WatchParams()


class JoinWatch:
    """Compares each new keyframe with the map as it was without the part.

    The matcher cannot tell: it compares scans with all that lies nearby, and what the part itself
    has shown explains them wherever it was joined.

    Args:
        joint: of the part that was joined, or begins where the robot stood.
        edges: that joined it.
        has_stood: whether the latter.
    """

    def __init__(self, joint: Joint, edges: list[Edge], *, has_stood: bool = False) -> None:
        self.joint, self.edges = joint, edges
        self._has_stood = has_stood
        self._driven_m = 0.0
        self._last: int | None = None
        # The last comparisons: where along the drive [m], points that are known, and explained.
        self._seen: list[tuple[float, int, int]] = []

    @property
    def is_over(self) -> bool:
        """Whether the join need not be doubted any more."""
        return self._driven_m > PARAMS.until_m

    @property
    def is_refuted(self) -> bool:
        """Whether the part lies where it does not belong."""
        if len(self._seen) < PARAMS.min_keyframes:
            return False
        if self._seen[-1][0] - self._seen[0][0] < PARAMS.over_m:
            return False
        known, explained = (sum(one[k] for one in self._seen) for k in (1, 2))
        share = PARAMS.moved_share if self._has_stood else PARAMS.wrong_share
        return explained < share * known

    @property
    def is_other_floor(self) -> bool:
        """Whether the newest scan, seen since the robot stood, speaks against the map."""
        if not self._has_stood or not self._seen:
            return False
        _, known, explained = self._seen[-1]
        return explained < PARAMS.wrong_share * known

    @property
    def sentence(self) -> str:
        """What is the matter if it is refuted."""
        return sentences.OTHER_FLOOR if self._has_stood else sentences.CUT

    def see(self, store: KeyframeStore, config: MapperConfig) -> None:
        """Take the newest keyframe into account."""
        newest = store.newest.number
        if self._last is not None and self._last in store.rows:
            self._driven_m += math.dist(store.pose(self._last)[:2], store.poses[-1, :2])
        self._last = newest
        known, explained = self._compared(store, config)
        if known >= PARAMS.min_known:
            self._seen.append((self._driven_m, known, explained))
        # What is left is just long enough.
        while len(self._seen) > PARAMS.min_keyframes and (
            self._driven_m - self._seen[1][0] >= PARAMS.over_m
        ):
            del self._seen[0]

    def _compared(self, store: KeyframeStore, config: MapperConfig) -> tuple[int, int]:
        """Return how many points the other side knows and how many it explains, both ways.

        What the map shows where beams pass now speaks against it as much as echoes where the map
        is free: nothing is known of what lies behind its walls.
        """
        pose = store.poses[-1]
        part = store.part_of(store.newest.number)
        poses = store.poses[[store.rows[n] for n in part]]
        away = np.hypot(*(poses[:, :2] - pose[:2]).T)
        numbers = [n for n, away_m in zip(part, away, strict=True) if away_m < PARAMS.around_m]
        # What lies farther along the edges may be off by drift, which is for loops to take away.
        tied = store.distances_from(store.newest.number, config.local_way_m)
        before = [n for n in numbers if n < self.joint.number and n != store.prior and n in tied]
        since = [n for n in numbers if n >= self.joint.number]
        always = [] if store.prior is None else [store.prior]
        here = [store.newest.number]
        map_side = store.choose_near(before, pose, config.local_keyframes, always)
        part_side = store.choose_near(since, pose, config.local_keyframes, here)
        known, explained = 0, 0
        for shown, by in (
            (here, map_side),
            (store.choose_near(before, pose, PARAMS.num_compared), part_side),
        ):
            one, other = count_explained(
                store, shown, by, store.newest.number, JOINS.checked_near_m, JOINS.reach_m
            )
            known, explained = known + one, explained + other
        return known, explained


@dataclass(eq=False)
class CutJob:
    """Cuts a part off the map again, and draws the map without it.

    Attributes:
        store: a copy, changed by the job.
        config: settings.
        blank: the grid before any keyframe: empty, or the map that is extended.
        joint: of the part.
        refuted: edges that joined it.
        sentence: what is the matter.
        occupancy: the map drawn anew.
        found: nothing.
        accepted: edges that hold the part together now.
    """

    store: KeyframeStore
    config: MapperConfig
    blank: LogOddsGrid
    joint: Joint
    refuted: list[Edge]
    sentence: str
    occupancy: LogOddsGrid | None = None
    found: list[Closure] = field(default_factory=list[Closure], init=False)
    accepted: list[Edge] = field(default_factory=list[Edge], init=False)

    def slices(self) -> Slices[None]:
        """Cut, lay the part where the odometry had it, and draw."""
        store = self.store
        store.cut(across(store, self.joint))
        rows = [row for row, one in enumerate(store.keyframes) if one.number >= self.joint.number]
        self._mend([store.keyframes[row].number for row in rows])
        yield from relax(store)
        begin = store.poses[rows[0]]
        store.poses[rows] = compose(self.joint.pose, between(begin, store.poses[rows]))
        self.occupancy = yield from draw_map(self.blank, store)

    def _mend(self, part: list[int]) -> None:
        """Tie keyframes of the part together that only hung on the map, as they were driven.

        Where a keyframe was dissolved, those beside it may have got edges from the map alone.
        """
        store = self.store
        for one, other in pairwise(part):
            if other not in store.part_of(one):
                step = between(store.pose(one), store.pose(other))
                information = np.diag(1.0 / np.square(PARAMS.mended_devs))
                edge = Edge(one, other, step, information, ODOMETRY)
                store.link(edge)
                self.accepted.append(edge)


def across(store: KeyframeStore, joint: Joint) -> list[Edge]:
    """Return the edges between what was mapped before a part began and since."""
    number = joint.number
    return [one for one in store.edges if (one.first < number) != (one.second < number)]
