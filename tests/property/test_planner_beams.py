"""Ranges smoothed along surfaces, against a plain reference."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from trolley_planner.sensing.beams import MAX_SMOOTHED, SAME_M, SURFACE_M, smooth_ranges_into

RANGES = st.lists(
    st.one_of(
        st.floats(0.2, 0.32),
        st.floats(0.05, 12.0),
        st.sampled_from([0.0, math.inf, math.nan, -1.0]),
    ),
    max_size=40,
)


def smoothed(ranges: list[float] | np.ndarray, increment: float) -> np.ndarray:
    given_m = np.array(ranges, dtype=np.float32)
    out_m = np.empty_like(given_m)
    smooth_ranges_into(out_m, given_m, increment)
    return out_m


def plainly(ranges: list[float], beam: int, increment: float) -> float:
    """The mean of pairs of beams, as long as both lie near to the one between them."""
    here = ranges[beam]
    if not 0.0 < here < math.inf:
        return here
    kept = [here]
    for shift in range(1, MAX_SMOOTHED + 1):
        pair = [beam - shift, beam + shift]
        if pair[0] < 0 or pair[1] >= len(ranges) or shift > SURFACE_M / (here * increment):
            break
        if not all(abs(ranges[one] - here) < SAME_M for one in pair):
            break
        kept += [ranges[one] for one in pair]
    return sum(kept) / len(kept)


@given(RANGES, st.sampled_from([0.004, 0.0087, 0.0175]))
def test_ranges_are_means_along_one_surface(ranges: list[float], increment: float) -> None:
    exact = np.array(ranges, dtype=np.float32).astype(np.float64).tolist()
    wanted = [plainly(exact, beam, increment) for beam in range(len(exact))]
    np.testing.assert_allclose(smoothed(ranges, increment), wanted, rtol=1e-5)


@given(st.integers(0, 1000), st.floats(-0.9, 0.9), st.floats(0.25, 0.4))
def test_a_wall_seen_aslant_stays_and_its_noise_shrinks(
    seed: int, slant: float, distance_m: float
) -> None:
    increment = math.radians(0.5)
    angles = np.arange(-60, 61) * increment
    true = distance_m / np.cos(angles + slant)
    true = true[np.abs(angles + slant) < 1.0]
    noise = np.random.default_rng(seed).normal(0.0, 0.01, true.size)
    np.testing.assert_allclose(smoothed(true, increment), true, atol=2e-3)
    inner = slice(5, -5)
    left = smoothed(true + noise, increment)[inner] - true[inner]
    assert np.std(left) < 0.75 * np.std(noise[inner])
