"""The drive: limits, what the board reports, and what really happens."""

import math

import numpy as np
import pytest

from trolley.geometry import Pose2D, Twist2D, exp_twist
from trolley_base.world.spec import DriveLimits, Motors, Wheels
from trolley_base.world.wheels import Drive

DT = 0.01
EXACT = Wheels(scale_std=0, turn_scale_std=0, slip_per_m=0, yaw_slip_per_m=0, yaw_slip_per_rad=0)


def make_drive(wheels: Wheels, seed: int = 0, motors: Motors = Motors()) -> Drive:  # noqa: B008
    rngs = [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(3)]
    return Drive(wheels, motors, DriveLimits(), *rngs)


def test_speed_grows_and_falls_within_the_limits() -> None:
    drive, speeds = make_drive(EXACT), [0.0]
    for command in [Twist2D(9.0, 0.0, 0.0)] * 100 + [Twist2D(-9.0, 0.0, 0.0)] * 150:
        drive.step(command, DT)
        speeds.append(drive.twist.vx)
    changes = np.diff(speeds)
    limits = DriveLimits()
    assert max(speeds) == pytest.approx(limits.max_speed_mps)
    assert min(speeds) == pytest.approx(-limits.max_speed_mps)
    assert changes.max() == pytest.approx(limits.acceleration_mps2 * DT)
    assert changes.min() == pytest.approx(-limits.deceleration_mps2 * DT)


def test_a_command_that_is_no_number_stops() -> None:
    drive = make_drive(EXACT)
    for _ in range(100):
        drive.step(Twist2D(math.nan, math.nan, math.inf), DT)
    assert drive.twist == Twist2D.zero()


def test_without_errors_what_is_reported_is_what_happens() -> None:
    drive = make_drive(EXACT)
    for _ in range(200):
        motion = drive.step(Twist2D(0.3, 0.0, 0.8), DT)
        assert motion.own == motion.slipping
        expected = exp_twist(motion.own, DT)
        np.testing.assert_allclose(
            motion.reported.as_array(), expected.as_array(), rtol=0, atol=1e-12
        )


def test_a_scale_reports_more_than_was_driven() -> None:
    drive = make_drive(
        Wheels(
            left_scale=1.02,
            right_scale=1.02,
            scale_std=0,
            turn_scale_std=0,
            slip_per_m=0,
            yaw_slip_per_m=0,
            yaw_slip_per_rad=0,
        )
    )
    for _ in range(200):
        motion = drive.step(Twist2D(0.4, 0.0, 0.0), DT)
    assert motion.reported.x == pytest.approx(0.4 * DT)
    assert motion.own.vx == pytest.approx(0.4 / 1.02)


def test_seeds_differ_in_their_scales() -> None:
    turns = []
    for seed in range(200):
        drive = make_drive(Wheels(scale_std=0.01, turn_scale_std=0.0), seed)
        for _ in range(100):
            motion = drive.step(Twist2D(0.4, 0.0, 0.0), DT)
        turns.append(motion.own.wz)
    # Two wheels of 1 % spread on a track of 0.2 m at 0.4 m/s.
    assert np.std(turns) == pytest.approx(0.01 * math.sqrt(2) * 0.4 / 0.2, rel=0.2)


def test_slip_grows_with_the_square_root_of_the_way() -> None:
    wheels = Wheels(
        scale_std=0, turn_scale_std=0, slip_per_m=0.02, yaw_slip_per_m=0.03, yaw_slip_per_rad=0
    )
    along, turned = [], []
    for seed in range(300):
        drive, pose, way = make_drive(wheels, seed), Pose2D.identity(), 0.0
        while way < 1.0:
            motion = drive.step(Twist2D(0.5, 0.0, 0.0), 0.1)
            pose = pose @ exp_twist(Twist2D(0.0, 0.0, motion.slipping.wz), 0.1)
            way += motion.own.vx * 0.1
            along.append((motion.slipping.vx - motion.own.vx) * 0.1)
        turned.append(pose.yaw)
    assert np.std(turned) == pytest.approx(0.03, rel=0.15)
    assert np.std(along) * math.sqrt(len(along) / 300) == pytest.approx(0.02, rel=0.15)


def test_worn_wheels_drive_less_and_a_wider_track_turns_less_than_is_reported() -> None:
    drive = make_drive(EXACT)
    drive.wear(0.97, 0.97)
    drive.widen_track(1.03)
    for _ in range(200):
        motion = drive.step(Twist2D(0.3, 0.0, 0.8), DT)
    assert motion.own.vx == pytest.approx(0.97 * 0.3)
    assert motion.own.wz == pytest.approx(0.97 * 0.8 / 1.03)
