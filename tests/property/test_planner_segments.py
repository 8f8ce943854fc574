"""Taking scans apart into segments: the compiled loops beside a slow plain twin."""

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from support.cases import cases

from trolley_planner.people.free_space import View, views_of, was_free, was_free_in_any
from trolley_planner.people.segments import SEGMENTS, begins_of, segments_of
from trolley_planner.people.sights import HIDDEN, SIGHTS, middle_of

Floats = NDArray[np.float64]
ORIGIN, STEP_RAD = np.array([0.1, -0.2]), 0.0175


def scan(seed: int) -> Floats:
    """Echoes (n, 2) all round of legs, bodies and walls, in the order of the beams."""
    rng = np.random.default_rng(seed)
    polar: list[tuple[float, float]] = []
    angle = float(rng.uniform(0.0, 0.3))
    while angle < 2.0 * math.pi:
        distance = float(rng.uniform(0.4, 5.0)) if rng.random() < 0.6 or not polar else polar[-1][0]
        for _ in range(int(rng.integers(1, 12))):
            polar.append((distance + float(rng.uniform(-0.02, 0.02)), angle))
            angle += STEP_RAD
        angle += float(rng.choice([0.0, 0.05, 0.3, 0.6]))
    return np.array([(r * math.cos(turn), r * math.sin(turn)) for r, turn in polar]) + ORIGIN


def size(points: Floats) -> float:
    return math.hypot(*np.ptp(points, axis=0))


def gap(one: Floats, other: Floats) -> float:
    return min(math.dist(a, b) for a in one for b in other)


def plain_pieces(points: Floats, step_rad: float) -> list[Floats]:
    begins = begins_of(points, ORIGIN, step_rad)
    pieces = np.split(points, [index for index in range(1, len(points)) if begins[index]])
    if len(pieces) > 1 and not begins[0]:
        pieces[0] = np.concatenate([pieces.pop(), pieces[0]])
    return pieces


def plain_segments(points: Floats, step_rad: float) -> list[tuple[list[Floats], Floats]]:
    """Parts of each segment, and its middle where all of it is seen."""
    pieces = plain_pieces(points, step_rad)
    joined: list[list[Floats]] = []
    legs: list[int] = []
    for index, piece in enumerate(pieces):
        beside = pieces[max(index - 1, 0)], pieces[(index + 1) % len(pieces)]
        is_edge = [
            len(b) >= SEGMENTS.body_points and gap(piece, b) <= SEGMENTS.edge_m for b in beside
        ]
        if len(piece) == 1 and any(is_edge):
            continue
        pair = None
        if size(piece) <= SEGMENTS.leg_m:
            for leg in reversed(legs):
                other = joined[leg][0]
                together = size(np.concatenate([other, piece]))
                if together <= SEGMENTS.pair_m and gap(other, piece) <= SEGMENTS.stride_m:
                    pair = leg
                    break
            else:
                legs.append(len(joined))
        if pair is None:
            joined.append([piece])
        else:
            joined[pair].append(piece)
            legs.remove(pair)
    return [
        (parts, np.mean([plain_middle(part) for part in parts], axis=0))
        for parts in joined
        if size(np.concatenate(parts)) <= SEGMENTS.largest_m
    ]


def plain_middle(part: Floats) -> Floats:
    """Behind the mean of what is seen, by a share of its width across the view."""
    mean = part.mean(axis=0)
    away = (mean - ORIGIN) / math.dist(mean, ORIGIN)
    beside = (part - mean) @ (-away[1], away[0])
    return mean + SIGHTS.depth * float(np.ptp(beside)) * away


@settings(max_examples=cases(60))
@given(st.integers(0, 2**32 - 1))
def test_segments_are_those_of_lists_of_pieces(seed: int) -> None:
    points = scan(seed)
    is_hidden = np.random.default_rng(seed).random((len(points), 2)) < 0.3
    found = segments_of(points, is_hidden, ORIGIN, STEP_RAD)
    plain = plain_segments(points, STEP_RAD)
    assert len(found) == len(plain)
    hidden_by_point = {
        tuple(point): tuple(sides) for point, sides in zip(points, is_hidden, strict=True)
    }
    for one, (parts, middle) in zip(found, plain, strict=True):
        assert np.array_equal(one.points, np.concatenate(parts))
        assert np.allclose(middle_of(one.sight, 0.0), middle, atol=1e-9)
        # Of two legs neither side counts as hidden.
        right, left = (
            hidden_by_point[tuple(parts[0][0])][0],
            hidden_by_point[tuple(parts[0][-1])][1],
        )
        assert one.sight[HIDDEN] == (right + 2 * left if len(parts) == 1 else 0)


@given(st.integers(1, 4), st.integers(0, 2**32 - 1), st.floats(0.5, 6.0))
def test_what_several_scans_saw_free_is_what_one_of_them_did(
    count: int, seed: int, least: float
) -> None:
    rng = np.random.default_rng(seed)
    views: list[View] = []
    for _ in range(count):
        beams = int(rng.integers(2, 40))
        angles = np.cumsum(np.full(beams, rng.uniform(0.02, 0.15))) + rng.uniform(-3.0, 0.0)
        views.append(View(0, rng.uniform(-0.3, 0.3, 2), angles, rng.uniform(0.2, 3.0, beams)))
    points = rng.uniform(-2.0, 2.0, (8, 2))
    plain = any(np.count_nonzero(was_free(view, points)) >= least for view in views)
    assert was_free_in_any(views_of(views), points, least) == plain
