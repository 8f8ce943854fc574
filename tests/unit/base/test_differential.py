import pytest
from hypothesis import given
from hypothesis import strategies as st

from trolley.geometry import Twist2D
from trolley_base.differential import sides_of, twist_of

speeds = st.floats(-2.0, 2.0)


def test_who_turns_left_has_the_faster_side_on_the_right() -> None:
    assert sides_of(Twist2D(0.5, 0.0, 1.0), 0.1) == pytest.approx((0.4, 0.6))


@given(vx=speeds, wz=speeds, half_track_m=st.floats(0.02, 0.5))
def test_a_motion_comes_back_from_its_sides(vx: float, wz: float, half_track_m: float) -> None:
    back = twist_of(*sides_of(Twist2D(vx, 0.0, wz), half_track_m), half_track_m)
    assert (back.vx, back.vy, back.wz) == pytest.approx((vx, 0.0, wz), abs=1e-9)
