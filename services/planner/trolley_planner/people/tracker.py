"""People and other moving things: who moves, and where to.

People are segments of a scan that stand where beams passed a moment ago. What merely comes into
sight does not move: that place had not been seen to be free. Everything is in frame `grid` [m].
"""

import math
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel
from trolley_planner.people.free_space import (
    View,
    take_apart,
    views_of,
    was_free,
    was_free_in_any,
)
from trolley_planner.people.segments import SEGMENTS, Segment, segments_of, size_of
from trolley_planner.people.sights import (
    HIDDEN,
    NUM_COLUMNS,
    SEEN_X,
    SEEN_Y,
    SIGHTS,
    is_sliver,
    middle_of,
    width_seen,
)
from trolley_planner.people.velocity_estimation import TRACKS, track_on
from trolley_planner.sensing.beams import X, Y


class PeopleTrackerParams(NamedTuple):
    """Who counts as moving; found by hand in simulated drives among people."""

    pause_s: float = 0.06
    """Time between scans below which the later one is skipped: little moves meanwhile."""
    most_ago_s: float = 1.6
    """Greatest age of the scans that the newest is compared with: who comes slowly and straight at
    the lidar needs so long to stand clearly where beams passed."""
    new_s: float = 0.15
    """Time for which something is new: parts of somebody come and go."""
    recent_s: float = 0.45
    """Greatest age of the scans that what is new is compared with."""
    hidden_s: float = 1.0
    """Time for which a person out of sight is taken to walk on."""
    slowest_mps: float = 0.2
    """Speed below which a new track is noise."""
    lingering_mps: float = 0.12
    """Speed down to which a person who was seen to walk stays one."""
    fastest_mps: float = 2.5
    """Speed above which two echoes are two different objects."""
    astray_m: float = 0.4
    """Distance from the predicted position within which a person is matched."""
    depth_m: float = 0.03
    """Extra radius of a person beyond the echoes."""
    body_m: float = 0.22
    """Least radius of a person."""
    least_points: int = 2
    """Number of a segment's points that must lie where the floor was free."""
    least_share: float = 0.2
    """Share of a segment's points that must lie where the floor was free."""


TRACKING = PeopleTrackerParams()
Floats = NDArray[np.float64]
NO_TRACK = np.empty((0, 1 + NUM_COLUMNS))


class TrackedPerson(NamedTuple):
    """A person, or anything else of that size that moves."""

    points: Floats
    """(n, 2) where the lidar sees it [m]."""
    place: Floats
    """(2,) its middle [m]."""
    velocity: Floats
    """(2,) [m/s]."""
    velocity_std: float = 0.1
    """Standard deviation of each of them [m/s]."""
    is_seen: bool = True
    """Whether the newest scan shows it; else it is where it must have gone."""


def person_discs(people: Sequence[TrackedPerson]) -> Floats:
    """Return people as discs: (n, 5) x, y [m], velocity [m/s], radius [m]."""
    discs = np.empty((len(people), 5))
    for index, person in enumerate(people):
        spread_m = farthest_m(person.points, person.place)
        radius = max(spread_m + TRACKING.depth_m, TRACKING.body_m)
        discs[index] = *person.place, *person.velocity, radius
    return discs


@kernel
def farthest_m(points: Floats, place: Floats) -> float:
    """Return the distance from a place (2,) to the farthest of some points (n, 2) [m]."""
    farthest = 0.0
    for index in range(points.shape[0]):
        away = math.hypot(points[index, 0] - place[0], points[index, 1] - place[1])
        farthest = max(farthest, away)
    return farthest


class Track(NamedTuple):
    """An object of a person's size that is not on the map, standing or not, person or not."""

    identity: object
    """By which it is known for as long as it is tracked; no other track ever has the same."""
    place: Floats
    """(2,) [m]."""
    size_m: float
    """Across the points that are seen."""
    velocity: Floats
    """(2,) [m/s]; zero where it stands, or is not known yet."""
    is_moving: bool
    """Whether it was seen to move."""


class Trail(NamedTuple):
    """A segment through some scans, up to the last one that shows it."""

    identity: object
    """By which it is known for as long as it is tracked; no other track ever has the same."""
    seen_ns: int
    """When it was seen last."""
    points: Floats
    """(n, 2) where the scan that showed it last did so [m]."""
    place: tuple[float, float]
    """Its middle then [m]."""
    track: Floats
    """(m, 8) what was seen of it, oldest first: time since `seen_ns` [s], and a sight."""
    width_m: float
    """How wide it is, as far as it was seen."""
    velocity: tuple[float, float]
    """Along the track [m/s]."""
    velocity_std: float
    """Its standard deviation [m/s], infinite if the track is too short."""
    person: TrackedPerson | None
    """Who it is; None if it stands, or may have been hidden before."""
    is_body: bool
    """Whether it was ever seen whole, and wider than a leg."""
    has_walked: bool
    """Whether it was ever seen to walk."""

    def expected(self, stamp_ns: int) -> tuple[float, float]:
        """Return the predicted centre."""
        elapsed_s = self.elapsed_s(stamp_ns)
        (x, y), (vx, vy) = self.place, self.velocity
        return x + elapsed_s * vx, y + elapsed_s * vy

    def reach_m(self, stamp_ns: int) -> float:
        """Return the search radius around the predicted centre [m]."""
        if math.isinf(self.velocity_std):
            return TRACKING.fastest_mps * self.elapsed_s(stamp_ns)
        return TRACKING.astray_m

    def elapsed_s(self, stamp_ns: int) -> float:
        """Return how long ago it was seen last [s]."""
        return (stamp_ns - self.seen_ns) * 1e-9


class PeopleTracker:
    """Compares each scan with those of the last second or two."""

    def __init__(self) -> None:
        self._views: deque[View] = deque(maxlen=24)
        self._trails: list[Trail] = []

    def reset(self) -> None:
        """Forget all scans, as after a jump of the pose."""
        self._views.clear()
        self._trails = []

    def update(
        self, stamp_ns: int, beams: Floats, wall_distance_m: NDArray[np.float32], edge_m: float
    ) -> list[TrackedPerson]:
        """Return what moves.

        Args:
            stamp_ns: robot time.
            beams: (n, 6) the newest scan, cut at mirrors and walls (columns: sensing.beams).
            wall_distance_m: (rows, cols) distance of each cell to the nearest wall of the map.
            edge_m: edge of these cells.
        """
        if len(beams) < 2:
            return []
        last = self._views[-1] if self._views else None
        if last is not None and abs(stamp_ns - last.stamp_ns) < TRACKING.pause_s * 1e9:
            return self._people(stamp_ns)
        angles, clear_m, loose, is_hidden = take_apart(beams, wall_distance_m, edge_m)
        view = View(stamp_ns, beams[:, [X, Y]].mean(axis=0), angles, clear_m)
        earlier = [
            one
            for one in self._views
            if TRACKS.least_s <= one.age_s(stamp_ns) <= TRACKING.most_ago_s
        ]
        self._views.append(view)
        spread = max(float(angles[-1] - angles[0]), 1e-3)
        step_rad, bodies = spread / (len(angles) - 1), self._bodies(stamp_ns)
        segments = segments_of(loose, is_hidden, view.origin, step_rad, bodies)
        before = _origins(segments, self._trails, stamp_ns)
        hidden = self._now_hidden(set(before), view)
        self._trails = [
            self._trail(segment, None if origin < 0 else self._trails[origin], view, earlier)
            for segment, origin in zip(segments, before, strict=True)
        ] + hidden
        return self._people(stamp_ns)

    def tracks(self) -> list[Track]:
        """Return the objects of a person's size in the newest scan, standing ones included."""
        found: list[Track] = []
        for trail in self._trails:
            if trail.seen_ns == self._views[-1].stamp_ns:
                person, size_m = trail.person, size_of(trail.points)
                velocity = np.zeros(2) if person is None else person.velocity
                place = np.array(trail.place)
                found.append(Track(trail.identity, place, size_m, velocity, person is not None))
        return found

    def standing(self) -> list[Trail]:
        """Return who and what stands now."""
        return [one for one in self._trails if one.person is None]

    def _bodies(self, stamp_ns: int) -> Floats:
        """Return (n, 3) where the bodies must be by now that were seen whole, and their radii."""
        return np.array(
            [
                (*trail.expected(stamp_ns), 0.5 * trail.width_m)
                for trail in self._trails
                if trail.is_body and trail.velocity_std < math.inf
            ]
        ).reshape(-1, 3)

    def _people(self, stamp_ns: int) -> list[TrackedPerson]:
        """Return all people at their present positions."""
        newest_ns = self._views[-1].stamp_ns
        return [
            one.person
            if one.seen_ns == stamp_ns
            else _extrapolated(one.person, stamp_ns - one.seen_ns, one.seen_ns == newest_ns)
            for one in self._trails
            if one.person is not None
        ]

    def _trail(
        self, segment: Segment, before: Trail | None, view: View, earlier: Sequence[View]
    ) -> Trail:
        """Return the trail of a segment, which goes on from one before."""
        if before is None:
            identity, is_known, is_body, has_walked = object(), False, False, False
            track, elapsed_s, width_m = NO_TRACK, 0.0, SIGHTS.width_m
        else:
            identity, is_body, has_walked = before.identity, before.is_body, before.has_walked
            is_known = before.person is not None
            track, elapsed_s = before.track, before.elapsed_s(view.stamp_ns)
            width_m = before.width_m
        track, width_m, place, velocity, std = track_on(track, elapsed_s, segment.sight, width_m)
        slowest, person = TRACKING.lingering_mps if is_known else TRACKING.slowest_mps, None
        if math.hypot(*velocity) >= slowest and (
            is_known or _walks(segment.points, track, width_m, view, earlier)
        ):
            person = TrackedPerson(segment.points, np.array(place), np.array(velocity), std)
        stamp_ns, points, sight = view.stamp_ns, segment.points, segment.sight
        shows_body = sight[HIDDEN] == 0.0 and width_seen(sight) > SEGMENTS.leg_m
        is_body = is_body or bool(shows_body)
        has_walked = has_walked or person is not None
        seen = identity, stamp_ns, points, place, track, width_m, velocity, std
        return Trail(*seen, person, is_body, has_walked)

    def _now_hidden(self, taken: set[int], view: View) -> list[Trail]:
        """Return the trails of people who are hidden from the newest scan."""
        hidden: list[Trail] = []
        for index, trail in enumerate(self._trails):
            if trail.person is None or index in taken:
                continue
            middle = trail.expected(view.stamp_ns)
            is_gone = view.stamp_ns - trail.seen_ns > TRACKING.hidden_s * 1e9
            if not is_gone and not was_free(view, np.array([middle]))[0]:
                hidden.append(trail)
        return hidden


def _extrapolated(person: TrackedPerson, time_ns: int, is_seen: bool) -> TrackedPerson:
    moved = time_ns * 1e-9 * person.velocity
    points, place = person.points + moved, person.place + moved
    return person._replace(points=points, place=place, is_seen=is_seen)


def _origins(segments: list[Segment], trails: list[Trail], stamp_ns: int) -> list[int]:
    """Return the index of the trail that each segment continues, -1 if it is new."""
    origins = [-1] * len(segments)
    if not segments or not trails:
        return origins
    sights = np.array([segment.sight for segment in segments])
    expected = np.array([trail.expected(stamp_ns) for trail in trails])
    reach_m = np.array([trail.reach_m(stamp_ns) for trail in trails])
    widths_m = np.array([trail.width_m for trail in trails])
    return assigned(sights, expected, reach_m, widths_m).tolist()


@kernel
def assigned(
    sights: Floats, expected: Floats, reach_m: Floats, widths_m: Floats
) -> NDArray[np.int64]:
    """Return which of the expected places each sight is of, -1 for none: the nearest pairs first.

    Args:
        sights: (n, 7) columns: people.sights.
        expected: (m, 2) [m].
        reach_m: (m,) how far away from there it may be.
        widths_m: (m,) how wide what is expected there is.
    """
    num_expected, num_places = expected.shape[0], sights.shape[0]
    lengths = np.full(num_expected * num_places, np.inf)
    for row in range(num_expected):
        for col in range(num_places):
            x, y = middle_of(sights[col], widths_m[row])
            dx, dy = x - expected[row, 0], y - expected[row, 1]
            length = math.hypot(dx, dy)
            if length <= reach_m[row]:
                lengths[row * num_places + col] = length
    origins = np.full(num_places, -1, np.int64)
    is_taken = np.zeros(num_expected, np.bool_)
    for flat in np.argsort(lengths, kind="mergesort"):
        row, col = flat // num_places, flat % num_places
        if lengths[flat] == np.inf:
            break
        if not is_taken[row] and origins[col] < 0:
            origins[col] = row
            is_taken[row] = True
    return origins


def _walks(
    points: Floats, track: Floats, width_m: float, view: View, earlier: Sequence[View]
) -> bool:
    """Say whether what moves along a track walks; it may only have been hidden before.

    Args:
        points: (n, 2) of it in the newest scan.
        track: of it.
        width_m: how wide it is.
        view: the newest scan.
        earlier: scans to compare with.
    """
    if is_sliver(track[-1, 1:], width_m):
        return False
    return _came(points, track, view, earlier) or _left(track, view)


def _came(points: Floats, track: Floats, view: View, earlier: Sequence[View]) -> bool:
    """Say whether points (n, 2) lie where earlier beams passed."""
    least = max(float(TRACKING.least_points), TRACKING.least_share * len(points))
    is_new = -float(track[0, 0]) < TRACKING.new_s
    ago_s = TRACKING.recent_s if is_new else TRACKING.most_ago_s
    recent = [one for one in earlier if one.age_s(view.stamp_ns) <= ago_s]
    return bool(recent) and was_free_in_any(views_of(recent), points, least)


def _left(track: Floats, view: View) -> bool:
    """Say whether beams now pass where a track was: a person who walks away is hidden."""
    before = track[track[:, 0] <= -TRACKS.least_s, 1 + SEEN_X : 2 + SEEN_Y]
    # One alone may have lain on an edge that beams graze.
    return int(np.count_nonzero(was_free(view, before))) >= TRACKING.least_points
