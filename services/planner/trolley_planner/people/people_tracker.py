"""Finds who moves: parts of a scan that stand where beams passed a moment ago.

Everything is in frame `grid` [m]. What merely comes into sight is no mover: nothing had been seen
to be free there.
"""

import math
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley_planner.sensing.beams import CLEAR, DX, DY, ECHO, X, Y

SIGHT_M = 3.5
"""Movers are looked for this near to the lidar,"""
WALL_M = 0.12
"""not in what lies this near to a wall of the map,"""
GAP_M = 0.3
"""and parts of the scan are one thing up to this gap,"""
LARGEST_M = 1.0
"""if they are not larger than this together."""
LEG_M, STRIDE_M, PAIR_M = 0.25, 0.5, 0.65
"""Two things as small as a leg, with up to such a gap, are one if they are no larger together."""
PAST_M = 0.15
"""A beam that went on this far behind a place saw that it was free,"""
BESIDE_RAD = 0.025
"""if those so far to both sides did so, too: edges of things jump from scan to scan."""
PAUSE_S = 0.06
"""Of a fast lidar's scans only some are looked at: within less time little moves."""
LEAST_AGO_S, MOST_AGO_S = 0.08, 0.45
"""How old the scans may be that the newest one is compared with."""
TRACK_S = 0.6
"""A velocity is that of so much time: legs swing."""
HIDDEN_S = 1.0
"""Who comes out of sight is taken to walk on for so long."""
SLOWEST_MPS, FASTEST_MPS = 0.25, 2.5
"""Slower is noise, and faster two different things."""
ASTRAY_M = 0.3
"""Whose velocity is known is looked for this near to where it leads."""
DEPTH_M, BODY_M = 0.06, 0.22
"""Of what moves the lidar sees one side: it is larger by so much, and no smaller than that."""
LEAST_POINTS, LEAST_SHARE = 2, 0.2
"""So many points of a thing, and such a share, must stand where it was free."""

Floats = NDArray[np.float64]


class Mover(NamedTuple):
    """Something that moves."""

    points: Floats
    """(n, 2) where the lidar sees it [m]."""
    velocity: Floats
    """(2,) [m/s]."""
    is_seen: bool = True
    """Whether the newest scan shows it; else it is where it must have gone."""


def discs_of(movers: Sequence[Mover]) -> Floats:
    """Return who moves as discs: (n, 5) x, y [m], velocity [m/s], radius [m]."""
    discs = np.empty((len(movers), 5))
    for index, mover in enumerate(movers):
        middle = mover.points.mean(axis=0)
        spread = float(np.hypot(*(mover.points - middle).T).max())
        discs[index] = *middle, *mover.velocity, max(spread + DEPTH_M, BODY_M)
    return discs


class _View(NamedTuple):
    """What is kept of a scan."""

    stamp_ns: int
    origin: Floats
    """(2,) middle place of the lidar [m]."""
    angles: Floats
    """(n,) of the beams, rising [rad]."""
    clear_m: Floats
    """(n,) how far all beams about each saw that it was free."""
    things: list[Floats]
    """(k, 2) points of each thing that is not on the map."""
    tracks: list[Floats]
    """(m, 3) for each thing where its middle was, oldest first: time since `stamp_ns` [s], x, y."""
    origins: list[int]
    """Index of each thing in the scan before, -1 if it is new."""


class MoverWatch:
    """Compares each scan with those of the last tenths of a second."""

    def __init__(self) -> None:
        self._views: deque[_View] = deque(maxlen=8)
        self._seen: list[Mover | None] = []
        self._hidden: list[tuple[int, Mover]] = []

    def reset(self) -> None:
        """Forget all scans, as after a jump of the pose."""
        self._views.clear()
        self._seen, self._hidden = [], []

    def look(
        self, stamp_ns: int, beams: Floats, wall_distance_m: NDArray[np.float32], edge_m: float
    ) -> list[Mover]:
        """Return what moves.

        Args:
            stamp_ns: robot time.
            beams: (n, 6) the newest scan, cut at mirrors and walls (columns: kernels.beams).
            wall_distance_m: (rows, cols) distance of each cell to the nearest wall of the map.
            edge_m: edge of these cells.
        """
        if len(beams) < 2:
            return []
        last = self._views[-1] if self._views else None
        if last is not None and abs(stamp_ns - last.stamp_ns) < PAUSE_S * 1e9:
            return [_moved(mover, stamp_ns - last.stamp_ns) for mover in self._found()]
        view = _view_of(stamp_ns, beams, wall_distance_m, edge_m, last)
        earlier = [one for one in self._views if _is_comparable(one, stamp_ns)]
        self._views.append(view)
        seen = [
            _mover(thing, track, None if origin >= 0 and self._seen[origin] else earlier)
            for thing, track, origin in zip(view.things, view.tracks, view.origins, strict=True)
        ]
        if last is not None:
            self._hidden = self._now_hidden(view, last.stamp_ns)
        self._seen = seen
        return self._found()

    def _found(self) -> list[Mover]:
        seen = [mover for mover in self._seen if mover is not None]
        return seen + [mover for _, mover in self._hidden]

    def _now_hidden(self, view: _View, last_ns: int) -> list[tuple[int, Mover]]:
        """Return who walks where the newest scan does not look, and since when."""
        lost = [
            (last_ns, mover)
            for index, mover in enumerate(self._seen)
            if mover is not None and index not in view.origins
        ]
        hidden: list[tuple[int, Mover]] = []
        for since_ns, before in self._hidden + lost:
            mover = _moved(before, view.stamp_ns - last_ns)
            middle = mover.points.mean(axis=0)
            is_back = any(math.dist(middle, thing.mean(axis=0)) < ASTRAY_M for thing in view.things)
            is_gone = view.stamp_ns - since_ns > HIDDEN_S * 1e9
            if not is_back and not is_gone and not _was_free(view, middle[None])[0]:
                hidden.append((since_ns, mover._replace(is_seen=False)))
        return hidden


def _moved(mover: Mover, time_ns: int) -> Mover:
    return mover._replace(points=mover.points + time_ns * 1e-9 * mover.velocity)


def _is_comparable(view: _View, stamp_ns: int) -> bool:
    return LEAST_AGO_S <= (stamp_ns - view.stamp_ns) * 1e-9 <= MOST_AGO_S


def _view_of(
    stamp_ns: int,
    beams: Floats,
    wall_distance_m: NDArray[np.float32],
    edge_m: float,
    last: _View | None,
) -> _View:
    """Return what is kept of a scan."""
    angles = np.unwrap(np.arctan2(beams[:, DY], beams[:, DX]))
    width = max(1, round(BESIDE_RAD * (len(beams) - 1) / max(float(angles[-1] - angles[0]), 1e-3)))
    padded = np.pad(beams[:, CLEAR], width, mode="edge")
    clear_m = np.lib.stride_tricks.sliding_window_view(padded, 2 * width + 1).min(axis=1)
    echo = beams[:, ECHO]
    seen = beams[(echo > 0.0) & (echo < SIGHT_M)]
    points = seen[:, [X, Y]] + seen[:, ECHO, None] * seen[:, [DX, DY]]
    cells = np.floor(points / edge_m).astype(np.int64)
    rows, cols = wall_distance_m.shape
    inside = (cells >= 0).all(axis=1) & (cells[:, 0] < cols) & (cells[:, 1] < rows)
    points, cells = points[inside], cells[inside]
    loose = points[wall_distance_m[cells[:, 1], cells[:, 0]] > WALL_M]
    origin = beams[:, [X, Y]].mean(axis=0)
    things = _things(loose)
    return _View(stamp_ns, origin, angles, clear_m, things, *_tracks(stamp_ns, things, last))


def _tracks(
    stamp_ns: int, things: list[Floats], last: _View | None
) -> tuple[list[Floats], list[int]]:
    """Return the track of each thing, and which one of the last scan it must have been."""
    here = np.array([[0.0, *thing.mean(axis=0)] for thing in things]).reshape(-1, 1, 3)
    tracks, origins = list(here), [-1] * len(things)
    if last is None or not things or not last.tracks:
        return tracks, origins
    elapsed_s = (stamp_ns - last.stamp_ns) * 1e-9
    velocities = [_velocity(track) for track in last.tracks]
    expected = np.array([track[-1, 1:] for track in last.tracks])
    known = [velocity is not None for velocity in velocities]
    expected += elapsed_s * np.array([[0.0, 0.0] if one is None else one for one in velocities])
    reach = np.where(known, ASTRAY_M, FASTEST_MPS * elapsed_s)
    lengths = np.hypot(*np.moveaxis(here[:, 0, 1:] - expected[:, None], -1, 0))
    for index in range(len(things)):
        origin = int(lengths[:, index].argmin())
        # What became of another thing is not where this one comes from.
        is_other = int(lengths[origin].argmin()) != index
        if is_other or lengths[origin, index] > reach[origin]:
            continue
        before = last.tracks[origin] - (elapsed_s, 0.0, 0.0)
        tracks[index] = np.concatenate([before[before[:, 0] >= -TRACK_S], here[index]])
        origins[index] = origin
    return tracks, origins


def _velocity(track: Floats) -> Floats | None:
    """Return the velocity along a track, None if it is too short to say."""
    if track[0, 0] > -LEAST_AGO_S:
        return None
    times = track[:, 0] - track[:, 0].mean()
    return times @ track[:, 1:] / (times @ times)


def _things(points: Floats) -> list[Floats]:
    """Return points (n, 2) in the order of the beams as things (k, 2) of a person's size."""
    if len(points) < LEAST_POINTS:
        return []
    gaps = np.hypot(*np.diff(points, axis=0).T)
    things = np.split(points, np.flatnonzero(gaps > GAP_M) + 1)
    # The scan begins and ends in the middle of something.
    if len(things) > 1 and math.dist(things[0][0], things[-1][-1]) <= GAP_M:
        things[0] = np.concatenate([things.pop(), things[0]])
    return [thing for thing in _with_both_legs(things) if _size(thing) <= LARGEST_M]


def _with_both_legs(things: list[Floats]) -> list[Floats]:
    """Return things with those that may be the two legs of one person as one."""
    joined: list[Floats] = []
    legs: list[int] = []
    for thing in things:
        if _size(thing) > LEG_M:
            joined.append(thing)
            continue
        # Between two legs something farther away may be seen.
        for index in reversed(legs):
            other = joined[index]
            # Most are far from each other: two of their points show that at little cost.
            if math.dist(other[0], thing[0]) > PAIR_M:
                continue
            both = np.concatenate([other, thing])
            if _size(both) <= PAIR_M and _gap(other, thing) <= STRIDE_M:
                joined[index] = both
                legs.remove(index)
                break
        else:
            legs.append(len(joined))
            joined.append(thing)
    return joined


def _gap(one: Floats, other: Floats) -> float:
    return float(np.hypot(*np.moveaxis(one[:, None] - other, -1, 0)).min())


def _size(points: Floats) -> float:
    return float(np.hypot(*(points.max(axis=0) - points.min(axis=0))))


def _mover(thing: Floats, track: Floats, earlier: list[_View] | None) -> Mover | None:
    """Return a thing with its velocity; None if it stands, or may have been hidden before.

    Args:
        thing: (k, 2) its points.
        track: where it has been.
        earlier: scans to compare with; None for what is known to move.
    """
    least = max(LEAST_POINTS, LEAST_SHARE * len(thing))
    if earlier is not None and not any(
        np.count_nonzero(_was_free(before, thing)) >= least for before in earlier
    ):
        return None
    velocity = _velocity(track)
    if velocity is None or math.hypot(*velocity.tolist()) < SLOWEST_MPS:
        return None
    return Mover(thing, velocity)


def _was_free(view: _View, points: Floats) -> NDArray[np.bool_]:
    """Say of points (n, 2) whether beams of an earlier scan passed there."""
    offset = points - view.origin
    turned = (np.arctan2(offset[:, 1], offset[:, 0]) - view.angles[0]) % (2.0 * math.pi)
    after = np.asarray(np.searchsorted(view.angles - view.angles[0], turned), dtype=np.int64)
    last = len(view.angles) - 1
    clear_m = np.minimum(view.clear_m[np.minimum(after, last)], view.clear_m[after - 1])
    seen = (after > 0) & (after <= last) | (turned > 2.0 * math.pi - BESIDE_RAD)
    return seen & (clear_m > np.hypot(offset[:, 0], offset[:, 1]) + PAST_M)
