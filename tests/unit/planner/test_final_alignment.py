"""The last decimetres onto the goal."""

import math

import numpy as np
import pytest

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, Twist2D, integrate_twist, wrap_angle
from trolley_planner.control.controller import Motion, limited_change, limits_of
from trolley_planner.driving.goal_approach import FinalAlignment
from trolley_planner.goals import Tolerances

CONFIG = PlannerConfig()
LIMITS = limits_of(CONFIG, 0.5, 1.5, 1.0)


@pytest.mark.parametrize("noise_m", [0.0, 0.01])
@pytest.mark.parametrize("yaw", [0.0, 2.0, -3.0])
@pytest.mark.parametrize(
    "start", [Pose2D(-0.3, 0.05, 0.2), Pose2D(0.2, 0.0, 0.1), Pose2D(0, 0.1, 3)]
)
def test_the_approach_ends_on_the_goal_and_stays(start, yaw, noise_m) -> None:
    rng = np.random.default_rng(1)
    goal = Pose2D(0.0, 0.0, yaw)
    approach = FinalAlignment(Tolerances(0.05, 0.05))
    pose, twist = start, Twist2D.zero()
    for _ in range(400):
        noise = rng.normal(0.0, noise_m, 2)
        felt = Pose2D(pose.x + noise[0], pose.y + noise[1], pose.yaw)
        wanted = approach.command(Motion(felt, twist), goal, LIMITS, 0.05)
        if wanted is None:
            break
        twist = limited_change(twist, wanted, LIMITS, 0.05)
        pose = integrate_twist(pose, twist, 0.05)
    else:
        pytest.fail("it never arrived")
    assert twist.speed < 0.02
    assert abs(twist.wz) < 0.05
    assert math.hypot(pose.x, pose.y) <= 0.05 + 3.0 * noise_m
    assert abs(wrap_angle(pose.yaw - yaw)) <= 0.05


def test_a_robot_that_stops_at_once_does_not_stop_at_the_edge_of_the_tolerance() -> None:
    approach = FinalAlignment(Tolerances(0.05, 0.05))
    pose, twist = Pose2D(-0.3, 0.0, 0.0), Twist2D.zero()
    while (
        wanted := approach.command(Motion(pose, twist), Pose2D.identity(), LIMITS, 0.05)
    ) is not None:
        twist = limited_change(twist, wanted, LIMITS, 0.05)
        pose = integrate_twist(pose, twist, 0.05)
    assert abs(pose.x) < 0.01


@pytest.mark.parametrize("turn", [0.4, 1.5, 3.0])
def test_a_turn_takes_little_longer_than_the_robot_needs_for_it(turn) -> None:
    approach, pose = FinalAlignment(Tolerances(0.05, 0.05)), Pose2D(0.0, 0.0, turn)
    twist, seconds = Twist2D.zero(), 0.0
    while (
        wanted := approach.command(Motion(pose, twist), Pose2D.identity(), LIMITS, 0.05)
    ) is not None:
        twist = limited_change(twist, wanted, LIMITS, 0.05)
        pose, seconds = integrate_twist(pose, twist, 0.05), seconds + 0.05
    rate, change = LIMITS.max_turn, LIMITS.turn_acceleration
    least = turn / rate + rate / change if turn > rate**2 / change else 2 * math.sqrt(turn / change)
    assert abs(pose.yaw) < 0.05
    assert seconds < least + 0.4
