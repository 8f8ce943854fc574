"""People and other moving things: who moves, where to, and where they will be.

People are segments of a scan that stand where beams passed a moment ago. What merely comes into
sight does not move: that place had not been seen to be free. Everything is in frame `grid` [m].
"""

import itertools
import math
from collections import deque
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel
from trolley_planner.sensing.beams import CLEAR, DX, DY, ECHO, X, Y


class PeopleTrackerParams(NamedTuple):
    """Who counts as moving; found by hand in simulated drives among people."""

    sight_m: float = 6.0
    """Only echoes this near to the lidar are tracked,"""
    wall_m: float = 0.12
    """and none this near to a wall of the map."""
    gap_m: float = 0.03
    """Echoes beside each other are one segment with gaps up to this, and what the outermost"""
    round_m: float = 0.15
    """beams on something round of this radius are apart."""
    edge_m: float = 0.3
    """An echo alone, no farther than this beside"""
    body_points: int = 4
    """a segment of so many, is the edge of it and says nothing."""
    largest_m: float = 1.25
    """Segments are no larger than this: the diagonal of half a circle of 1 m, seen askew."""
    leg_m: float = 0.25
    """Two segments no larger than this, a leg,"""
    stride_m: float = 0.5
    """with up to this gap between them,"""
    pair_m: float = 0.65
    """are one person if they are no larger than this together."""
    past_m: float = 0.15
    """A beam that went on this far behind a place saw that it was free,"""
    beside_rad: float = 0.025
    """if those this far to both sides did so, too: edges of things jump from scan to scan."""
    pause_s: float = 0.06
    """Scans that follow sooner than this are skipped: little moves meanwhile."""
    least_ago_s: float = 0.08
    """The newest scan is compared with scans at least this old"""
    most_ago_s: float = 0.45
    """and at most this old."""
    track_s: float = 0.6
    """A velocity is measured over this time: legs swing."""
    straight: float = 1.2
    """It is measured over `left_s` if the track scatters no more than this many times as much."""
    track_noise_m: float = 0.03
    """Places of a track err by this much at least, whatever its own scatter says."""
    left_s: float = 1.2
    """Through where somebody stood within this time, beams must pass now that they walked away."""
    hidden_s: float = 1.0
    """A person out of sight is taken to walk on for this long."""
    slowest_mps: float = 0.2
    """Slower is noise,"""
    lingering_mps: float = 0.12
    """but who was seen to walk may become as slow as this,"""
    fastest_mps: float = 2.5
    """and faster two different things."""
    astray_m: float = 0.3
    """A person with a known velocity is looked for this near to where it leads."""
    depth: float = 0.4
    """The lidar sees one side of a body or a leg: the middle lies this share of its width behind
    the middle of what is seen (pi / 8 for a round one)."""
    depth_m: float = 0.03
    """A person is larger than what is seen by this much"""
    body_m: float = 0.22
    """and no smaller than this."""
    least_points: int = 2
    """At least this many points of a segment,"""
    least_share: float = 0.2
    """and this share of them, must stand where it was free."""


TRACKING = PeopleTrackerParams()


Floats = NDArray[np.float64]
NO_TRACK = np.empty((0, 5))


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
        spread = float(np.hypot(*(person.points - person.place).T).max())
        radius = max(spread + TRACKING.depth_m, TRACKING.body_m)
        discs[index] = *person.place, *person.velocity, radius
    return discs


class Track(NamedTuple):
    """Something of a person's size that is not on the map: it may stand, and be no person."""

    number: int
    """By which it is known for as long as it is tracked."""
    place: Floats
    """(2,) [m]."""
    size_m: float
    """Across the points that are seen."""
    velocity: Floats
    """(2,) [m/s]; zero where it stands, or is not known yet."""
    is_moving: bool
    """Whether it was seen to move."""


class _Segment(NamedTuple):
    """Echoes beside each other that are no larger than a person."""

    points: Floats
    """(k, 2) [m]."""
    place: Floats
    """(2,) its middle, which the lidar does not see [m]."""


class _View(NamedTuple):
    """What is kept of a scan."""

    stamp_ns: int
    origin: Floats
    """(2,) middle place of the lidar [m]."""
    angles: Floats
    """(n,) of the beams, rising [rad]."""
    clear_m: Floats
    """(n,) how far all beams about each saw that it was free."""


class _Trail(NamedTuple):
    """A segment through some scans, up to the last one that shows it."""

    number: int
    """By which it is known for as long as it is tracked."""
    seen_ns: int
    """When it was seen last."""
    segment: _Segment
    """As it was seen last."""
    track: Floats
    """(m, 5) where it was, oldest first: time since `seen_ns` [s], its middle, and the middle of
    what was seen of it."""
    motion: tuple[Floats, float] | None
    """Velocity along the track and its standard deviation [m/s], None if it is too short."""
    person: TrackedPerson | None
    """Who it is; None if it stands, or may have been hidden before."""

    def expected(self, stamp_ns: int) -> Floats:
        """Return where its middle (2,) must be by now."""
        here = self.track[-1, 1:3]
        return here if self.motion is None else here + self.motion[0] * self.elapsed_s(stamp_ns)

    def reach_m(self, stamp_ns: int) -> float:
        """Return how far from there it is looked for."""
        elapsed_s = self.elapsed_s(stamp_ns)
        return TRACKING.fastest_mps * elapsed_s if self.motion is None else TRACKING.astray_m

    def elapsed_s(self, stamp_ns: int) -> float:
        """Return how long ago it was seen last [s]."""
        return (stamp_ns - self.seen_ns) * 1e-9


class PeopleTracker:
    """Compares each scan with those of the last tenths of a second."""

    def __init__(self) -> None:
        self._views: deque[_View] = deque(maxlen=8)
        self._new_numbers = itertools.count()
        self._trails: list[_Trail] = []

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
        angles, clear_m, loose = take_apart(beams, wall_distance_m, edge_m)
        view = _View(stamp_ns, beams[:, [X, Y]].mean(axis=0), angles, clear_m)
        earlier = [one for one in self._views if _is_comparable(one, stamp_ns)]
        self._views.append(view)
        spread = max(float(angles[-1] - angles[0]), 1e-3)
        segments = _segments(loose, view.origin, spread / (len(angles) - 1))
        before = _origins(segments, self._trails, stamp_ns)
        hidden = self._now_hidden(segments, set(before), view)
        self._trails = [
            self._trail(segment, None if origin < 0 else self._trails[origin], view, earlier)
            for segment, origin in zip(segments, before, strict=True)
        ] + hidden
        return self._people(stamp_ns)

    def tracks(self) -> list[Track]:
        """Return what the newest scan shows of a person's size, who stands as well."""
        found: list[Track] = []
        for trail in self._trails:
            if trail.seen_ns == self._views[-1].stamp_ns:
                person, (points, place) = trail.person, trail.segment
                velocity = np.zeros(2) if person is None else person.velocity
                size_m = _size(points)
                found.append(Track(trail.number, place, size_m, velocity, person is not None))
        return found

    def _people(self, stamp_ns: int) -> list[TrackedPerson]:
        """Return everybody, where they are by now."""
        newest_ns = self._views[-1].stamp_ns
        return [
            _extrapolated(one.person, stamp_ns - one.seen_ns, one.seen_ns == newest_ns)
            for one in self._trails
            if one.person is not None
        ]

    def _trail(
        self, segment: _Segment, before: _Trail | None, view: _View, earlier: list[_View]
    ) -> _Trail:
        """Return the trail of a segment, which goes on from one before."""
        if before is None:
            number, is_known = next(self._new_numbers), False
            track, elapsed_s = NO_TRACK, 0.0
        else:
            number, is_known = before.number, before.person is not None
            track, elapsed_s = before.track, before.elapsed_s(view.stamp_ns)
        track = longer_track(track, elapsed_s, segment.place, segment.points)
        motion = _motion(track)
        person = _person(segment, track, motion, view, None if is_known else earlier)
        return _Trail(number, view.stamp_ns, segment, track, motion, person)

    def _now_hidden(self, segments: list[_Segment], taken: set[int], view: _View) -> list[_Trail]:
        """Return the trails of people where the newest scan does not look."""
        hidden: list[_Trail] = []
        for index, trail in enumerate(self._trails):
            if trail.person is None or index in taken:
                continue
            middle = trail.expected(view.stamp_ns)
            is_gone = view.stamp_ns - trail.seen_ns > TRACKING.hidden_s * 1e9
            if not is_gone and not _was_free(view, middle[None])[0]:
                hidden.append(trail)
        return hidden


def _extrapolated(person: TrackedPerson, time_ns: int, is_seen: bool) -> TrackedPerson:
    moved = time_ns * 1e-9 * person.velocity
    points, place = person.points + moved, person.place + moved
    return person._replace(points=points, place=place, is_seen=is_seen)


def _is_comparable(view: _View, stamp_ns: int) -> bool:
    return TRACKING.least_ago_s <= (stamp_ns - view.stamp_ns) * 1e-9 <= TRACKING.most_ago_s


def _origins(segments: list[_Segment], trails: list[_Trail], stamp_ns: int) -> list[int]:
    """Return the index of the trail that each segment continues, -1 if it is new."""
    origins = [-1] * len(segments)
    if not segments or not trails:
        return origins
    places = np.array([segment.place for segment in segments])
    expected = np.array([trail.expected(stamp_ns) for trail in trails])
    reach_m = np.array([trail.reach_m(stamp_ns) for trail in trails])
    return assigned(places, expected, reach_m).tolist()


@kernel
def assigned(places: Floats, expected: Floats, reach_m: Floats) -> NDArray[np.int64]:
    """Return which of the expected places each place is, -1 for none: the nearest pairs first.

    Args:
        places: (n, 2) [m].
        expected: (m, 2) [m].
        reach_m: (m,) how far away from there it may be.
    """
    num_expected, num_places = expected.shape[0], places.shape[0]
    lengths = np.full(num_expected * num_places, np.inf)
    for row in range(num_expected):
        for col in range(num_places):
            dx, dy = places[col, 0] - expected[row, 0], places[col, 1] - expected[row, 1]
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


@kernel
def longer_track(track: Floats, elapsed_s: float, place: Floats, points: Floats) -> Floats:
    """Return what matters still of a track (n, 5), and where it is now as its last row.

    Args:
        track: see `_Trail.track`.
        elapsed_s: since its last row.
        place: (2,) the middle [m].
        points: (k, 2) what is seen [m].
    """
    first, count = 0, track.shape[0]
    while first < count and track[first, 0] - elapsed_s < -TRACKING.left_s:
        first += 1
    longer = np.empty((count - first + 1, 5))
    longer[:-1] = track[first:]
    longer[:-1, 0] -= elapsed_s
    last = longer[-1]
    last[0], last[1], last[2] = 0.0, place[0], place[1]
    last[3], last[4] = centre_of(points)
    return longer


def _motion(track: Floats) -> tuple[Floats, float] | None:
    """Return the velocity along a track and its standard deviation, None if it is too short.

    A straight line is fitted, over a longer time where the track was straight for that long; what
    the track strays from it says how sure its slope is.
    """
    if track[0, 0] > -TRACKING.least_ago_s:
        return None
    vx, vy, std = fit_motion(track)
    return None if math.isinf(std) else (np.array([vx, vy]), std)


@kernel
def fit_motion(track: Floats) -> tuple[float, float, float]:
    """Return the velocity along a track (n, 5) and its deviation, infinite if it is too short."""
    count, lately = track.shape[0], 0
    while lately < count and track[lately, 0] < -TRACKING.track_s:
        lately += 1
    if count - lately < TRACKING.least_points:
        return 0.0, 0.0, math.inf  # only the newest scan is new enough
    vx, vy, noise_m, squares = fit_line(track[lately:])
    if lately > 0:
        longer = fit_line(track)
        if longer[2] < TRACKING.straight * max(noise_m, TRACKING.track_noise_m):
            vx, vy, noise_m, squares = longer
    return vx, vy, max(noise_m, TRACKING.track_noise_m) / math.sqrt(squares)


@kernel
def fit_line(track: Floats) -> tuple[float, float, float, float]:
    """Return slope, scatter [m] and the sum of squared times [s^2] of a line through a track."""
    count = track.shape[0]
    t, x, y = 0.0, 0.0, 0.0
    for index in range(count):
        t, x, y = t + track[index, 0], x + track[index, 1], y + track[index, 2]
    t, x, y = t / count, x / count, y / count
    squares, vx, vy = 0.0, 0.0, 0.0
    for index in range(count):
        since = track[index, 0] - t
        squares += since * since
        vx, vy = vx + since * track[index, 1], vy + since * track[index, 2]
    vx, vy = vx / squares, vy / squares
    astray = 0.0
    for index in range(count):
        since = track[index, 0] - t
        dx, dy = track[index, 1] - x - since * vx, track[index, 2] - y - since * vy
        astray += dx * dx + dy * dy
    return vx, vy, math.sqrt(astray / (2.0 * count)), squares


def _segments(points: Floats, origin: Floats, step_rad: float) -> list[_Segment]:
    """Return points (n, 2) in the order of the beams as segments of a person's size.

    Args:
        points: of the scan.
        origin: (2,) of the beams.
        step_rad: angle between two beams.
    """
    if len(points) < TRACKING.least_points:
        return []
    begins = begins_of(points, origin, step_rad)
    ends = np.flatnonzero(begins[1:]) + 1
    pieces = [points[begin:end] for begin, end in pairwise([0, *ends.tolist(), len(points)])]
    # The scan begins and ends in the middle of something.
    if len(pieces) > 1 and not begins[0]:
        pieces[0] = np.concatenate([pieces.pop(), pieces[0]])
    found: list[_Segment] = []
    for parts in _with_both_legs(_without_edges(pieces)):
        together = parts[0] if len(parts) == 1 else np.concatenate(parts)
        if _size(together) <= TRACKING.largest_m:
            middles = [_middle(part, origin) for part in parts]
            place = middles[0] if len(middles) == 1 else np.mean(middles, axis=0)
            found.append(_Segment(together, place))
    return found


@kernel
def begins_of(points: Floats, origin: Floats, step_rad: float) -> NDArray[np.bool_]:
    """Say of points (n, 2) whether they are on something else than the one before; see above."""
    count = points.shape[0]
    begins = np.empty(count, np.bool_)
    for index in range(count):
        x, y = points[index, 0], points[index, 1]
        gap = math.hypot(x - points[index - 1, 0], y - points[index - 1, 1])
        apart_m = step_rad * math.hypot(x - origin[0], y - origin[1])
        begins[index] = gap > TRACKING.gap_m + math.sqrt(2.0 * TRACKING.round_m * apart_m)
    return begins


def _without_edges(pieces: list[Floats]) -> list[Floats]:
    """Return pieces without single echoes from the edge of the piece before or behind."""
    kept: list[Floats] = []
    for index, piece in enumerate(pieces):
        beside = pieces[max(index - 1, 0)], pieces[(index + 1) % len(pieces)]
        is_edge = len(piece) == 1 and any(
            len(other) >= TRACKING.body_points and _gap(piece, other) <= TRACKING.edge_m
            for other in beside
        )
        if not is_edge:
            kept.append(piece)
    return kept


def _middle(part: Floats, origin: Floats) -> Floats:
    """Return the middle (2,) of what is seen from one side: it lies behind the points (k, 2)."""
    return np.array(middle_behind(part, origin))


@kernel
def centre_of(points: Floats) -> tuple[float, float]:
    """Return the mean of points (n, 2)."""
    count, x, y = points.shape[0], 0.0, 0.0
    for index in range(count):
        x, y = x + points[index, 0], y + points[index, 1]
    return x / count, y / count


@kernel
def middle_behind(part: Floats, origin: Floats) -> tuple[float, float]:
    """Return the same as two numbers."""
    x, y = centre_of(part)
    away_x, away_y = x - origin[0], y - origin[1]
    length = max(math.hypot(away_x, away_y), 1e-6)
    away_x, away_y = away_x / length, away_y / length
    least, most = math.inf, -math.inf
    for index in range(part.shape[0]):
        beside = (part[index, 1] - y) * away_x - (part[index, 0] - x) * away_y
        least, most = min(least, beside), max(most, beside)
    behind = TRACKING.depth * (most - least)
    return x + behind * away_x, y + behind * away_y


def _with_both_legs(pieces: list[Floats]) -> list[list[Floats]]:
    """Return the parts of each segment: pieces that may be the two legs of one person together."""
    joined: list[list[Floats]] = []
    legs: list[int] = []
    for piece in pieces:
        if _size(piece) > TRACKING.leg_m:
            joined.append([piece])
            continue
        # Between two legs something farther away may be seen.
        for index in reversed(legs):
            other = joined[index][0]
            # Most are far from each other: two of their points show that at little cost.
            if math.dist(other[0], piece[0]) > TRACKING.pair_m:
                continue
            both = np.concatenate([other, piece])
            if _size(both) <= TRACKING.pair_m and _gap(other, piece) <= TRACKING.stride_m:
                joined[index].append(piece)
                legs.remove(index)
                break
        else:
            legs.append(len(joined))
            joined.append([piece])
    return joined


@kernel
def _gap(one: Floats, other: Floats) -> float:
    """Return the distance between the nearest of points (n, 2) and others (m, 2)."""
    nearest = math.inf
    for index in range(one.shape[0]):
        for second in range(other.shape[0]):
            dx, dy = one[index, 0] - other[second, 0], one[index, 1] - other[second, 1]
            nearest = min(nearest, math.hypot(dx, dy))
    return nearest


@kernel
def _size(points: Floats) -> float:
    """Return the diagonal of the box around points (n, 2)."""
    width = points[:, 0].max() - points[:, 0].min()
    return math.hypot(width, points[:, 1].max() - points[:, 1].min())


def _person(
    segment: _Segment,
    track: Floats,
    motion: tuple[Floats, float] | None,
    view: _View,
    earlier: list[_View] | None,
) -> TrackedPerson | None:
    """Return a segment as a person; None if it stands, or may have been hidden before.

    Args:
        segment: of the newest scan.
        track: where it was.
        motion: along it.
        view: the newest scan.
        earlier: scans to compare with; None for what is known to move.
    """
    slowest = TRACKING.lingering_mps if earlier is None else TRACKING.slowest_mps
    if motion is None or math.hypot(*motion[0].tolist()) < slowest:
        return None
    if earlier is None or _came(segment.points, earlier) or _left(track, view):
        return TrackedPerson(*segment, *motion)
    return None


def _came(points: Floats, earlier: list[_View]) -> bool:
    """Say whether points (n, 2) stand where earlier beams passed."""
    least = max(TRACKING.least_points, TRACKING.least_share * len(points))
    return any(np.count_nonzero(_was_free(before, points)) >= least for before in earlier)


def _left(track: Floats, view: _View) -> bool:
    """Say whether beams pass now where a track was: who walks away hides where they go."""
    before = track[track[:, 0] <= -TRACKING.least_ago_s, 3:]
    # One alone may have lain on an edge that beams graze.
    return int(np.count_nonzero(_was_free(view, before))) >= TRACKING.least_points


def _was_free(view: _View, points: Floats) -> NDArray[np.bool_]:
    """Say of points (n, 2) whether beams of an earlier scan passed there."""
    return were_passed(np.ascontiguousarray(points), view.origin, view.angles, view.clear_m)


@kernel
def take_apart(
    beams: Floats, wall_distance_m: NDArray[np.float32], edge_m: float
) -> tuple[Floats, Floats, Floats]:
    """Return the angles of beams, how far all about each are free, and echoes not on the map.

    Args:
        beams: (n, 6) columns: sensing.beams.
        wall_distance_m: (rows, cols) distance of each cell to the nearest wall of the map.
        edge_m: edge of these cells.

    Returns:
        (n,) rising [rad], (n,) [m], and (k, 2) [m].
    """
    count, (rows, cols) = beams.shape[0], wall_distance_m.shape
    angles, clear_m, loose = np.empty(count), np.empty(count), np.empty((count, 2))
    turns, num_loose = 0.0, 0
    for beam in range(count):
        angle = math.atan2(beams[beam, DY], beams[beam, DX])
        if beam > 0:
            step = angle + turns - angles[beam - 1]
            turns -= 2.0 * math.pi * math.floor((step + math.pi) / (2.0 * math.pi))
        angles[beam] = angle + turns
        echo = beams[beam, ECHO]
        if not 0.0 < echo < TRACKING.sight_m:
            continue
        x, y = beams[beam, X] + echo * beams[beam, DX], beams[beam, Y] + echo * beams[beam, DY]
        row, col = math.floor(y / edge_m), math.floor(x / edge_m)
        inside = 0 <= row < rows and 0 <= col < cols
        if inside and wall_distance_m[row, col] > TRACKING.wall_m:
            loose[num_loose, 0], loose[num_loose, 1] = x, y
            num_loose += 1
    spread = max(angles[-1] - angles[0], 1e-3)
    width = max(1, round(TRACKING.beside_rad * (count - 1) / spread))
    for beam in range(count):
        least = beams[beam, CLEAR]
        for near in range(max(beam - width, 0), min(beam + width + 1, count)):
            least = min(least, beams[near, CLEAR])
        clear_m[beam] = least
    return angles, clear_m, loose[:num_loose].copy()


@kernel
def were_passed(
    points: Floats, origin: Floats, angles: Floats, clear_m: Floats
) -> NDArray[np.bool_]:
    """Say of points (n, 2) whether beams from a place passed there.

    Args:
        points: [m].
        origin: (2,) of the beams [m].
        angles: (m,) of the beams, rising [rad].
        clear_m: (m,) how far all beams about each are free.
    """
    passed, last = np.empty(points.shape[0], np.bool_), angles.shape[0] - 1
    for index in range(points.shape[0]):
        dx, dy = points[index, 0] - origin[0], points[index, 1] - origin[1]
        turned = (math.atan2(dy, dx) - angles[0]) % (2.0 * math.pi)
        # The first beam at this angle or beyond.
        low, after = 0, last + 1
        while low < after:
            middle = (low + after) // 2
            if angles[middle] - angles[0] < turned:
                low = middle + 1
            else:
                after = middle
        is_between = 0 < after <= last
        if not is_between and turned <= 2.0 * math.pi - TRACKING.beside_rad:
            passed[index] = False
            continue
        free_m = min(clear_m[min(after, last)], clear_m[after - 1 if after > 0 else last])
        passed[index] = free_m > math.hypot(dx, dy) + TRACKING.past_m
    return passed


SAME_M = 0.15
"""A person tracked this near to where a robot says it is, is that robot."""
GROWTH_MPS = 0.02, 0.15
"""People are taken for discs that grow this fast at least and at most [m/s]."""
MAX_AGE_S = 0.5
"""Nobody is extrapolated for longer than this after the last scan."""
ROBOT_DT_S = 0.1
"""Time between two places of what robots say of where they will be."""
NOBODY = np.empty((0, 6))
"""Nobody walks."""
NO_ROBOTS = np.empty((0, 1, 3))
"""No other robot drives."""

Floats = NDArray[np.float64]


class MovingObstacles:
    """People by the newest scan, and other robots by what they say; all in frame `grid`."""

    def __init__(self) -> None:
        self._tracker = PeopleTracker()
        self._walkers, self._robots = NOBODY, NO_ROBOTS
        self._scanned_ns = self._robots_ns = 0
        self.people: list[TrackedPerson] = []
        """Who moves by the newest scan."""

    def update(
        self, now_ns: int, beams: Floats, wall_distance_m: NDArray[np.float32], resolution_m: float
    ) -> None:
        """Track people through a new scan; see `PeopleTracker.update`."""
        self.people = self._tracker.update(now_ns, beams, wall_distance_m, resolution_m)
        self._walkers = NOBODY
        if self.people:
            growth = np.clip([one.velocity_std for one in self.people], *GROWTH_MPS)
            self._walkers = np.column_stack([person_discs(self.people), growth])
        self._scanned_ns = now_ns

    @property
    def tracks(self) -> list[Track]:
        """What the newest scan shows of a person's size; see `PeopleTracker.tracks`."""
        return self._tracker.tracks()

    def set_robots(self, tracks: Sequence[Floats], now_ns: int) -> None:
        """Replace what other robots that drive say of where they will be.

        Args:
            tracks: (discs, steps, 3) of each: x, y, radius [m] at each `ROBOT_DT_S`.
            now_ns: robot time of the first step.
        """
        self._robots = np.concatenate(tracks) if tracks else NO_ROBOTS
        self._robots_ns = now_ns

    def forget_people(self) -> None:
        """Forget everybody, as after a jump of the pose."""
        self._tracker.reset()
        self.people, self._walkers = [], NOBODY

    def walkers_at(self, now_ns: int) -> Floats:
        """Return the discs (n, 6) of people where they are now; see `Field.walkers`."""
        walkers = self._walkers[~self._are_robots(self._walkers)]
        age_s = min(max((now_ns - self._scanned_ns) * 1e-9, 0.0), MAX_AGE_S)
        walkers[:, :2] += age_s * walkers[:, 2:4]
        return walkers

    def robots_at(self, now_ns: int) -> Floats:
        """Return the discs (n, steps, 3) of other robots from now on; see `Field.robots`."""
        age_s = min(max((now_ns - self._robots_ns) * 1e-9, 0.0), MAX_AGE_S)
        passed = min(round(age_s / ROBOT_DT_S), self._robots.shape[1] - 1)
        return np.ascontiguousarray(self._robots[:, passed:]) if len(self._robots) else NO_ROBOTS

    def _are_robots(self, walkers: Floats) -> NDArray[np.bool_]:
        """Say of discs (n, 6) whether each is a robot, which knows better where it will be."""
        gaps = walkers[:, None, :2] - self._robots[None, :, 0, :2]
        near = self._robots[None, :, 0, 2] + SAME_M
        return np.asarray((np.hypot(gaps[..., 0], gaps[..., 1]) < near).any(axis=1))
