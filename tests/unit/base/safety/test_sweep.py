import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.typing import NDArray

from trolley.geometry import (
    Twist2D,
    distance_to_outline,
    exp_twist,
    footprint_from_box,
    polygon_contains,
)
from trolley_base.safety.sweep import contact_times

BOX = footprint_from_box(0.4, 0.2)
ARROW = np.array([[0.3, 0.0], [-0.2, 0.2], [-0.1, 0.0], [-0.2, -0.2]])
twists = st.builds(Twist2D, st.floats(-0.5, 0.5), st.just(0.0), st.floats(-1.5, 1.5))
points = st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))


def first_contact(
    point: tuple[float, float], outline: NDArray[np.float64], twist: Twist2D, until_s: float
) -> float:
    """The slow obvious twin: drive in small steps until the point is inside."""
    for t in np.arange(0.0, until_s, 0.01):
        seen = exp_twist(twist, float(t)).inverse().transform_points(np.array([point]))
        if polygon_contains(outline, seen)[0]:
            return float(t)
    return math.inf


def time_of(point: tuple[float, float], twist: Twist2D) -> float:
    return float(contact_times(np.array([point]), BOX, twist)[0])


def test_straight_ahead_the_front_meets_a_point_after_the_way_between() -> None:
    assert time_of((0.7, 0.05), Twist2D(0.25, 0.0, 0.0)) == pytest.approx(2.0)
    assert time_of((-0.7, 0.05), Twist2D(-0.25, 0.0, 0.0)) == pytest.approx(2.0)


def test_what_lies_behind_or_beside_is_never_met() -> None:
    assert time_of((-0.7, 0.0), Twist2D(0.25, 0.0, 0.0)) == math.inf
    assert time_of((0.7, 0.11), Twist2D(0.25, 0.0, 0.0)) == math.inf
    assert time_of((0.7, 0.0), Twist2D(0.0, 0.0, 0.0)) == math.inf


def test_a_turn_in_place_meets_what_the_corners_sweep() -> None:
    turn = Twist2D(0.0, 0.0, 1.0)
    corner = math.hypot(0.2, 0.1)
    assert time_of((corner + 0.001, 0.0), turn) == math.inf
    # The front right corner comes up to the axis after the angle that it is off.
    assert time_of((corner - 1e-9, 0.0), turn) == pytest.approx(math.atan2(0.1, 0.2), abs=1e-3)
    assert time_of((0.0, 0.15), turn) == pytest.approx(math.asin(0.2 / corner) - 0.4636, abs=1.0)


@pytest.mark.parametrize("outline", [BOX, ARROW], ids=["box", "arrow"])
@given(point=points, twist=twists)
def test_contacts_are_those_of_a_drive_in_small_steps(
    outline: NDArray[np.float64], point: tuple[float, float], twist: Twist2D
) -> None:
    at = np.array([point])
    assume(not polygon_contains(outline, at)[0])
    assume(distance_to_outline(outline, at)[0] > 0.01)
    exact = float(contact_times(at, outline, twist)[0])
    stepped = first_contact(point, outline, twist, 3.0)
    if math.isfinite(stepped):
        assert exact <= stepped + 1e-6
    if exact < 2.99:
        # A point that only grazes an edge is inside for less than a step.
        ahead = exp_twist(twist, exact).inverse().transform_points(at)
        # Arcs that are nearly straight are taken for straight ones.
        assert distance_to_outline(outline, ahead)[0] < 2e-5
        assert stepped >= exact - 1e-6


def test_almost_straight_arcs_are_continuous_with_straight_lines() -> None:
    point = (0.9, 0.05)
    straight = time_of(point, Twist2D(0.3, 0.0, 0.0))
    for wz in (1e-9, 2.9e-4, 3.1e-4, 1e-3):
        assert time_of(point, Twist2D(0.3, 0.0, wz)) == pytest.approx(straight, rel=1e-3)
