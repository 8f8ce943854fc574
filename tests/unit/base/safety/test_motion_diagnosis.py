from trolley.geometry import Twist2D
from trolley_base.safety.motion_diagnosis import drives_otherwise

HALF_TRACK_M = 0.12


def detail(told: Twist2D, wheels: Twist2D, gyro: float) -> str:
    return drives_otherwise(told, wheels, gyro, HALF_TRACK_M).detail


def test_a_gyro_that_shows_no_turn_does_not_say_that_a_wheel_turns() -> None:
    """A robot that drives straight on does not turn, nor does one that is held."""
    held = detail(Twist2D(0.25, 0.0, 0.0), Twist2D(0.1, 0.0, 0.85), gyro=0.0)
    assert held.startswith("its left encoder counts nothing, or that wheel is held")
    turning = detail(Twist2D(0.25, 0.0, 0.5), Twist2D(0.1, 0.0, 1.2), gyro=0.5)
    assert turning.startswith("its left encoder counts nothing, though the wheel turns")


def test_a_robot_that_bounces_off_something_low_is_not_said_to_turn_as_told() -> None:
    told = Twist2D(0.5, 0.0, -0.3)
    assert detail(told, Twist2D(0.03, 0.0, 0.2), gyro=-0.1).startswith("its wheels do not turn")
    assert detail(told, Twist2D(0.0, 0.0, 0.0), gyro=-0.3).startswith("it turns, but its encoders")
