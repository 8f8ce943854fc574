import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trolley.geometry import Twist2D, distance_to_outline, exp_twist
from trolley_base.safety.touching import closest_on_outline, point_velocities

ARROW = np.array([[0.3, 0.0], [-0.2, 0.2], [-0.1, 0.0], [-0.2, -0.2]])
twists = st.builds(Twist2D, st.floats(-0.5, 0.5), st.just(0.0), st.floats(-1.5, 1.5))
points = st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))


@given(point=points)
def test_the_closest_point_is_as_far_as_the_outline(point: tuple[float, float]) -> None:
    at = np.array([point])
    gap = at - closest_on_outline(at, ARROW)
    assert np.hypot(*gap[0]) == pytest.approx(float(distance_to_outline(ARROW, at)[0]), abs=1e-9)


@given(point=points, twist=twists)
def test_point_velocities_are_the_slopes_of_their_ways(
    point: tuple[float, float], twist: Twist2D
) -> None:
    at, dt = np.array([point]), 1e-6
    after = exp_twist(twist, dt).inverse().transform_points(at)
    assert (after - at) / dt == pytest.approx(point_velocities(at, twist), abs=1e-4)
