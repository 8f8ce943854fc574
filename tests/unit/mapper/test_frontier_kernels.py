"""The compiled loops of exploring, against slow twins."""

import heapq
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray
from scipy import ndimage
from support.cases import cases

from trolley.gridmap import distance_transform
from trolley.gridmap.kernels import spread_over
from trolley_mapper.kernels.frontiers import (
    BLOCKED,
    DIAGONAL,
    FREE,
    NONE,
    STRAIGHT,
    UNKNOWN,
    UNREACHED,
    edge_into,
    fits_into,
    fitting_yaw,
    spread_into,
    unseen_from,
)

MASKS = arrays(
    np.uint8, st.tuples(st.integers(1, 9), st.integers(1, 9)), elements=st.integers(0, 1)
)


def naive_spread(mask: NDArray[np.uint8], seeds: list[int], limit: int) -> NDArray[np.int64]:
    rows, cols = mask.shape
    cost = np.full(mask.shape, UNREACHED, np.int64)
    queue = [(0, seed) for seed in seeds]
    for seed in seeds:
        cost[divmod(seed, cols)] = 0
    while queue:
        known, cell = heapq.heappop(queue)
        row, col = divmod(cell, cols)
        if known > cost[row, col]:
            continue
        for down in (-1, 0, 1):
            for right in (-1, 0, 1):
                r, c = row + down, col + right
                step = known + (STRAIGHT if down * right == 0 else DIAGONAL)
                if not (0 <= r < rows and 0 <= c < cols) or (down, right) == (0, 0):
                    continue
                if mask[r, c] and step < cost[r, c] and step <= limit:
                    cost[r, c] = step
                    heapq.heappush(queue, (step, r * cols + c))
    return cost


@settings(max_examples=cases(40), deadline=None)
@given(MASKS, st.lists(st.integers(0, 80), max_size=3), st.integers(0, 60))
def test_ways_are_the_shortest(mask: NDArray[np.uint8], wanted: list[int], limit: int) -> None:
    seeds = [seed % mask.size for seed in wanted]
    cost, nearest = np.empty(mask.shape, np.int32), np.empty(mask.shape, np.int32)
    spread_into(cost, nearest, mask, np.array(seeds, np.int32), limit)
    assert np.array_equal(cost, naive_spread(mask, seeds, limit))
    assert np.array_equal(nearest == NONE, cost == UNREACHED)
    for cell in np.flatnonzero(nearest != NONE):
        alone = naive_spread(mask, [int(nearest.ravel()[cell])], limit)
        assert alone.ravel()[cell] == cost.ravel()[cell]


@settings(max_examples=cases(50), deadline=None)
@given(MASKS)
def test_groups_are_those_that_touch(mask: NDArray[np.uint8]) -> None:
    label = np.empty(mask.shape, np.int32)
    count = spread_over(label, mask, mask, 1)
    expected, expected_count = ndimage.label(mask, np.ones((3, 3)))
    assert count == expected_count
    assert np.array_equal(label, expected)  # both count in the order of the cells


@settings(max_examples=cases(50), deadline=None)
@given(MASKS, st.integers(0, 2**32 - 1))
def test_the_edge_is_free_and_beside_the_other(mask: NDArray[np.uint8], seed: int) -> None:
    beside = np.random.default_rng(seed).integers(0, 2, mask.shape).astype(np.uint8)
    edge = np.empty_like(mask)
    edge_into(edge, mask, beside)
    cross = np.array([[0, 1, 0], [1, 0, 1], [0, 1, 0]], np.bool_)
    assert np.array_equal(edge != 0, (mask != 0) & ndimage.binary_dilation(beside, cross))


def test_an_unknown_room_is_seen_through_its_door() -> None:
    kinds = np.full((100, 100), BLOCKED, np.uint8)
    kinds[20:80, 5:45] = FREE
    kinds[20:80, 46:90] = UNKNOWN
    area, _, _ = unseen_from(kinds, 30.0, 50.0, 60.0, 90, False)
    assert area == 0.0  # behind the wall
    kinds[45:56, 45] = FREE
    area, along_x, along_y = unseen_from(kinds, 40.0, 50.5, 40.0, 360, False)
    # The wedge through a door of 11 cells, 6 cells away, 40 cells deep.
    wedge = math.atan2(5.5, 5.5)
    assert area == pytest.approx(wedge * (40.0**2 - 6.0**2), rel=0.1)
    assert abs(math.atan2(along_y, along_x)) < 0.02


@pytest.mark.parametrize("beyond", [False, True])
def test_what_lies_off_the_grid_is_unknown_where_it_counts(beyond: bool) -> None:
    kinds = np.full((20, 20), FREE, np.uint8)
    kinds[:, 18:] = UNKNOWN
    area, along_x, _ = unseen_from(kinds, 10.0, 10.0, 30.0, 360, beyond)
    outside = math.pi * 30.0**2 - 20.0 * 20.0
    assert area == pytest.approx(outside + 40.0 if beyond else 40.0, rel=0.1)
    assert along_x > 0.0


def test_a_long_robot_fits_along_a_corridor_and_is_turned_no_farther_than_it_takes() -> None:
    free = np.zeros((21, 21), np.uint8)
    free[8:13] = 1  # 5 cells wide, along x
    room = distance_transform(1 - free, 1.0)
    outline = np.array([(x, y) for x in np.linspace(-4.0, 4.0, 17) for y in (-2.0, 2.0)])
    middle, beside = 10 * 21 + 10, 8 * 21 + 10
    places = np.array([middle, beside], np.int32)
    fits = np.empty(2, np.bool_)
    fits_into(fits, room, places, outline, 32)
    assert fits.tolist() == [True, False]
    assert fitting_yaw(room, middle, 0.6, outline, 32) == pytest.approx(0.0)
    assert fitting_yaw(room, middle, 2.5, outline, 32) == pytest.approx(math.pi)
    assert math.isnan(fitting_yaw(room, beside, 0.6, outline, 32))
