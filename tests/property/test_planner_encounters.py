"""When people come upon each other, compared with letting them walk in small steps."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.cases import cases

from trolley_planner.people.encounters import ENCOUNTER, times_of_encounters

STEP_S, LONG_S = 0.01, 12.0


def first_meeting(one: np.ndarray, other: np.ndarray) -> float:
    """Walk two people on in small steps until they are near and approach each other."""
    apart = other - one
    is_one = math.hypot(apart[0], apart[1]) < ENCOUNTER.one_m
    if is_one or math.hypot(apart[2], apart[3]) < ENCOUNTER.together_mps:
        return math.inf
    for step in range(round(LONG_S / STEP_S)):
        x, y = apart[:2] + step * STEP_S * apart[2:]
        if x * apart[2] + y * apart[3] < 0.0 and math.hypot(x, y) <= ENCOUNTER.near_m:
            return step * STEP_S
    return math.inf


@settings(max_examples=cases(40), deadline=None)
@given(st.integers(0, 10_000), st.integers(0, 5))
def test_encounters_are_those_of_people_who_walk_on(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    walkers = np.column_stack(
        [rng.uniform(-3.0, 3.0, (count, 2)), rng.normal(0.0, 1.0, (count, 2))]
    )
    found = times_of_encounters(walkers)
    for index, one in enumerate(walkers):
        others = [first_meeting(one, other) for at, other in enumerate(walkers) if at != index]
        plain = min(others, default=math.inf)
        # A touch in passing may fall between two steps.
        if math.isinf(plain) and found[index] < LONG_S:
            nearer = walkers[:, :2] + (found[index] + STEP_S) * walkers[:, 2:]
            gaps = np.hypot(*(nearer - nearer[index]).T)
            assert np.sort(gaps)[1] == pytest.approx(ENCOUNTER.near_m, abs=0.01)
        elif found[index] < LONG_S:
            assert found[index] == pytest.approx(plain, abs=1.5 * STEP_S)
        else:
            assert math.isinf(plain)


def test_who_walk_together_do_not_come_upon_each_other() -> None:
    side_by_side = np.array([[0.0, 0.0, 1.0, 0.1], [0.0, 0.7, 1.0, -0.1]])
    assert np.isinf(times_of_encounters(side_by_side)).all()


def test_two_legs_are_one_person() -> None:
    legs = np.array([[0.0, 0.0, 1.6, 0.0], [0.2, 0.2, 0.2, 0.0]])
    assert np.isinf(times_of_encounters(legs)).all()


def test_who_walk_towards_each_other_do() -> None:
    towards = np.array([[0.0, 0.0, 1.0, 0.0], [5.0, 0.0, -1.0, 0.0]])
    assert times_of_encounters(towards).tolist() == [2.0, 2.0]


def test_in_a_crowd_everybody_comes_upon_somebody_and_two_legs_are_no_crowd() -> None:
    apart = np.array([[0.0, 0.0, 1.0, 0.0], [0.0, 5.0, 1.0, 0.0], [0.0, 9.0, 0.0, 1.0]])
    assert times_of_encounters(apart).tolist() == [ENCOUNTER.crowd_s] * 3
    legs = np.vstack([apart[:2], [[0.2, 0.2, 0.6, 0.0]]])
    assert np.isinf(times_of_encounters(legs)).all()
