"""Samples into beams: a beam's range is its own surface's, and none is between two surfaces."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from support.cases import cases

from trolley_base.drivers.lidars.scan_grid import STRAIGHT, Floats, Grid, place

STEP_DEG = 0.5
NO_INTENSITY = np.empty(0)


def wall_m(angle_deg: Floats, away_m: float, facing_deg: float) -> Floats:
    """How far a straight wall is, by the distance and direction of its nearest point."""
    return away_m / np.cos(np.radians(angle_deg - facing_deg))


def uneven(rng: np.random.Generator, count: int = 120) -> tuple[Grid, Floats]:
    """A grid, and as many samples beside its beams, none overtaking another."""
    beside = rng.uniform(0.0, 0.45) * np.sin(np.arange(count) / rng.uniform(5.0, 40.0))
    return Grid(20.0, STEP_DEG, count), 20.0 + STEP_DEG * (np.arange(count) + beside)


@settings(deadline=None, max_examples=cases(100))
@given(seed=st.integers(0, 2**32 - 1), away_m=st.floats(0.2, 8.0), facing_deg=st.floats(0.0, 100.0))
def test_beams_of_one_wall_lie_on_it(seed: int, away_m: float, facing_deg: float) -> None:
    grid, angle_deg = uneven(np.random.default_rng(seed))
    ranges, _ = place(grid, angle_deg, wall_m(angle_deg, away_m, facing_deg), NO_INTENSITY)
    exact = wall_m(grid.angles_deg(), away_m, facing_deg)
    np.testing.assert_allclose(ranges, exact, rtol=1e-6)


@settings(deadline=None, max_examples=cases(200))
@given(
    seed=st.integers(0, 2**32 - 1),
    at=st.integers(3, 116),
    step=st.floats(2.5 * STRAIGHT, 2.0),
    facing_deg=st.tuples(st.floats(30.0, 70.0), st.floats(30.0, 70.0)),
)
def test_no_beam_is_between_two_depths(
    seed: int, at: int, step: float, facing_deg: tuple[float, float]
) -> None:
    grid, angle_deg = uneven(np.random.default_rng(seed))
    edge_deg = 0.5 * (angle_deg[at - 1] + angle_deg[at])
    near = np.array([wall_m(one, 1.0, facing_deg[0]) for one in (angle_deg, grid.angles_deg())])
    # The walls are apart by `step` of the range where the nearer one ends.
    beyond = (1.0 + step) * wall_m(edge_deg, 1.0, facing_deg[0])
    away_m = beyond * np.cos(np.radians(edge_deg - facing_deg[1]))
    far = np.array([wall_m(one, away_m, facing_deg[1]) for one in (angle_deg, grid.angles_deg())])
    range_m = np.where(angle_deg < edge_deg, near[0], far[0])
    ranges, _ = place(grid, angle_deg, range_m, NO_INTENSITY)
    beside = np.minimum(np.abs(ranges / near[1] - 1.0), np.abs(ranges / far[1] - 1.0))
    # At the edge a sample may stay as it is, a half step beside its beam.
    assert beside.max() < 0.01
    assert np.count_nonzero(beside > 1e-6) <= 2


@settings(deadline=None, max_examples=cases(60))
@given(seed=st.integers(0, 2**32 - 1), invalid=st.floats(0.0, 0.5))
def test_what_is_not_an_echo_is_neither_moved_nor_used(seed: int, invalid: float) -> None:
    rng = np.random.default_rng(seed)
    grid, angle_deg = uneven(rng)
    exact = wall_m(angle_deg, 2.0, 50.0)
    draw = rng.random(len(exact))
    range_m = np.where(draw < invalid, 0.0, np.where(draw > 1.0 - 0.5 * invalid, np.inf, exact))
    ranges, _ = place(grid, angle_deg, range_m, NO_INTENSITY)
    is_echo = (ranges > 0.0) & np.isfinite(ranges)
    np.testing.assert_array_equal(is_echo[range_m == 0.0], False)
    np.testing.assert_allclose(
        ranges[is_echo], wall_m(grid.angles_deg(), 2.0, 50.0)[is_echo], rtol=0.01
    )
    np.testing.assert_array_equal(np.isinf(ranges), np.isinf(range_m))
