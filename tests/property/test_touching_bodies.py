"""What several bodies share is cut between them, and nothing else is."""

import math

import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.typing import NDArray
from support.round_bodies import ranges_to

from trolley_planner.people.touching_bodies import TOUCHING, told_apart

STEP_RAD = math.radians(0.5)
bodies_of = st.tuples(st.floats(1.2, 3.0), st.floats(-0.6, 0.6), st.floats(0.2, 0.5))


def seen(bodies: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Echoes (n, 2) of round bodies (m, 3) in the order of the beams, and whose each is."""
    angles = np.arange(-1.0, 1.0, STEP_RAD)
    ways = np.column_stack([np.cos(angles), np.sin(angles)])
    ranges = ranges_to(bodies, angles)
    is_met = np.isfinite(ranges).any(axis=1)
    return ways[is_met] * ranges[is_met].min(axis=1)[:, None], ranges[is_met].argmin(axis=1)


@given(bodies_of, st.floats(0.2, 0.5), st.floats(-1.5, 1.5), st.integers(0, 2**32 - 1))
def test_two_bodies_that_touch_are_cut_where_they_touch(
    body: tuple[float, float, float], radius: float, bearing: float, seed: int
) -> None:
    x, y, first = body
    apart = 0.95 * (first + radius)
    other = x + apart * math.cos(bearing + 1.6), y + apart * math.sin(bearing + 1.6), radius
    bodies = np.array([body, other])
    assume(other[0] > radius + 0.3)
    points, whose = seen(bodies)
    changes = np.flatnonzero(np.diff(whose))
    assume(len(changes) == 1 and 6 <= changes[0] + 1 <= len(whose) - 6)
    expected = bodies.copy()
    expected[:, :2] += np.random.default_rng(seed).uniform(-0.03, 0.03, (2, 2))
    ends, is_cut = told_apart(points, np.array([len(points)]), expected)
    # Where they touch they lie so near each other that a wrong echo or two make no difference.
    assert math.dist(points[ends[0]], points[changes[0] + 1]) < 0.15
    assert is_cut.tolist() == [True, False]


@given(bodies_of, bodies_of, st.integers(0, 2**32 - 1))
def test_one_body_is_not_cut_whoever_is_elsewhere(
    body: tuple[float, float, float], other: tuple[float, float, float], seed: int
) -> None:
    gap = math.dist(body[:2], other[:2]) - body[2] - other[2]
    assume(gap > TOUCHING.near_m)
    points, _ = seen(np.array([body]))
    bodies = np.array([body, other])
    bodies[:, :2] += np.random.default_rng(seed).uniform(-0.03, 0.03, (2, 2))
    ends, is_cut = told_apart(points, np.array([len(points)]), bodies)
    assert ends.tolist() == [len(points)]
    assert not is_cut.any()


def test_three_in_a_row_are_three() -> None:
    bodies = np.array([[2.0, -0.5, 0.25], [2.0, 0.0, 0.25], [2.0, 0.5, 0.25]])
    points, whose = seen(bodies)
    ends, is_cut = told_apart(points, np.array([len(points)]), bodies)
    assert is_cut.tolist() == [True, True, False]
    assert np.abs(ends[:2] - (np.flatnonzero(np.diff(whose)) + 1)).max() <= 1
