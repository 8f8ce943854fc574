"""Echoes of a scan that lie beside each other and are no larger than a person."""

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel


class SegmentParams(NamedTuple):
    """What is one segment; found by hand in simulated drives among people."""

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
    depth: float = 0.4
    """The lidar sees one side of a body or a leg: the middle lies this share of its width behind
    the middle of what is seen (pi / 8 for a round one)."""


SEGMENTS = SegmentParams()
Floats = NDArray[np.float64]


class Segment(NamedTuple):
    """Echoes beside each other that are no larger than a person."""

    points: Floats
    """(k, 2) [m]."""
    place: Floats
    """(2,) its middle, which the lidar does not see [m]."""


def segments_of(points: Floats, origin: Floats, step_rad: float) -> list[Segment]:
    """Return points (n, 2) in the order of the beams as segments of a person's size.

    Args:
        points: of the scan.
        origin: (2,) of the beams.
        step_rad: angle between two beams.
    """
    if len(points) < 2:
        return []
    begins = begins_of(points, origin, step_rad)
    ends = np.flatnonzero(begins[1:]) + 1
    pieces = [points[begin:end] for begin, end in pairwise([0, *ends.tolist(), len(points)])]
    # The scan begins and ends in the middle of something.
    if len(pieces) > 1 and not begins[0]:
        pieces[0] = np.concatenate([pieces.pop(), pieces[0]])
    found: list[Segment] = []
    for parts in _with_both_legs(_without_edges(pieces)):
        together = parts[0] if len(parts) == 1 else np.concatenate(parts)
        if size_of(together) <= SEGMENTS.largest_m:
            middles = [_middle(part, origin) for part in parts]
            place = middles[0] if len(middles) == 1 else np.mean(middles, axis=0)
            found.append(Segment(together, place))
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
        begins[index] = gap > SEGMENTS.gap_m + math.sqrt(2.0 * SEGMENTS.round_m * apart_m)
    return begins


def _without_edges(pieces: list[Floats]) -> list[Floats]:
    """Return pieces without single echoes from the edge of the piece before or behind."""
    kept: list[Floats] = []
    for index, piece in enumerate(pieces):
        beside = pieces[max(index - 1, 0)], pieces[(index + 1) % len(pieces)]
        is_edge = len(piece) == 1 and any(
            len(other) >= SEGMENTS.body_points and gap_between(piece, other) <= SEGMENTS.edge_m
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
    behind = SEGMENTS.depth * (most - least)
    return x + behind * away_x, y + behind * away_y


def _with_both_legs(pieces: list[Floats]) -> list[list[Floats]]:
    """Return the parts of each segment: pieces that may be the two legs of one person together."""
    joined: list[list[Floats]] = []
    legs: list[int] = []
    for piece in pieces:
        if size_of(piece) > SEGMENTS.leg_m:
            joined.append([piece])
            continue
        # Between two legs something farther away may be seen.
        for index in reversed(legs):
            other = joined[index][0]
            # Most are far from each other: two of their points show that at little cost.
            if math.dist(other[0], piece[0]) > SEGMENTS.pair_m:
                continue
            both = np.concatenate([other, piece])
            if size_of(both) <= SEGMENTS.pair_m and gap_between(other, piece) <= SEGMENTS.stride_m:
                joined[index].append(piece)
                legs.remove(index)
                break
        else:
            legs.append(len(joined))
            joined.append([piece])
    return joined


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
    width = points[:, 0].max() - points[:, 0].min()
    return math.hypot(width, points[:, 1].max() - points[:, 1].min())
