"""Scales between reported and true motion undo each other, and those of 1 do nothing."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from trolley.geometry import Pose2D, Twist2D, exp_twist
from trolley_base.odometry.wheel_scales import WheelScales

scale = st.floats(0.5, 2.0)
scales = st.builds(
    WheelScales,
    linear=scale,
    sideways=scale,
    angular=scale,
    wheel_ratio=st.floats(0.8, 1.25),
    track_m=st.floats(0.05, 1.0),
)
speed = st.floats(-1.0, 1.0)
twists = st.builds(Twist2D, speed, speed, st.floats(-3.0, 3.0))
poses = st.builds(Pose2D, speed, speed, st.floats(-math.pi, math.pi))


@given(scales, twists)
def test_a_command_scaled_for_the_board_is_driven_as_it_was_meant(
    scales: WheelScales, twist: Twist2D
) -> None:
    driven = scales.true_twist(scales.reported_twist(twist))
    assert (driven.vx, driven.vy, driven.wz) == pytest.approx(
        (twist.vx, twist.vy, twist.wz), abs=1e-9
    )


@given(poses, twists)
def test_scales_of_one_change_no_bit(pose: Pose2D, twist: Twist2D) -> None:
    identity = WheelScales(track_m=0.2)
    assert identity.true_motion(pose) is pose
    assert identity.true_twist(twist) is twist
    assert identity.reported_twist(twist) is twist


@given(scales, twists)
def test_an_arc_is_corrected_to_an_arc(scales: WheelScales, twist: Twist2D) -> None:
    reported = exp_twist(twist, 0.3)
    true = exp_twist(scales.true_twist(twist), 0.3)
    motion = scales.true_motion(reported)
    assert motion.as_array() == pytest.approx(true.as_array(), abs=1e-9)


@given(st.floats(0.8, 1.25), st.floats(0.05, 1.0), speed, speed)
def test_the_wheel_ratio_is_that_of_the_wheels(
    ratio: float, track_m: float, left: float, right: float
) -> None:
    scales = WheelScales(wheel_ratio=ratio, track_m=track_m)
    reported = Twist2D(0.5 * (left + right), 0.0, (right - left) / track_m)
    true = scales.true_twist(reported)
    true_left = true.vx - 0.5 * track_m * true.wz
    true_right = true.vx + 0.5 * track_m * true.wz
    assert true_left == pytest.approx(left * 2.0 / (1.0 + ratio), abs=1e-12)
    assert true_right == pytest.approx(right * 2.0 * ratio / (1.0 + ratio), abs=1e-12)


def test_a_ratio_without_a_track_means_nothing() -> None:
    with pytest.raises(ValueError, match="track"):
        WheelScales(wheel_ratio=1.01)
