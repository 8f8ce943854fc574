"""Maneuvers of any kind are followed to their ends."""

import math

import numpy as np
import pytest
from support.maneuvers import DT_S, SHORT_M, any_maneuver, led_by, near

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, Twist2D, integrate_twist, wrap_angle
from trolley_planner.control.controller import Motion, limited_change, limits_of
from trolley_planner.driving.maneuver_follower import ManeuverFollower
from trolley_planner.paths.hybrid_astar.motion_primitives import (
    BACKWARDS,
    FORWARDS,
    TURNING,
    Maneuver,
)

LIMITS = limits_of(PlannerConfig(), speed=0.5, turn=1.5, deceleration=1.0)
SEEDS = range(60)


@pytest.mark.parametrize("delay", [0, 2])
@pytest.mark.parametrize("reach_m", [SHORT_M, 0.7])
def test_commands_are_within_limits_and_lead_to_the_end(delay: int, reach_m: float) -> None:
    for seed in SEEDS:
        rng = np.random.default_rng(seed)
        maneuver = any_maneuver(rng, int(rng.integers(1, 6)))
        follower = ManeuverFollower(maneuver, reach_m=reach_m)
        start = near(maneuver.poses[0], rng, 0.03, 0.15)
        led = led_by(follower, start, LIMITS, delay=delay, num_steps=2000)
        assert len(led) < 2000, seed
        for pose, wanted in led:
            assert np.isfinite((wanted.vx, wanted.vy, wanted.wz)).all(), seed
            assert -LIMITS.max_reverse <= wanted.vx <= LIMITS.max_speed, seed
            assert abs(wanted.wz) <= LIMITS.max_turn + 1e-9, seed
            away_m = np.hypot(*(maneuver.poses[:, :2] - (pose.x, pose.y)).T)
            assert away_m.min() < 0.055, seed
        assert led[-1][0].distance_to(follower.end) < 0.055, seed
        assert abs(wrap_angle(led[-1][0].yaw - follower.end.yaw)) < 0.02, seed


def test_each_part_is_driven_in_its_sense_and_only_once() -> None:
    for seed in SEEDS:
        rng = np.random.default_rng(seed)
        maneuver = any_maneuver(rng, int(rng.integers(2, 6)))
        follower = ManeuverFollower(maneuver, reach_m=SHORT_M)
        pose, twist, senses = near(maneuver.poses[0], rng, 0.03, 0.15), Twist2D.zero(), []
        for _ in range(2000):
            wanted = follower.command(Motion(pose, twist), LIMITS)
            if wanted is None:
                break
            if wanted.vx != 0.0:
                senses.append(int(math.copysign(1.0, wanted.vx)))
                assert senses[-1] == follower.sense, seed
            twist = limited_change(twist, wanted, LIMITS, DT_S)
            pose = integrate_twist(pose, twist, DT_S)
        runs = maneuver.motions[np.append(0, np.flatnonzero(np.diff(maneuver.motions)) + 1)]
        num_changes = np.count_nonzero(np.diff(runs[runs != TURNING]))
        assert np.count_nonzero(np.diff(senses)) <= num_changes, seed


def test_a_maneuver_of_one_pose_turns_to_it_and_ends() -> None:
    maneuver = Maneuver(np.array([[1.0, 2.0, 9.0]]), np.array([TURNING], dtype=np.int8))
    follower = ManeuverFollower(maneuver, reach_m=SHORT_M)
    here = Pose2D(1.0, 2.0, 9.0 - 2.0 * math.pi - 0.3)
    assert follower.left_m == 0.0
    assert len(follower.poses_from(here, 1.0)) == len(follower.run_ahead(1.0)) == 1
    assert not follower.has_strayed(here)
    led = led_by(follower, here, LIMITS)
    assert {wanted.vx for _, wanted in led} == {0.0}
    assert abs(wrap_angle(led[-1][0].yaw - 9.0)) < 0.02


@pytest.mark.parametrize("sense", [FORWARDS, BACKWARDS])
@pytest.mark.parametrize("bend", [-2.5, 2.5])
def test_a_robot_on_its_arc_steers_by_that_arc_between_its_poses_as_well(
    sense: int, bend: float
) -> None:
    step_m = 0.0375

    def at(steps: float) -> Pose2D:
        return integrate_twist(Pose2D(1.0, 2.0, 0.4), Twist2D(sense, 0.0, bend), step_m * steps)

    poses = np.array([(pose.x, pose.y, pose.yaw) for pose in map(at, range(20))])
    maneuver = Maneuver(poses, np.full(20, sense, dtype=np.int8))
    follower = ManeuverFollower(maneuver, reach_m=SHORT_M)
    for steps in np.arange(0.0, 14.0, 0.1).tolist():
        wanted = follower.command(Motion(at(steps), Twist2D(0.2 * sense, 0.0, 0.0)), LIMITS)
        assert wanted is not None
        assert wanted.wz / abs(wanted.vx) == pytest.approx(bend, abs=0.02)


def test_a_robot_strays_by_its_distance_from_the_maneuver_not_from_the_last_pose() -> None:
    """It obeys late, so that where it is led from lies ahead of where it is."""
    for seed in SEEDS:
        rng = np.random.default_rng(seed)
        follower = ManeuverFollower(any_maneuver(rng, 4), reach_m=SHORT_M)
        poses = [near(follower.poses_ahead(0.0)[0], rng, 0.0, 0.0)] * 5
        twist, num_strayed = Twist2D.zero(), 0
        while (wanted := follower.command(Motion(poses[-1], twist), LIMITS)) is not None:
            for pose in (poses[-1], poses[-5]):
                num_strayed += follower.left_m > 0.0 and follower.has_strayed(pose)
            twist = limited_change(twist, wanted, LIMITS, DT_S)
            poses.append(integrate_twist(poses[-1], twist, DT_S))
        assert num_strayed == 0, seed


@pytest.mark.parametrize("sense", [FORWARDS, BACKWARDS])
@pytest.mark.parametrize(("aside_m", "off", "is_off"), [
    (0.04, 0.0, False), (-0.04, 0.1, False), (0.06, 0.0, True), (-0.06, 0.1, True),
    (0.0, 0.2, False), (0.0, 0.3, True), (0.0, -0.3, True),
])  # fmt: skip
def test_a_robot_strays_aside_or_turned(
    sense: int, aside_m: float, off: float, is_off: bool
) -> None:
    x = 0.0375 * sense * np.arange(30.0)
    line = np.column_stack([x, np.zeros(30), np.zeros(30)])
    motions = np.full(30, sense, dtype=np.int8)
    for steps in np.arange(3.0, 15.0, 0.25).tolist():
        follower = ManeuverFollower(Maneuver(line, motions), reach_m=SHORT_M)
        for passed in np.arange(steps):
            follower.command(Motion(Pose2D(x[int(passed)], 0.0, 0.0), Twist2D.zero()), LIMITS)
        here = Pose2D(0.0375 * sense * steps, aside_m, off)
        assert follower.has_strayed(here) == is_off


@pytest.mark.parametrize("sense", [FORWARDS, BACKWARDS])
@pytest.mark.parametrize("then", [TURNING, FORWARDS, BACKWARDS])
def test_where_a_robot_beside_its_line_comes_to_its_end_it_goes_on_from_there(
    sense: int, then: int
) -> None:
    line = np.column_stack([0.03 * sense * np.arange(11.0), np.zeros(11), np.zeros(11)])
    more = np.tile(line[-1], (16, 1))
    more[:, 2] += 0.1 * np.arange(16) * (then == TURNING)
    more[:, 0] += 0.03 * np.arange(16) * then
    motions = np.repeat([sense, then], [11, 15]).astype(np.int8)
    maneuver = Maneuver(np.concatenate([line, more[1:]]), motions)
    follower = ManeuverFollower(maneuver, reach_m=SHORT_M)
    follower.command(Motion(Pose2D(0.24 * sense, 0.0, 0.0), Twist2D.zero()), LIMITS)
    foreseen = follower.poses_from(Pose2D(0.24 * sense, 0.02, 0.0), 0.4)
    off = foreseen - follower.poses_ahead(0.4)
    ended = 10 - (len(maneuver.poses) - len(follower.poses_ahead(9.0)))
    assert off[ended, 1] > 0.015
    if then != sense:
        assert np.allclose(off[ended:, :2], off[ended, :2])
