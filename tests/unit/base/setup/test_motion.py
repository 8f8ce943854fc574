"""How far the robot has turned."""

import math

from hypothesis import given
from hypothesis import strategies as st

from trolley.geometry import wrap_angle
from trolley_base.setup.motion import Turn

steps = st.lists(st.floats(-3.0, 3.0), max_size=20)


@given(first=st.floats(-math.pi, math.pi), steps=steps)
def test_a_turn_adds_up_however_far_it_leads(first: float, steps: list[float]) -> None:
    turn, direction = Turn(first), first
    for step in steps:
        direction = wrap_angle(direction + step)
        turn.update(direction)
    assert math.isclose(turn.angle, math.fsum(steps), abs_tol=1e-9)


def test_half_a_turn_is_not_over_where_left_becomes_right() -> None:
    error = -3.12
    turn = Turn(error)
    left = [error + turn.update(now) for now in (3.13, -3.0, -1.5)]
    assert left == sorted(left)
    assert left[0] < -3.1
