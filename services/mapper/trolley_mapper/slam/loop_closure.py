"""Loop closures: finding old keyframes that see the same, and believing only what holds."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from trolley.config.mapper import MapperConfig
from trolley.gridmap import GridMap
from trolley_mapper.kernels.layout import Cloud
from trolley_mapper.slam.keyframe import Keyframe
from trolley_mapper.slam.keyframe_store import Atlas
from trolley_mapper.slam.local_map import LocalMap
from trolley_mapper.slam.occupancy_grid import Occupancy, draw_all
from trolley_mapper.slam.pose_graph import (
    LOOP,
    Edge,
    between,
    compose,
    make_problem,
    optimise,
    squared_errors,
    to_frame,
)
from trolley_mapper.slam.scan_matcher import Verdict, judge
from trolley_mapper.slam.sweep import Sweep

# Keyframes of the way just driven that are looked for together, and of the place to look in.
_QUERY_WAY_M = 2.0
_QUERY_MOST = 5
_PLACE_WAY_M = 5.0
_PLACE_MOST = 20
_PLACES = 3
_APART_M = 3.0
# Places farther than the uncertainty and this cannot show the same [m].
_OVERLAP_M = 2.5
# The window: so large at first, and growing with the way.
_WINDOW_M = 0.5
_WINDOW_RAD = 0.2
_WINDOW_RAD_PER_M = 0.006
_MOST_WINDOW_M = 8.0
_LEAST_SCORE = 0.5
_PULL = 0.05
_GOOD_MATCH = 0.85
_GOOD_EXPLAINED = 0.45
# Two closures agree when one leads to the other within [m, rad], and lie so near along the way.
_AGREE_M = 0.15
_AGREE_RAD = 0.04
_AGREE_WAY_M = 6.0
# By so much a believed closure may raise the squared error of all edges. Right ones raised it by
# up to 90 after bad odometry, wrong ones by 700.
_MOST_STRAIN = 250.0


@dataclass(frozen=True, slots=True, eq=False)
class Closure:
    """A place that was recognised, not yet believed: an edge from the old to the new keyframe."""

    edge: Edge
    verdict: Verdict


@dataclass(eq=False)
class LoopJob:
    """Search of loops for the newest keyframe, and optimisation when there are any.

    Attributes:
        atlas: a copy, changed by the job.
        pending: closures found before that wait for one that agrees.
        config: settings.
        prior: the map that is extended, if one is.
        found: closures found now.
        accepted: edges of those that are believed now.
        occupancy: the map drawn anew, if anything has moved.
    """

    atlas: Atlas
    pending: list[Closure]
    config: MapperConfig
    prior: GridMap | None
    found: list[Closure] = field(default_factory=list[Closure])
    accepted: list[Edge] = field(default_factory=list[Edge])
    occupancy: Occupancy | None = None

    def run(self) -> "LoopJob":
        """Search, check, optimise and draw; returns itself."""
        search = LoopSearch(self.atlas, self.config)
        query = self.atlas.newest.number
        for place in search.places(query):
            closure = search.close(query, place)
            if closure is not None:
                self.found.append(closure)
        self._believe()
        if self.accepted:
            self._optimise()
        return self

    def _believe(self) -> None:
        """Accept closures that agree with each other."""
        accepted: list[Edge] = []
        for new in self.found:
            for old in self.pending:
                if old.edge.second == new.edge.second or not agree(self.atlas, old.edge, new.edge):
                    continue
                for closure in (old, new):
                    if all(closure.edge is not edge for edge in accepted):
                        accepted.append(closure.edge)
        self.accepted = accepted

    def _optimise(self) -> None:
        """Move all keyframes to where they fit together, and draw the map anew.

        Loops that the ways between their ends can hardly be stretched to are not believed.
        """
        relax(self.atlas, is_robust=False)
        strain = total_error(self.atlas)
        apart = self.atlas.copy()
        for edge in self.accepted:
            self.atlas.link(edge)
        relax(self.atlas, is_robust=False)
        strain = total_error(self.atlas) - strain
        if strain > _MOST_STRAIN * len(self.accepted):
            self.atlas, self.accepted = apart, []
            return
        relax(self.atlas)
        self.occupancy = draw_all(
            self.config.resolution_m, self.prior, self.atlas.keyframes, self.atlas.poses
        )


def total_error(atlas: Atlas) -> float:
    """Return the sum of the squared errors of all edges; loops count for little more than phi."""
    problem = make_problem(atlas.edges, atlas.rows)
    chi2 = squared_errors(atlas.poses, problem)
    return float(np.minimum(chi2, _MOST_STRAIN).sum())


def relax(atlas: Atlas, is_robust: bool = True) -> None:
    """Optimise all poses of an atlas; the first stays."""
    problem = make_problem(atlas.edges, atlas.rows)
    atlas.poses = optimise(atlas.poses, problem, [0], is_robust)


def agree(atlas: Atlas, one: Edge, other: Edge) -> bool:
    """Say whether two closures lead to the same, when the ways between their ends are right."""
    news = between(atlas.pose(one.second), atlas.pose(other.second))
    olds = between(atlas.pose(one.first), atlas.pose(other.first))
    if math.hypot(news[0], news[1]) > _AGREE_WAY_M or math.hypot(olds[0], olds[1]) > _AGREE_WAY_M:
        return False
    round_one = compose(one.step, news)
    round_other = compose(olds, other.step)
    miss = between(round_one, round_other)
    return bool(math.hypot(miss[0], miss[1]) < _AGREE_M and abs(miss[2]) < _AGREE_RAD)


class LoopSearch:
    """Looks for old places that a keyframe shows, too."""

    def __init__(self, atlas: Atlas, config: MapperConfig) -> None:
        self._atlas = atlas
        self._config = config

    def places(self, query: int) -> list[tuple[int, float]]:
        """Return keyframes in the middle of places to try, and the way driven since [m]."""
        atlas = self._atlas
        near = atlas.ways_from(query, self._config.local_way_m)
        ways = atlas.ways_from(query, math.inf)
        pose = atlas.pose(query)
        away = np.hypot(*(atlas.poses[:, :2] - pose[:2]).T)
        chosen: list[tuple[int, float]] = []
        if atlas.prior is not None and atlas.prior not in near:
            chosen.append((atlas.prior, ways.get(atlas.prior, math.inf)))
        order: list[int] = np.argsort(away).tolist()
        for row in order:
            number = atlas.keyframes[row].number
            way = ways.get(number, math.inf)
            if number in near or number >= query or number == atlas.prior:
                continue
            if away[row] > self._window(way)[0] + _OVERLAP_M:
                continue
            here = atlas.poses[row, :2]
            if any(
                n != atlas.prior and np.hypot(*(atlas.pose(n)[:2] - here)) < _APART_M
                for n, _ in chosen
            ):
                continue
            chosen.append((number, way))
            if len(chosen) == _PLACES:
                break
        return chosen

    def _window(self, way_m: float) -> tuple[float, float]:
        """Return how far off a pose may be after a way [m, rad]."""
        way_m = min(way_m, 1e3)
        return (
            min(_WINDOW_M + self._config.drift_share * way_m, _MOST_WINDOW_M),
            min(_WINDOW_RAD + _WINDOW_RAD_PER_M * way_m, math.pi),
        )

    def close(self, query: int, place: tuple[int, float]) -> Closure | None:
        """Try to find what a keyframe shows at an old place."""
        atlas = self._atlas
        number, way = place
        near = atlas.ways_from(query, self._config.local_way_m)
        around = [n for n in atlas.ways_from(number, _PLACE_WAY_M) if n not in near]
        chosen = atlas.choose_near(around, atlas.pose(query), _PLACE_MOST, [number])
        centre = atlas.pose(query if number == atlas.prior else number)[:2]
        local = self._local(chosen, centre)
        sweep = self._query_sweep(query)
        predicted = atlas.pose(query)
        found = local.correlate(sweep.cloud, predicted, self._window(way), _LEAST_SCORE, _PULL)
        if found is None:
            return None
        pose, _ = local.align(found[0], sweep.cloud, found[0], np.diag([1.0, 1.0, 1.0]), 0.3)
        # Beams of the others come from elsewhere: only the newest can show what contradicts.
        own = atlas.keyframes[atlas.rows[query]]
        seen = Sweep(own.cloud(), own.laser.astype(np.float64), False)
        verdict = judge(local, pose, seen, by_side=True)
        if verdict.match < _GOOD_MATCH or verdict.explained < _GOOD_EXPLAINED:
            return None
        hessians, counts = local.shares(pose, sweep.cloud)
        best = int(np.argmax(counts))
        first = chosen[best]
        edge = Edge(
            first,
            query,
            between(atlas.pose(first), pose),
            to_frame(hessians.sum(axis=0), float(pose[2])) + np.diag([1.0, 1.0, 1.0]),
            LOOP,
        )
        return Closure(edge, verdict)

    def _local(self, numbers: Sequence[int], centre: NDArray[np.float64]) -> LocalMap:
        atlas = self._atlas
        keyframes = [atlas.keyframes[atlas.rows[n]] for n in numbers]
        poses = np.array([atlas.pose(n) for n in numbers])
        return LocalMap(keyframes, poses, centre, self._config.local_reach_m)

    def _query_sweep(self, query: int) -> Sweep:
        """Return what the last few keyframes saw, as seen from the newest."""
        atlas = self._atlas
        ways = atlas.ways_from(query, _QUERY_WAY_M)
        recent = sorted((n for n in ways if n <= query), reverse=True)[:_QUERY_MOST]
        points: list[NDArray[np.float64]] = []
        normals: list[NDArray[np.float64]] = []
        for number in recent:
            one: Keyframe = atlas.keyframes[atlas.rows[number]]
            cloud = one.cloud()
            step = between(atlas.pose(query), atlas.pose(number))
            cos, sin = math.cos(step[2]), math.sin(step[2])
            turn = np.array([[cos, sin], [-sin, cos]])
            every = max(len(cloud.points) * len(recent) // 600, 1)
            points.append(cloud.points[::every] @ turn + step[:2])
            normals.append(cloud.normals[::every] @ turn)
        laser = atlas.keyframes[atlas.rows[query]].laser.astype(np.float64)
        return Sweep(Cloud(np.vstack(points), np.vstack(normals)), laser, is_blind=False)
