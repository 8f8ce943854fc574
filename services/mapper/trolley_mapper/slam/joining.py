"""Joining a part that hangs loose to the map: where it lies, and what it takes to believe that.

Source:
    Mangelson et al., Pairwise Consistent Measurement Set Maximization (2018), for closures that are
    believed where they agree; Hess et al., Real-Time Loop Closure in 2D LIDAR SLAM (2016), for the
    search.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from trolley.config.mapper import MapperConfig
from trolley.scan_matching.layout import Cloud
from trolley.scan_matching.surfels import EXPLAINED, UNKNOWN
from trolley.scan_matching.sweep import Sweep
from trolley.slices import Slices
from trolley_mapper.slam.keyframe_store import KeyframeStore
from trolley_mapper.slam.local_map import LocalMap
from trolley_mapper.slam.loop_closure import PARAMS as LOOPS
from trolley_mapper.slam.loop_closure import (
    Closure,
    Place,
    agree,
    closing,
    pinned,
    relax,
    total_error,
)
from trolley_mapper.slam.occupancy_grid import LogOddsGrid, draw_map
from trolley_mapper.slam.pose_graph import LOOP, Edge, between, compose, turned


@dataclass(frozen=True, slots=True)
class JoinParams:
    """Where a loose part is searched for, and when it is joined. Set by hand."""

    place_m: float = 2.5
    """Distance between searched places along an axis [m]."""
    floor_every: int = 5
    """One cell in so many of an earlier map's floor is enough, since places lie so far apart."""
    places_together: int = 10
    """Number of places that are chosen in one slice: an earlier map has many cells of floor."""
    window_m: float = 4.0
    """Half the search window at each place: floor that was not driven over is searched, too [m]."""
    around_m: float = 12.0
    """Distance from a place within which keyframes are compared [m]."""
    reach_m: float = 14.0
    """Distance from a place within which surfaces are compared [m]."""
    devs: float = 4.0
    """Number of the odometry's standard deviations beyond which places are not searched."""
    hint_window: tuple[float, float] = (0.4, 0.15)
    """Half the window where an earlier closure leads [m, rad]."""
    max_hints: int = 3
    """Number of earlier closures that are followed up with each scan."""
    proof_m: float = 3.0
    """Distance driven over which closures must agree for a join [m]."""
    clear_proof_m: float = 0.6
    """Distance driven over which closures must agree where their scans show little that is new [m].
    """
    turn_m: float = 0.5
    """Distance that shows as much that is new as a turn by 1 rad [m/rad]."""
    odometry_cost: float = 30.0
    """Most log-likelihood that the odometry costs a place to which the robot may have been carried:
    as of two scans that fit well."""
    carried_mps: float = 2.0
    """Speed at which somebody carries a robot at most [m/s]."""
    near_cost: float = 4.5
    """Log-likelihood of the odometry against a place up to which it bears the place out: up to
    three standard deviations."""
    far_proof_m: float = 6.0
    """Distance driven over which closures must agree that the odometry contradicts [m]."""
    clear_explained: float = 0.75
    """Share of their points that scans must explain to show little that is new."""
    lead: float = 20.0
    """Lead in log-likelihood over any other place: as of one scan that fits well, and nowhere else.
    """
    max_checked: int = 12
    """Number of the part's scans that are compared with the map before it is joined."""
    checked_near_m: float = 0.15
    """Distance from a surface within which a point is explained then: the part may be slightly bent
    [m]."""
    min_match: float = 0.8
    """Share of all their points in known space that must be explained."""
    said_window: tuple[float, float] = (1.0, 0.5)
    """Half the window in which a part is searched for where a person says that it is [m, rad]."""
    said_devs: tuple[float, float] = (0.5, 0.25)
    """Standard deviations of what a person says, where the scans do not show it better [m, rad]."""
    joint_error: float = 25.0
    """Squared error that the odometry across the gap may add; with more the wheels slipped there.
    """


PARAMS = JoinParams()


@dataclass(frozen=True, slots=True, eq=False)
class Joint:
    """What is known of how a loose part lies to the map.

    Attributes:
        number: of its first keyframe.
        pose: (3,) where the odometry had it.
        covariance: (3, 3) of that; None: it may lie anywhere, and the odometry says nothing.
        edge: from the keyframe before, if only the lidar was covered in between.
        unseen_s: time without a scan that showed where the robot is, in which it may have been
            carried [s].
    """

    number: int
    pose: NDArray[np.float64]
    covariance: NDArray[np.float64] | None
    edge: Edge | None
    unseen_s: float = math.inf

    def moved(self, new_map_T_old_map: NDArray[np.float64]) -> "Joint":
        """Return the same on a map whose frame has moved by a motion (3,)."""
        yaw = float(new_map_T_old_map[2])
        return replace(
            self,
            pose=compose(new_map_T_old_map, self.pose),
            covariance=None if self.covariance is None else turned(self.covariance, yaw),
        )

    def reach_m(self, away_m: float) -> float:
        """How far off something may be that lies so far from the part's beginning [m]."""
        if self.covariance is None:
            return math.inf
        dev_m = math.sqrt(float(np.linalg.eigvalsh(self.covariance[:2, :2])[-1]))
        return PARAMS.devs * (dev_m + away_m * math.sqrt(float(self.covariance[2, 2])))


def places_to_try(
    store: KeyframeStore, joint: Joint, pose: NDArray[np.float64]
) -> Slices[list[Place]]:
    """Return the places of the map where the robot may be, the likeliest first.

    Args:
        store: the keyframes.
        joint: of the part that the robot is in.
        pose: (3,) where the odometry has the robot.
    """
    some = [store.poses[~store.loose, :2]]
    if store.prior is not None:
        floor = store.keyframes[0].floor
        some = [some[0][1:]]
        if floor is not None:
            some.append(floor[:: PARAMS.floor_every].astype(np.float64))
    points = np.vstack(some)
    away = np.hypot(*(points - pose[:2]).T)
    reach_m = joint.reach_m(float(np.hypot(*(pose - joint.pose)[:2]))) + PARAMS.window_m
    order = np.argsort(away)
    left = points[order][away[order] <= reach_m]
    places: list[Place] = []
    while len(left):
        places.append(Place(left[0].copy(), (PARAMS.window_m, math.pi)))
        left = left[np.abs(left - left[0]).max(axis=1) > PARAMS.place_m]
        if len(places) % PARAMS.places_together == 0:
            yield
    return places


@dataclass(eq=False)
class JoinJob:
    """Search of one place for what the newest keyframe shows, and joining when all is proven.

    Attributes:
        store: a copy, changed by the job.
        pending: closures found before.
        config: settings.
        blank: the grid before any keyframe: empty, or the map that is extended.
        joint: what is known of how the part lies.
        pose: (3,) where the odometry has the robot.
        places: to search, the likeliest last; None: they are chosen first. The last one is taken
            off; once there is none, only where earlier closures lead is searched.
        is_searched: all places have been searched from this part.
        refuted: edges that joined parts where later scans did not fit.
        said: (3,) where a person says that the newest keyframe was taken: it is joined there.
        found: closures found now.
        accepted: edges of those that are believed now, and of the odometry across the gap.
        occupancy: the map drawn anew, if the part was joined.
    """

    store: KeyframeStore
    pending: list[Closure]
    config: MapperConfig
    blank: LogOddsGrid
    joint: Joint
    pose: NDArray[np.float64]
    places: list[Place] | None
    is_searched: bool
    refuted: Sequence[Edge] = ()
    said: NDArray[np.float64] | None = None
    found: list[Closure] = field(default_factory=list[Closure])
    accepted: list[Edge] = field(default_factory=list[Edge])
    occupancy: LogOddsGrid | None = None
    _poses: dict[int, NDArray[np.float64]] = field(default_factory=dict[int, NDArray[np.float64]])
    # Where refuted joins have the newest keyframe.
    _wrong: list[NDArray[np.float64]] = field(default_factory=list[NDArray[np.float64]])

    def slices(self) -> Slices[None]:
        """Search, judge, join."""
        store = self.store
        if self.said is not None:
            edge = yield from self._edge_as_said(self.said)
            yield from self._join([edge])
            return
        if self.places is None:
            self.places = (yield from places_to_try(store, self.joint, self.pose))[::-1]
        places = self._hints()
        if self.places:
            places.append(self.places.pop())
        self.is_searched = self.is_searched or not self.places
        yield
        part = set(store.part_of(store.newest.number))
        self._wrong = [
            self._edge_leads_to(edge)
            for edge in self.refuted
            if store.has(edge) and edge.second in part and not store.is_loose(edge.first)
        ]
        for place in places:
            closure = yield from self._close(place)
            if closure is not None and not (self._is_known(closure) or self._is_wrong(closure)):
                self.found.append(closure)
        yield
        best = self._best()
        if best and self._fits(best[-1]):
            yield
            yield from self._join([one.edge for one in best])

    def _edge_as_said(self, said: NDArray[np.float64]) -> Slices[Edge]:
        """Return what joins the part where a person says: by what is seen there, if it fits."""
        store = self.store
        if not store.newest.is_blind:
            place = Place(said[:2], PARAMS.said_window, float(said[2]))
            closure = yield from self._close(place)
            if closure is not None:
                return closure.edge
        away = np.hypot(*(store.poses[:, :2] - said[:2]).T)
        away[store.loose] = math.inf
        number = store.keyframes[int(np.argmin(away))].number
        first = number if store.prior is None else store.prior
        dev_m, dev_rad = PARAMS.said_devs
        information = np.diag(1.0 / np.square([dev_m, dev_m, dev_rad]))
        step = between(store.pose(first), said)
        return Edge(first, store.newest.number, step, information, LOOP)

    def _hints(self) -> list[Place]:
        """Where earlier closures lead, the newest first."""
        query = self.store.newest.number
        hints: list[Closure] = []
        for one in reversed(self.pending):
            is_followed = any(self._is_same(one, other) for other in hints)
            if one.edge.second != query and not is_followed and not self._is_known(one):
                hints.append(one)
        return [
            Place(pose[:2], PARAMS.hint_window, float(pose[2]))
            for pose in (self._leads_to(one) for one in hints[: PARAMS.max_hints])
        ]

    def _is_known(self, closure: Closure) -> bool:
        """Say whether the newest keyframe was found in a closure's place already."""
        query = self.store.newest.number
        return any(
            one.edge.second == query and self._is_same(one, closure)
            for one in [*self.pending, *self.found]
        )

    def _leads_to(self, closure: Closure) -> NDArray[np.float64]:
        """Return where a closure has the newest keyframe (3,)."""
        known = self._poses.get(id(closure))
        if known is None:
            known = self._edge_leads_to(closure.edge)
            self._poses[id(closure)] = known
        return known

    def _edge_leads_to(self, edge: Edge) -> NDArray[np.float64]:
        at = compose(self.store.pose(edge.first), edge.step)
        return compose(at, between(self.store.pose(edge.second), self.store.poses[-1]))

    def _is_same(self, one: Closure, other: Closure) -> bool:
        """Say whether two closures have the newest keyframe in one place."""
        return _is_near(self._leads_to(one), self._leads_to(other))

    def _is_wrong(self, closure: Closure) -> bool:
        """Say whether the part was joined there before, and did not fit."""
        return any(_is_near(self._leads_to(closure), pose) for pose in self._wrong)

    def _close(self, place: Place) -> Slices[Closure | None]:
        store = self.store
        away = np.hypot(*(store.poses[:, :2] - place.middle).T)
        near = np.flatnonzero((away < PARAMS.around_m) & ~store.loose)
        numbers = [store.keyframes[row].number for row in near.tolist()]
        always = [] if store.prior is None else [store.prior]
        pose = np.array([*place.middle, place.yaw])
        chosen = store.choose_near(numbers, pose, self.config.local_keyframes, always)
        number = store.newest.number
        return (yield from closing(store, number, place, chosen, PARAMS.reach_m))

    def _best(self) -> list[Closure]:
        """Return closures that agree over enough distance and have no rivals, else none."""
        every = [*self.pending, *self.found]
        groups: list[list[Closure]] = []
        for one in self.found:
            number = one.edge.second
            group = [
                other
                for other in every
                if other.edge.second != number and agree(self.store, other.edge, one.edge)
            ]
            groups.append([*group, one])
        groups.sort(key=len)
        if not groups or len(groups[-1]) < 2:
            return []
        best = groups[-1]
        information = pinned(self.store, [one.edge for one in best])
        if not self.is_searched or information < LOOPS.min_pinned:
            return []
        rivals = [one for one in every if not self._is_same(one, best[-1])]
        rival = max((self._likelihood(one, rivals) for one in rivals), default=0.0)
        if self._likelihood(best[-1], best) < max(rival, 0.0) + PARAMS.lead:
            return []
        return best if self._shown(best) >= self._wanted_m(best) else []

    def _wanted_m(self, closures: Sequence[Closure]) -> float:
        """Return the distance over which closures must agree to be believed [m]."""
        is_clear = min(one.quality.explained for one in closures) >= PARAMS.clear_explained
        if is_clear:
            return PARAMS.clear_proof_m
        if self.joint.covariance is None:
            return PARAMS.proof_m
        is_near = self._odometry_cost(closures[-1]) <= PARAMS.near_cost
        return PARAMS.clear_proof_m if is_near else PARAMS.far_proof_m

    def _likelihood(self, closure: Closure, others: Sequence[Closure]) -> float:
        """Return the log-likelihood of all scans that were found where a closure leads.

        What the odometry says of the place counts, too.
        """
        best: dict[int, float] = {}
        for one in others:
            if self._is_same(one, closure):
                number, value = one.edge.second, one.quality.log_likelihood
                best[number] = max(value, best.get(number, 0.0))
        return sum(best.values()) - self._odometry_cost(closure)

    def _odometry_cost(self, closure: Closure) -> float:
        """Return what the odometry across the gap says against where a closure leads."""
        if self.joint.covariance is None:
            return 0.0
        begin_T_here = between(self.store.pose(self.joint.number), self.store.poses[-1])
        begin = compose(self._leads_to(closure), between(begin_T_here, np.zeros(3)))
        away = begin - self.joint.pose
        away[2] = math.remainder(away[2], 2.0 * math.pi)
        cost = 0.5 * float(away @ np.linalg.solve(self.joint.covariance, away))
        if math.hypot(away[0], away[1]) > self._carried_m:
            return cost
        return min(cost, PARAMS.odometry_cost)

    @cached_property
    def _carried_m(self) -> float:
        """How far the part may lie from where the odometry had it, by drift and carried [m]."""
        ways_m = self.store.distances_from(self.store.newest.number, math.inf)
        drift_m = self.config.drift_share * ways_m.get(self.joint.number, math.inf)
        return PARAMS.carried_mps * self.joint.unseen_s + drift_m

    def _shown(self, closures: Sequence[Closure]) -> float:
        """Return how far apart the scans of closures were taken at most [m], turns counted in."""
        poses = np.array([self.store.pose(one.edge.second) for one in closures])
        away = between(poses[:, None], poses[None])
        return float(
            (np.hypot(away[..., 0], away[..., 1]) + PARAMS.turn_m * np.abs(away[..., 2])).max()
        )

    def _fits(self, closure: Closure) -> bool:
        """Say whether the map does not contradict the part where a closure has it."""
        store = self.store
        part = [
            n
            for n in store.part_of(store.newest.number)
            if not store.keyframes[store.rows[n]].is_blind
        ]
        part = part[:: max(len(part) // PARAMS.max_checked, 1)]
        new_T_old = compose(self._leads_to(closure), between(store.poses[-1], np.zeros(3)))
        known, explained = 0, 0
        for number in part:
            pose = compose(new_T_old, store.pose(number))
            away = np.hypot(*(store.poses[:, :2] - pose[:2]).T)
            near = np.flatnonzero((away < PARAMS.around_m) & ~store.loose)
            always = [] if store.prior is None else [store.prior]
            chosen = store.choose_near(
                [store.keyframes[row].number for row in near.tolist()],
                pose, self.config.local_keyframes, always,
            )  # fmt: skip
            if not chosen:
                continue
            local = LocalMap(
                [store.keyframes[store.rows[n]] for n in chosen],
                np.array([store.pose(n) for n in chosen]), pose[:2], PARAMS.reach_m,
            )  # fmt: skip
            one = store.keyframes[store.rows[number]]
            sweep = Sweep(one.cloud(), one.laser.astype(np.float64), is_blind=False)
            cloud = Cloud(sweep.cloud.points, np.zeros_like(sweep.cloud.normals))
            classes = local.classify(pose, replace(sweep, cloud=cloud), PARAMS.checked_near_m)
            known += int(np.count_nonzero(classes != UNKNOWN))
            explained += int(np.count_nonzero(classes == EXPLAINED))
        return explained >= PARAMS.min_match * known

    def _join(self, closures: list[Edge]) -> Slices[None]:
        """Tie the part to the map, lay it there, and draw the map anew."""
        newest = self.store.newest.number
        part = self.store.part_of(newest)
        first = closures[-1]
        at = compose(self.store.pose(first.first), first.step)
        new_T_old = compose(at, between(self.store.pose(first.second), np.zeros(3)))
        for number in part:
            self.store.poses[self.store.rows[number]] = compose(new_T_old, self.store.pose(number))
        for edge in closures:
            self.store.link(edge)
        yield from relax(self.store)
        self.accepted = closures
        yield from self._bridge()
        self.occupancy = yield from draw_map(self.blank, self.store)

    def _bridge(self) -> Slices[None]:
        """Believe the odometry across the gap, too, where it fits."""
        edge = self.joint.edge
        if edge is None or not self.store.has(edge):
            return
        bridged = self.store.copy()
        bridged.link(edge)
        yield from relax(bridged)
        if total_error(bridged) - total_error(self.store) <= PARAMS.joint_error:
            self.store, self.accepted = bridged, [*self.accepted, edge]


def _is_near(one: NDArray[np.float64], other: NDArray[np.float64]) -> bool:
    """Say whether two poses (3,) of a keyframe are one place."""
    x, y, yaw = (one - other).tolist()
    reach_m, reach_rad = PARAMS.hint_window
    is_turned = abs(math.remainder(yaw, 2.0 * math.pi)) >= reach_rad
    return math.hypot(x, y) < reach_m and not is_turned
