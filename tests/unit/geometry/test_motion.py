import math

import pytest

from trolley.geometry import (
    Pose2D,
    Twist2D,
    exp_twist,
    integrate_twist,
    interpolate,
    interpolate_straight,
    log_pose,
)


def test_a_quarter_of_a_circle_ends_on_the_circle() -> None:
    # 1 m/s at pi/2 rad/s: radius 2/pi, after 1 s a quarter turn to the left.
    radius = 2.0 / math.pi
    end = integrate_twist(Pose2D(0.0, 0.0, 0.0), Twist2D(1.0, 0.0, math.pi / 2), 1.0)
    assert end.as_array() == pytest.approx([radius, radius, math.pi / 2], abs=1e-12)


def test_a_full_circle_comes_back() -> None:
    start = Pose2D(3.0, -1.0, 0.7)
    end = integrate_twist(start, Twist2D(0.5, 0.1, 2 * math.pi / 10), 10.0)
    assert end.as_array() == pytest.approx(start.as_array(), abs=1e-12)


@pytest.mark.parametrize("turn_rate", [0.0, 5e-324, 1e-300, 1e-12, 1e-8, -1e-9])
def test_nearly_straight_is_straight(turn_rate: float) -> None:
    end = exp_twist(Twist2D(0.4, -0.2, turn_rate), 2.0)
    assert end.as_array() == pytest.approx([0.8, -0.4, 2 * turn_rate], abs=1e-7)


def test_small_turns_agree_with_the_series() -> None:
    turn = 1e-5
    end = exp_twist(Twist2D(1.0, 0.0, turn))
    assert end.y == pytest.approx(turn / 2 - turn**3 / 24, rel=1e-12)
    assert 1.0 - end.x == pytest.approx(turn**2 / 6, rel=1e-4)


def test_driving_back_undoes_driving() -> None:
    twist = Twist2D(0.3, 0.05, -1.1)
    end = integrate_twist(integrate_twist(Pose2D(1.0, 2.0, 3.0), twist, 0.8), twist, -0.8)
    assert end.as_array() == pytest.approx([1.0, 2.0, 3.0], abs=1e-12)


def test_half_a_turn_has_a_velocity() -> None:
    assert exp_twist(log_pose(Pose2D(1.0, 0.5, math.pi))).as_array() == pytest.approx(
        [1.0, 0.5, math.pi], abs=1e-12
    )


def test_halfway_lies_on_the_arc() -> None:
    # From heading east to heading north on a circle of radius 1 about (0, 1).
    half = interpolate(Pose2D(0.0, 0.0, 0.0), Pose2D(1.0, 1.0, math.pi / 2), 0.5)
    expected = [math.sqrt(0.5), 1.0 - math.sqrt(0.5), math.pi / 4]
    assert half.as_array() == pytest.approx(expected, abs=1e-12)


def test_interpolation_goes_on_beyond_the_end() -> None:
    beyond = interpolate(Pose2D(0.0, 0.0, 0.0), Pose2D(0.1, 0.0, 0.0), 1.5)
    assert beyond.as_array() == pytest.approx([0.15, 0.0, 0.0])


def test_straight_interpolation_turns_the_shorter_way() -> None:
    half = interpolate_straight(Pose2D(0.0, 0.0, 3.0), Pose2D(2.0, 4.0, -3.0), 0.5)
    assert half.as_array() == pytest.approx([1.0, 2.0, math.pi], abs=1e-12)
