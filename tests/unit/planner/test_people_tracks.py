"""The judge of tracks of people, on sights of which it is known what is right."""

import math

import numpy as np
import pytest
from bench.planner.people_tracks import Sights


def test_each_person_is_compared_with_the_disc_that_lies_on_them() -> None:
    at = np.array([[1.0, 0.0], [2.0, 0.1], [0.0, 2.0], [5.0, 0.0]])
    velocity = np.array([[0.0, 1.0], [0.0, -1.0], [1.0, 0.0], [0.0, 0.0]])
    before = np.array([[0.0, 1.0], [0.0, -1.0], [0.0, 1.0], [0.0, 0.0]])
    discs = np.array([[1.1, 0.0, 0.3, 1.0], [0.0, 2.2, 1.0, 0.0], [-2.0, 0.0, 1.0, 0.0]])
    sights = Sights()
    sights.add(discs, (at, velocity), before)
    # The second hides behind the first and has no disc; the fourth is too far away.
    assert sights.rows == [
        (False, False, pytest.approx(0.1), pytest.approx(0.3)),
        (False, True, math.inf, math.inf),
        (True, False, pytest.approx(0.2), pytest.approx(0.0)),
    ]
    assert (sights.discs, sights.nobodys) == (3, 1)


def test_nobody_is_seen_without_discs() -> None:
    sights = Sights()
    still = np.zeros((1, 2))
    sights.add(np.empty((0, 4)), (np.array([[1.0, 0.0]]), still), still)
    assert sights.rows == [(False, False, math.inf, math.inf)]
    assert sights.figures()[1:3] == ["0 %", "-"]
