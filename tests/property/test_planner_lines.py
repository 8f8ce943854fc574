"""Straight lines over weights against a slow reference, and what they make of paths."""

import itertools
import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from trolley_planner.paths.path import (
    polyline_cost,
    segment_cost,
    shortcut_into,
    smooth,
    subdivide,
)

SIZE = 12
coordinate = st.floats(1.0, SIZE - 1.001)


def grid(seed: int, share: float) -> np.ndarray:
    rng = np.random.default_rng(seed)
    weights = rng.integers(4, 256, (SIZE, SIZE)).astype(np.uint8)
    weights[rng.random((SIZE, SIZE)) < share] = 0
    return weights


def slow_cost(weights: np.ndarray, a: tuple[float, float], b: tuple[float, float]) -> float:
    """Cut at every border of a column or row; each piece lies in the cell of its middle."""
    cuts = {0.0, 1.0}
    for start, end in zip(a, b, strict=True):
        if start != end:
            low, high = sorted((start, end))
            borders = range(math.floor(low), math.ceil(high) + 1)
            cuts |= {min(max((k - start) / (end - start), 0.0), 1.0) for k in borders}
    ordered, total = sorted(cuts), 0.0
    for one, other in itertools.pairwise(ordered):
        if other - one < 1e-7:
            continue
        middle = 0.5 * (one + other)
        col, row = (math.floor(s + middle * (e - s)) for s, e in zip(a, b, strict=True))
        if weights[row, col] == 0:
            return math.inf
        total += (other - one) * math.dist(a, b) * float(weights[row, col])
    return total


@given(st.integers(0, 1000), coordinate, coordinate, coordinate, coordinate)
def test_a_line_costs_what_its_pieces_do(seed, x1, y1, x2, y2) -> None:
    weights = grid(seed, 0.0)
    found = segment_cost(weights, x1, y1, x2, y2, math.inf)
    assert math.isclose(found, slow_cost(weights, (x1, y1), (x2, y2)), rel_tol=1e-4, abs_tol=1e-3)
    assert math.isinf(segment_cost(weights, x1, y1, x2, y2, 0.99 * found - 1e-6))


@given(st.integers(0, 1000), coordinate, coordinate, coordinate, coordinate)
def test_a_line_that_meets_a_lethal_cell_is_closed(seed, x1, y1, x2, y2) -> None:
    weights = grid(seed, 0.2)
    found = segment_cost(weights, x1, y1, x2, y2, math.inf)
    if math.isinf(slow_cost(weights, (x1, y1), (x2, y2))):
        assert math.isinf(found)


@given(st.integers(0, 1000), st.integers(1, 10), st.integers(1, 10))
def test_a_line_may_end_in_the_corner_of_a_lethal_cell(seed, col, row) -> None:
    weights = grid(seed, 0.3)
    weights[row, col] = 4
    for x, y in np.random.default_rng(seed).uniform(1.0, SIZE - 1.0, (50, 2)):
        expected = slow_cost(weights, (x, y), (float(col), float(row)))
        # From this quarter it would pass through the corner, and not end beside it.
        is_across = x < col and y < row
        if math.isfinite(expected) and not is_across:
            found = segment_cost(weights, x, y, float(col), float(row), math.inf)
            assert math.isclose(found, expected, rel_tol=1e-4, abs_tol=1e-3)


@given(st.integers(0, 1000), st.integers(1, 9), st.integers(1, 9))
def test_a_line_between_two_cells_that_touch_in_a_corner_is_closed(seed, row, col) -> None:
    weights = grid(seed, 0.0)
    weights[row, col + 1] = 0
    x, y = col + 0.5, row + 0.5
    assert math.isinf(segment_cost(weights, x, y, x + 1.0, y + 1.0, math.inf))
    assert math.isinf(segment_cost(weights, x + 1.0, y + 1.0, x, y, math.inf))


@given(st.integers(0, 1000), st.integers(1, 10), st.floats(-2e-7, 2e-7), st.booleans())
def test_a_line_along_a_border_must_be_free_on_both_sides(seed, at, off, is_row) -> None:
    weights = grid(seed, 0.1)
    if is_row:
        weights = weights.T.copy()
    cost = segment_cost(weights, at + off, 2.5, at + off, 8.5, math.inf)
    if is_row:
        cost = segment_cost(weights.T.copy(), 2.5, at + off, 8.5, at + off, math.inf)
    assert math.isinf(cost) == (weights[2:9, at - 1 : at + 1] == 0).any()


@given(st.integers(0, 1000), st.integers(2, 12))
def test_shortcuts_and_smoothing_make_no_path_dearer(seed, count) -> None:
    weights = grid(seed, 0.15)
    points = np.random.default_rng(seed).uniform(1.0, SIZE - 1.1, (count, 2))
    before = polyline_cost(weights, points, math.inf)
    if math.isinf(before):
        return
    kept = np.empty(count, dtype=np.int32)
    path = points[kept[: shortcut_into(kept, weights, points, 50)]]
    assert polyline_cost(weights, path, math.inf) <= before + 1e-6
    path = subdivide(path, 0.7)
    smooth(path, weights, 10)
    assert polyline_cost(weights, path, math.inf) <= before * (1.0 + 1e-6) + 1e-6
    np.testing.assert_array_equal(path[[0, -1]], points[[0, -1]])


def test_smoothing_leads_no_path_through_the_corner_of_a_lethal_cell() -> None:
    weights = np.full((SIZE, SIZE), 4, np.uint8)
    weights[5, 5] = 0
    # Pulled straight, the point in the middle would come to lie in the corner at (6, 6).
    path = np.array([[3.5, 6.5], [7.0, 7.0], [6.5, 3.5]])
    smooth(path, weights, 6)
    assert math.isfinite(polyline_cost(weights, path - 1e-9, math.inf))


@given(st.lists(st.tuples(coordinate, coordinate), min_size=2, max_size=6), st.floats(0.05, 3.0))
def test_a_divided_line_keeps_its_corners(corners, spacing) -> None:
    points = np.array(corners)
    divided = subdivide(points, spacing)
    steps = np.hypot(*np.diff(divided, axis=0).T)
    assert steps.max() <= spacing * (1.0 + 1e-9)
    length = np.hypot(*np.diff(points, axis=0).T).sum()
    assert math.isclose(steps.sum(), length, rel_tol=1e-9, abs_tol=1e-9)
    for corner in points:
        assert np.abs(divided - corner).sum(axis=1).min() == 0.0
