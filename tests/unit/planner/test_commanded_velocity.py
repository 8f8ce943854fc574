"""From which velocity the next command starts."""

import pytest

from trolley.geometry import Pose2D, Twist2D
from trolley_planner.context.commanded_velocity import VELOCITY, CommandedVelocity

PERIOD_NS = 50_000_000


def told(*speeds: float) -> CommandedVelocity:
    """A robot that was told these speeds, one each period."""
    commanded = CommandedVelocity()
    for number, speed in enumerate(speeds):
        commanded.record(Twist2D(speed, 0.0, 2.0 * speed), number * PERIOD_NS)
    return commanded


@pytest.mark.parametrize("late", [0, 2, 4, 6])
def test_wheels_that_follow_late_are_no_reason_to_speed_up_again(late: int) -> None:
    braking = [0.5] * 8 + [0.5 - 0.05 * number for number in range(11)]
    for now in range(8, len(braking)):
        commanded = told(*braking[: now + 1])
        wheels = braking[now - late]
        assert commanded.velocity(Twist2D(wheels, 0.0, 2.0 * wheels)) == Twist2D(
            braking[now], 0.0, 2.0 * braking[now]
        )


def test_wheels_that_do_not_follow_are_what_it_starts_from() -> None:
    held = Twist2D(0.0, 0.0, 0.0)
    assert told(*[0.4] * 20).velocity(held) == held
    pushed = Twist2D(0.3, 0.0, 0.0)
    assert told(*[0.0] * 20).velocity(pushed) == pushed


def test_without_commands_it_starts_from_the_wheels_or_from_rest() -> None:
    commanded = told(0.4, 0.4)
    commanded.record(None, 3 * PERIOD_NS)
    assert commanded.velocity(Twist2D(0.05, 0.0, 0.0)) == Twist2D.zero()
    assert commanded.velocity(Twist2D(0.4, 0.0, 0.0)).vx == 0.4


def test_what_was_told_long_ago_does_not_count() -> None:
    commanded = told(0.5)
    commanded.record(Twist2D.zero(), round(VELOCITY.lag_s * 1e9) + 1)
    assert commanded.velocity(Twist2D(0.4, 0.0, 0.0)).vx == 0.4


def test_a_clock_that_jumps_back_forgets() -> None:
    commanded = told(*[0.5] * 30)
    commanded.record(Twist2D.zero(), 0)
    assert commanded.velocity(Twist2D(0.4, 0.0, 0.0)).vx == 0.4


def test_a_robot_that_obeys_late_still_drives_what_it_was_told() -> None:
    speeds = [0.1, 0.2, 0.3, 0.4, 0.5]
    commanded, now_ns = told(*speeds), 4 * PERIOD_NS
    wheels = Twist2D(0.3, 0.0, 0.6)
    for delay_s, way in (
        (0.0, 0.0),
        (0.05, 0.4),
        (0.125, 0.4 + 0.3 + 0.1),
        (0.2, 1.0),
        (0.45, 1.0),
    ):
        pose = commanded.pose_when_obeyed(Pose2D.identity(), wheels, now_ns, delay_s)
        assert pose.yaw == pytest.approx(2.0 * way * 0.05)
        assert pose.x == pytest.approx(way * 0.05, abs=1e-3)


def test_a_robot_that_does_not_obey_drives_on_as_its_wheels_do() -> None:
    commanded = told(*[0.1] * 9)
    wheels = Twist2D(0.5, 0.0, 0.2)
    pose = commanded.pose_when_obeyed(Pose2D.identity(), wheels, 8 * PERIOD_NS, 0.2)
    assert pose.x == pytest.approx(0.1, abs=1e-3)
    assert pose.yaw == pytest.approx(0.04)
