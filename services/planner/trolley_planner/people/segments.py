"""Echoes of a scan that lie beside each other and are no larger than a person."""

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel
from trolley_planner.people.sights import (
    AWAY_X,
    AWAY_Y,
    HIDDEN,
    LEFT,
    LEFT_IS_HIDDEN,
    NUM_COLUMNS,
    RIGHT,
    RIGHT_IS_HIDDEN,
    SEEN_X,
    SEEN_Y,
    middle_of,
)
from trolley_planner.people.touching_bodies import sides_cut, told_apart


class SegmentParams(NamedTuple):
    """What is one segment; found by hand in simulated drives among people."""

    gap_m: float = 0.03
    """Gap between neighbouring echoes of one segment, besides what `round_m` allows."""
    round_m: float = 0.15
    """Radius of a round object whose outermost beams, which lie farther apart, still make one
    segment."""
    edge_m: float = 0.3
    """Distance from a segment within which a lone echo is its edge and is left out."""
    body_points: int = 4
    """Number of echoes from which on a segment may have such an edge."""
    largest_m: float = 1.25
    """Segments are no larger than this: the diagonal of half a circle of 1 m, seen askew."""
    leg_m: float = 0.25
    """Largest extent of a segment that may be a leg."""
    stride_m: float = 0.5
    """Largest gap between the two legs of a person."""
    pair_m: float = 0.65
    """Largest extent of two legs that are one person."""


SEGMENTS = SegmentParams()
Floats = NDArray[np.float64]
NO_BODIES = np.empty((0, 3))
"""Nobody is known."""


class Segment(NamedTuple):
    """Echoes beside each other that are no larger than a person."""

    points: Floats
    """(k, 2) [m]."""
    sight: Floats
    """(7,) columns: people.sights."""


def segments_of(
    points: Floats,
    is_hidden: NDArray[np.bool_],
    origin: Floats,
    step_rad: float,
    bodies: Floats = NO_BODIES,
) -> list[Segment]:
    """Return points (n, 2) in the order of the beams as segments of a person's size.

    Args:
        points: of the scan.
        is_hidden: (n, 2) whether something hides what is to the right and to the left of each.
        origin: (2,) of the beams.
        step_rad: angle between two beams.
        bodies: (m, 3) x, y, radius [m] of those that are known, where they must be by now.
    """
    if len(points) < 2:
        return []
    ordered, ends, sights = group(points, is_hidden, origin, step_rad, bodies)
    firsts = [0, *ends.tolist()]
    return [
        Segment(ordered[first:end], sight)
        for (first, end), sight in zip(pairwise(firsts), sights, strict=True)
    ]


@kernel
def group(
    points: Floats,
    is_hidden: NDArray[np.bool_],
    origin: Floats,
    step_rad: float,
    bodies: Floats,
) -> tuple[Floats, NDArray[np.int64], Floats]:
    """Return the points of all segments one after the other, where each ends, and its sight.

    Args:
        points: (n, 2) in the order of the beams.
        is_hidden: (n, 2) whether something hides what is to the right and to the left of each.
        origin: (2,) of the beams.
        step_rad: angle between two beams.
        bodies: (m, 3) see `segments_of`.

    Returns:
        (k, 2), (m,) and (m, 7).
    """
    ring, ends, shift = pieces_of(points, begins_of(points, origin, step_rad))
    ends, is_cut = told_apart(ring, ends, bodies)
    parts = with_both_legs(ring, ends, without_edges(ring, ends), is_cut)
    ordered, sights = np.empty_like(ring), np.empty((parts.shape[0], NUM_COLUMNS))
    segment_ends, count, at = np.empty(parts.shape[0], np.int64), 0, 0
    for index in range(parts.shape[0]):
        one = piece(ring, ends, parts[index, 0])
        other = piece(ring, ends, parts[index, 1]) if parts[index, 1] >= 0 else one
        if size_of_both(one, other) > SEGMENTS.largest_m:
            continue
        ordered[at : at + one.shape[0]] = one
        at += one.shape[0]
        sight = sights[count]
        see_into(sight, one, origin)
        if parts[index, 1] >= 0:
            ordered[at : at + other.shape[0]] = other
            at += other.shape[0]
            add_leg(sight, other, origin)
        else:
            which = parts[index, 0]
            first = (ends[which - 1] if which > 0 else 0) - shift
            last = first + one.shape[0] - 1
            right, left = sides_cut(is_cut, which)
            sight[HIDDEN] += RIGHT_IS_HIDDEN if is_hidden[first, 0] or right else 0
            sight[HIDDEN] += LEFT_IS_HIDDEN if is_hidden[last, 1] or left else 0
        segment_ends[count] = at
        count += 1
    return ordered[:at].copy(), segment_ends[:count].copy(), sights[:count].copy()


@kernel
def pieces_of(points: Floats, begins: NDArray[np.bool_]) -> tuple[Floats, NDArray[np.int64], int]:
    """Return points (n, 2) in an order that cuts no piece, where each ends (m,), and the shift.

    The shift is the number of places by which the points have moved on.
    """
    count, last = points.shape[0], points.shape[0] - 1
    while last > 0 and not begins[last]:
        last -= 1
    # The scan begins and ends in the middle of something.
    shift = count - last if last > 0 and not begins[0] else 0
    ring, ends, num = np.empty_like(points), np.empty(count, np.int64), 0
    ring[:shift], ring[shift:] = points[count - shift :], points[: count - shift]
    for index in range(1, count - shift):
        if begins[index]:
            ends[num] = shift + index
            num += 1
    ends[num] = count
    return ring, ends[: num + 1], shift


@kernel
def piece(ring: Floats, ends: NDArray[np.int64], index: int) -> Floats:
    """Return the points of a piece."""
    return ring[ends[index - 1] if index > 0 else 0 : ends[index]]


@kernel
def begins_of(points: Floats, origin: Floats, step_rad: float) -> NDArray[np.bool_]:
    """Say for points (n, 2) whether they are on something else than the one before; see above."""
    count = points.shape[0]
    begins = np.empty(count, np.bool_)
    for index in range(count):
        x, y = points[index, 0], points[index, 1]
        gap = math.hypot(x - points[index - 1, 0], y - points[index - 1, 1])
        apart_m = step_rad * math.hypot(x - origin[0], y - origin[1])
        begins[index] = gap > SEGMENTS.gap_m + math.sqrt(2.0 * SEGMENTS.round_m * apart_m)
    return begins


@kernel
def without_edges(ring: Floats, ends: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the pieces that are not a single echo from the edge of the piece before or behind."""
    num, count = ends.shape[0], 0
    kept = np.empty(num, np.int64)
    for index in range(num):
        here = piece(ring, ends, index)
        is_edge = False
        if here.shape[0] == 1:
            for beside in (max(index - 1, 0), (index + 1) % num):
                other = piece(ring, ends, beside)
                is_body = other.shape[0] >= SEGMENTS.body_points
                is_edge |= is_body and gap_between(here, other) <= SEGMENTS.edge_m
        if not is_edge:
            kept[count] = index
            count += 1
    return kept[:count]


@kernel
def centre_of(points: Floats) -> tuple[float, float]:
    """Return the mean of points (n, 2)."""
    count, x, y = points.shape[0], 0.0, 0.0
    for index in range(count):
        x, y = x + points[index, 0], y + points[index, 1]
    return x / count, y / count


@kernel
def see_into(out_sight: Floats, part: Floats, origin: Floats) -> None:
    """Write the sight (7,) of points (k, 2) none of whose sides are hidden."""
    x, y = centre_of(part)
    away_x, away_y = x - origin[0], y - origin[1]
    length = max(math.hypot(away_x, away_y), 1e-6)
    away_x, away_y = away_x / length, away_y / length
    least, most = math.inf, -math.inf
    for index in range(part.shape[0]):
        beside = (part[index, 1] - y) * away_x - (part[index, 0] - x) * away_y
        least, most = min(least, beside), max(most, beside)
    out_sight[SEEN_X], out_sight[SEEN_Y], out_sight[HIDDEN] = x, y, 0.0
    out_sight[AWAY_X], out_sight[AWAY_Y] = away_x, away_y
    out_sight[RIGHT], out_sight[LEFT] = least, most


@kernel
def add_leg(sight: Floats, leg: Floats, origin: Floats) -> None:
    """Make the sight (7,) of a leg that of both.

    Legs swing and hide each other: what is known is where the middle between them lies.
    """
    x, y = middle_of(sight, 0.0)
    see_into(sight, leg, origin)
    other_x, other_y = middle_of(sight, 0.0)
    sight[SEEN_X], sight[SEEN_Y] = 0.5 * (x + other_x), 0.5 * (y + other_y)
    sight[RIGHT] = sight[LEFT] = 0.0


@kernel
def with_both_legs(
    ring: Floats, ends: NDArray[np.int64], pieces: NDArray[np.int64], is_cut: NDArray[np.bool_]
) -> NDArray[np.int64]:
    """Return the parts (m, 2) of each segment: a piece, and -1 or the other leg of its person.

    What was cut off from something is no leg.
    """
    parts, count = np.full((pieces.shape[0], 2), -1, np.int64), 0
    is_leg = np.zeros(pieces.shape[0], np.bool_)  # one that stands alone so far
    for index in pieces:
        here = piece(ring, ends, index)
        right, left = sides_cut(is_cut, index)
        if not (right or left) and size_of(here) <= SEGMENTS.leg_m:
            # Between two legs something farther away may be seen.
            before = count - 1
            while before >= 0 and not (
                is_leg[before] and are_a_pair(piece(ring, ends, parts[before, 0]), here)
            ):
                before -= 1
            if before >= 0:
                parts[before, 1], is_leg[before] = index, False
                continue
            is_leg[count] = True
        parts[count, 0] = index
        count += 1
    return parts[:count]


@kernel
def are_a_pair(one: Floats, other: Floats) -> bool:
    """Say whether two legs (n, 2) and (m, 2) may be those of one person."""
    if size_of_both(one, other) > SEGMENTS.pair_m:
        return False
    return gap_between(one, other) <= SEGMENTS.stride_m


@kernel
def gap_between(one: Floats, other: Floats) -> float:
    """Return the distance between the nearest of points (n, 2) and others (m, 2)."""
    nearest = math.inf
    for index in range(one.shape[0]):
        for second in range(other.shape[0]):
            dx, dy = one[index, 0] - other[second, 0], one[index, 1] - other[second, 1]
            nearest = min(nearest, math.hypot(dx, dy))
    return nearest


@kernel
def size_of(points: Floats) -> float:
    """Return the diagonal of the box around points (n, 2)."""
    return size_of_both(points, points)


@kernel
def size_of_both(one: Floats, other: Floats) -> float:
    """Return the diagonal of the box around points (n, 2) and others (m, 2)."""
    left = right = one[0, 0]
    low = high = one[0, 1]
    for points in (one, other):
        for index in range(points.shape[0]):
            left, right = min(left, points[index, 0]), max(right, points[index, 0])
            low, high = min(low, points[index, 1]), max(high, points[index, 1])
    return math.hypot(right - left, high - low)
