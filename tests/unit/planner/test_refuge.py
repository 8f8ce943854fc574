"""When the robot can be where, before somebody is there."""

import math

import numpy as np

from trolley_planner.fleet.refuge import REFUGE, arrive

CELL_S = 0.1
ANYWHERE = (math.nan, math.nan)


def arrivals(
    closes_s: np.ndarray, yaw: float = 0.0, back_to: tuple[float, float] = ANYWHERE
) -> np.ndarray:
    """From the middle of a corridor one cell wide along a row, where the robot fits."""
    found = np.full(closes_s.shape, np.inf)
    is_free = np.zeros(closes_s.shape, np.bool_)
    is_free[1] = True
    arrive(found, is_free, closes_s, (1, closes_s.shape[1] // 2), (yaw, CELL_S), back_to)
    return found[1]


def test_it_turns_before_it_drives_the_other_way() -> None:
    found = arrivals(np.full((3, 21), np.inf))
    np.testing.assert_allclose(found[20], 10 * CELL_S)
    np.testing.assert_allclose(found[0], 10 * CELL_S + math.pi / REFUGE.turn_radps)


def test_it_is_nowhere_that_somebody_is_by_then() -> None:
    closes_s = np.full((3, 21), np.inf)
    closes_s[:, 15] = 5 * CELL_S + REFUGE.early_s
    found = arrivals(closes_s)
    assert math.isfinite(found[14])
    assert np.isinf(found[15:]).all()


def test_it_looks_no_farther_than_where_a_better_refuge_may_be() -> None:
    closes_s = np.full((3, 201), 50.0)
    closes_s[:, 105:] = np.inf
    found = arrivals(closes_s, back_to=(1.0, 100.0))
    # Five cells there and five back: what is eleven away cannot be better.
    assert math.isfinite(found[110])
    assert np.isinf(found[112:]).all()
