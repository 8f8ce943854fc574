"""Loop closures: finding old keyframes that see the same, and believing only what holds."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from trolley.config.mapper import MapperConfig
from trolley.scan_matching.layout import Cloud
from trolley.scan_matching.sweep import Sweep
from trolley.slices import Slices
from trolley_mapper.slam.keyframe import Keyframe
from trolley_mapper.slam.keyframe_store import KeyframeStore
from trolley_mapper.slam.local_map import LocalMap
from trolley_mapper.slam.occupancy_grid import LogOddsGrid, draw_map
from trolley_mapper.slam.pose_graph import (
    LOOP,
    Edge,
    between,
    compose,
    contradicted,
    make_problem,
    optimise,
    squared_errors,
    to_frame,
)
from trolley_mapper.slam.scan_matcher import MatchQuality, judge


@dataclass(frozen=True, slots=True)
class LoopParams:
    """Where loops are searched for, and which are believed. Found with bench/mapper/."""

    query_distance_m: float = 2.0
    """Distance along edges within which keyframes are searched for together [m]."""
    max_query: int = 5
    """Number of keyframes that are searched for together at most."""
    place_distance_m: float = 5.0
    """Distance along edges within which keyframes form an old place [m]."""
    max_place: int = 20
    """Number of keyframes that form an old place at most."""
    max_places: int = 3
    """Number of old places that are tried for each keyframe."""
    apart_m: float = 3.0
    """Least distance between old places that are tried [m]."""
    overlap_m: float = 2.5
    """Distance beyond the window above which two places cannot show the same [m]."""
    window_rad_per_m: float = 0.006
    """Growth of the window with the distance driven [rad/m]."""
    window_m: float = 0.5
    """Half the search window before any distance was driven [m]."""
    window_rad: float = 0.2
    """Half the range of headings before any distance was driven [rad]."""
    max_window_m: float = 8.0
    """Greatest half of the search window [m]."""
    min_score: float = 0.5
    """Score below which the search stops, 0 ... 1."""
    pull: float = 0.05
    """Lead in score that a pose in the window's corner needs over one in its middle."""
    min_match: float = 0.85
    """Share of the points in known space that a closure must explain."""
    min_explained: float = 0.45
    """Share of all points that a closure must explain."""
    min_pinned: float = 1000.0
    """Least information on the place, in the direction in which they say least, that closures give
    together: in buildings with a scan a metre right ones gave 4,700 and more, wrong ones, which lay
    anywhere along a corridor, up to 60 [1/m^2]."""
    agree_m: float = 0.15
    """Distance within which one closure must lead to another for them to agree [m]."""
    agree_rad: float = 0.04
    """Turn within which one closure must lead to another for them to agree [rad]."""
    agree_distance_m: float = 6.0
    """Distance within which the ends of two closures must lie for them to agree [m]."""
    doubtful_strain: float = 4.0
    """Rise of the squared error above which closures must be borne out along `proof_m`: on drives
    with a scan a metre right ones raised it by up to 0.5, wrong ones in corridors by 17."""
    proof_m: float = 3.0
    """Distance driven over which doubtful closures must agree to be believed [m]."""
    max_strain: float = 110.0
    """Greatest rise of the squared error of all edges by closures together, however many agree:
    what is seen along one stretch errs as one. Right ones raised it by up to 90 after bad odometry,
    wrong ones between identical rooms by 130 to 250."""
    most_counted: float = 250.0
    """Squared error that one edge counts as at most: a wrong loop must not hide all others."""


PARAMS = LoopParams()


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """Where a keyframe is looked for.

    Attributes:
        middle: (2,) x, y [m] in `map`.
        window: half its edge [m] and half its range of headings [rad].
        yaw: the middle of these [rad].
    """

    middle: NDArray[np.float64]
    window: tuple[float, float]
    yaw: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Closure:
    """A place that was recognised, not yet believed: an edge from the old to the new keyframe."""

    edge: Edge
    quality: MatchQuality


@dataclass(eq=False)
class LoopJob:
    """Search of one place for what a keyframe shows, and optimisation when loops are believed.

    Attributes:
        store: a copy, changed by the job.
        pending: closures found before that wait for one that agrees.
        config: settings.
        blank: the grid before any keyframe: empty, or the map that is extended.
        query: the keyframe that is looked for.
        places: to search, the likeliest last: keyframes in their middle, and the distance driven
            since [m]; None: they are chosen first. The last one is taken off.
        found: closures found now.
        accepted: edges of those that are believed now.
        cut: edges of loops believed before that these contradict.
        occupancy: the map drawn anew, if anything has moved.
    """

    store: KeyframeStore
    pending: list[Closure]
    config: MapperConfig
    blank: LogOddsGrid
    query: int
    places: list[tuple[int, float]] | None
    found: list[Closure] = field(default_factory=list[Closure])
    accepted: list[Edge] = field(default_factory=list[Edge])
    cut: list[Edge] = field(default_factory=list[Edge])
    occupancy: LogOddsGrid | None = None

    def slices(self) -> Slices[None]:
        """Search, check, optimise and draw."""
        search = LoopSearch(self.store, self.config)
        if self.places is None:
            self.places = search.places(self.query)[::-1]
        yield
        if self.places:
            closure = yield from search.close(self.query, self.places.pop())
            if closure is not None:
                self.found.append(closure)
        self._believe()
        if self.accepted:
            yield
            yield from self._optimise()

    def _believe(self) -> None:
        """Accept closures that agree with each other."""
        accepted: list[Edge] = []
        for new in self.found:
            for old in self.pending:
                if old.edge.second == new.edge.second or not agree(self.store, old.edge, new.edge):
                    continue
                for closure in (old, new):
                    if all(closure.edge is not edge for edge in accepted):
                        accepted.append(closure.edge)
        if accepted and pinned(self.store, accepted) >= PARAMS.min_pinned:
            self.accepted = accepted

    def _optimise(self) -> Slices[None]:
        """Move all keyframes to where they fit together, and draw the map anew.

        Loops that the edges between their ends can hardly be stretched to are not believed; those
        that strain them wait for others that agree, seen from farther along.
        """
        yield from relax(self.store, is_robust=False)
        before = total_error(self.store)
        apart = self.store.copy()
        for edge in self.accepted:
            self.store.link(edge)
        yield from relax(self.store, is_robust=False)
        strain = total_error(self.store) - before
        is_doubtful = strain > PARAMS.doubtful_strain * len(self.accepted)
        is_short = distance_covered(apart, self.accepted) < PARAMS.proof_m
        is_strained = strain > PARAMS.max_strain
        is_believed = not (is_doubtful and is_short)
        if is_believed and is_strained:
            is_believed = yield from self._cut_contradicted(before)
        if not is_believed:
            self.store, self.accepted, self.cut = apart, [], []
            return
        yield from relax(self.store)
        self.occupancy = yield from draw_map(self.blank, self.store)

    def _cut_contradicted(self, before: float) -> Slices[bool]:
        """Cut earlier loops that the new ones outvote; False where it is the other way round.

        Votes are not all: what is left must strain the odometry not much more than `before`.
        """
        problem = make_problem(self.store.edges, self.store.rows, self.store.scale)
        is_out = yield from contradicted(self.store.poses, problem, self.store.anchored_rows)
        out = [edge for edge, is_one in zip(self.store.edges, is_out, strict=True) if is_one]
        if not out or any(edge is new for edge in out for new in self.accepted):
            return False
        self.store.cut(out)
        yield from relax(self.store, is_robust=False)
        self.cut = out
        return total_error(self.store) - before <= PARAMS.max_strain


def total_error(store: KeyframeStore) -> float:
    """Return the sum of the squared errors of all edges; a loop counts for hardly more than phi."""
    problem = make_problem(store.edges, store.rows, store.scale)
    chi2 = squared_errors(store.poses, problem)
    return float(np.minimum(chi2, PARAMS.most_counted).sum())


def pinned(store: KeyframeStore, edges: Sequence[Edge]) -> float:
    """Return the information of closures on the place where they say least of it [1/m^2]."""
    total = np.zeros((3, 3))
    for edge in edges:
        yaw = float(compose(store.pose(edge.first), edge.step)[2])
        total += to_frame(edge.information, -yaw)
    return float(np.linalg.eigvalsh(total[:2, :2])[0])


def distance_covered(store: KeyframeStore, edges: Sequence[Edge]) -> float:
    """Return how far apart the keyframes that closures come from lie at most [m]."""
    places = np.array([store.pose(edge.second)[:2] for edge in edges])
    return float(np.hypot(*(places[:, None] - places[None]).T).max())


def relax(store: KeyframeStore, is_robust: bool = True) -> Slices[None]:
    """Optimise all poses of a store; the first of each part stays."""
    problem = make_problem(store.edges, store.rows, store.scale)
    yield
    store.poses = yield from optimise(store.poses, problem, store.anchored_rows, is_robust)


def agree(store: KeyframeStore, one: Edge, other: Edge) -> bool:
    """Say whether two closures lead to the same, if the edges between their ends are right."""
    news = between(store.pose(one.second), store.pose(other.second))
    olds = between(store.pose(one.first), store.pose(other.first))
    if (
        math.hypot(news[0], news[1]) > PARAMS.agree_distance_m
        or math.hypot(olds[0], olds[1]) > PARAMS.agree_distance_m
    ):
        return False
    round_one = compose(one.step, news)
    round_other = compose(olds, other.step)
    miss = between(round_one, round_other)
    return bool(math.hypot(miss[0], miss[1]) < PARAMS.agree_m and abs(miss[2]) < PARAMS.agree_rad)


class LoopSearch:
    """Looks for old places that a keyframe shows, too."""

    def __init__(self, store: KeyframeStore, config: MapperConfig) -> None:
        self._store = store
        self._config = config

    def places(self, query: int) -> list[tuple[int, float]]:
        """Return keyframes in the middle of places to try, and the distance driven since [m]."""
        store = self._store
        near = store.distances_from(query, self._config.local_way_m)
        distances = store.distances_from(query, math.inf)
        pose = store.pose(query)
        away = np.hypot(*(store.poses[:, :2] - pose[:2]).T)
        chosen: list[tuple[int, float]] = []
        if store.prior in distances and store.prior not in near:
            chosen.append((store.prior, distances[store.prior]))
        order: list[int] = np.argsort(away).tolist()
        for row in order:
            number = store.keyframes[row].number
            if number in near or number >= query or number == store.prior:
                continue
            if number not in distances:
                continue
            distance_m = distances[number]
            if away[row] > self._window(distance_m)[0] + PARAMS.overlap_m:
                continue
            here = store.poses[row, :2]
            if any(
                n != store.prior and np.hypot(*(store.pose(n)[:2] - here)) < PARAMS.apart_m
                for n, _ in chosen
            ):
                continue
            chosen.append((number, distance_m))
            if len(chosen) == PARAMS.max_places:
                break
        return chosen

    def _window(self, distance_m: float) -> tuple[float, float]:
        """Return how far off a pose may be after a distance [m, rad]."""
        distance_m = min(distance_m, 1e3)
        return (
            min(PARAMS.window_m + self._config.drift_share * distance_m, PARAMS.max_window_m),
            min(PARAMS.window_rad + PARAMS.window_rad_per_m * distance_m, math.pi),
        )

    def close(self, query: int, place: tuple[int, float]) -> Slices[Closure | None]:
        """Try to find what a keyframe shows at an old place."""
        store = self._store
        number, distance_m = place
        near = store.distances_from(query, self._config.local_way_m)
        around = [n for n in store.distances_from(number, PARAMS.place_distance_m) if n not in near]
        chosen = store.choose_near(around, store.pose(query), PARAMS.max_place, [number])
        pose = store.pose(query)
        middle = pose if number == store.prior else store.pose(number)
        window = self._window(distance_m)
        around_here = Place(pose[:2], window, float(pose[2]))
        reach_m = self._config.local_reach_m
        return (yield from closing(store, query, around_here, chosen, reach_m, middle[:2]))


def closing(
    store: KeyframeStore,
    query: int,
    place: Place,
    numbers: Sequence[int],
    reach_m: float,
    centre: NDArray[np.float64] | None = None,
) -> Slices[Closure | None]:
    """Try to find what a keyframe shows at a place.

    Args:
        store: the keyframes.
        query: the keyframe that is looked for.
        place: where.
        numbers: the keyframes that show the place.
        reach_m: surfaces this near to it are compared with [m].
        centre: (2,) or to this, if it is not the middle of the window [m].
    """
    if not numbers:
        return None
    keyframes = [store.keyframes[store.rows[n]] for n in numbers]
    poses = np.array([store.pose(n) for n in numbers])
    local = LocalMap(keyframes, poses, place.middle if centre is None else centre, reach_m)
    sweep = recently_seen(store, query)
    predicted = np.array([*place.middle, place.yaw])
    search = local.correlate(sweep.cloud, predicted, place.window, PARAMS.min_score, PARAMS.pull)
    found = yield from search
    if found is None:
        return None
    pose, _ = local.align(found[0], sweep.cloud, found[0], np.diag([1.0, 1.0, 1.0]), 0.3)
    # Beams of the others come from elsewhere: only the newest can show what contradicts.
    own = store.keyframes[store.rows[query]]
    seen = Sweep(own.cloud(), own.laser.astype(np.float64), is_blind=False)
    quality = judge(local, pose, seen, by_side=True)
    if quality.match < PARAMS.min_match or quality.explained < PARAMS.min_explained:
        return None
    hessians, counts = local.contributions(pose, sweep.cloud)
    first = numbers[int(np.argmax(counts))]
    edge = Edge(
        first,
        query,
        between(store.pose(first), pose),
        to_frame(hessians.sum(axis=0), float(pose[2])) + np.diag([1.0, 1.0, 1.0]),
        LOOP,
    )
    return Closure(edge, quality)


def recently_seen(store: KeyframeStore, query: int) -> Sweep:
    """Return what the last few keyframes saw, as seen from the newest."""
    distances = store.distances_from(query, PARAMS.query_distance_m)
    recent = sorted((n for n in distances if n <= query), reverse=True)[: PARAMS.max_query]
    points: list[NDArray[np.float64]] = []
    normals: list[NDArray[np.float64]] = []
    for number in recent:
        one: Keyframe = store.keyframes[store.rows[number]]
        cloud = one.cloud()
        step = between(store.pose(query), store.pose(number))
        cos, sin = math.cos(step[2]), math.sin(step[2])
        turn = np.array([[cos, sin], [-sin, cos]])
        every = max(len(cloud.points) * len(recent) // 600, 1)
        points.append(cloud.points[::every] @ turn + step[:2])
        normals.append(cloud.normals[::every] @ turn)
    laser = store.keyframes[store.rows[query]].laser.astype(np.float64)
    return Sweep(Cloud(np.vstack(points), np.vstack(normals)), laser, is_blind=False)
