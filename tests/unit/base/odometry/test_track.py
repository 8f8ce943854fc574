import math

import numpy as np
import pytest

from trolley.geometry import Pose2D, Twist2D, exp_twist
from trolley_base.drivers import MotionSample
from trolley_base.odometry.track import OdometryTrack

START_NS = 1_764_000_000_000_000_000  # as long after 1970 as real stamps are
STEP_NS = 20_000_000
TWIST = Twist2D(0.5, 0.0, 1.0)


def drive(track: OdometryTrack, steps: int) -> None:
    for _ in range(steps):
        motion = exp_twist(TWIST, STEP_NS / 1e9)
        track.add(MotionSample(track.stamp_ns + STEP_NS, motion, TWIST))


def test_it_begins_at_zero() -> None:
    track = OdometryTrack(START_NS)
    assert (track.stamp_ns, track.odom_T_base) == (START_NS, Pose2D(0.0, 0.0, 0.0))
    assert track.twist.is_zero


def test_small_arcs_join_to_the_whole_arc() -> None:
    track = OdometryTrack(START_NS)
    drive(track, 500)
    whole = exp_twist(TWIST, 10.0)
    assert track.odom_T_base.x == pytest.approx(whole.x, abs=1e-9)
    assert track.odom_T_base.y == pytest.approx(whole.y, abs=1e-9)
    assert track.odom_T_base.yaw == pytest.approx(whole.yaw, abs=1e-9)


def test_poses_between_samples_are_interpolated() -> None:
    track = OdometryTrack(START_NS)
    drive(track, 20)
    stamps_ns = START_NS + np.array([0, 110_000_000, 390_000_000])
    for pose, seconds in zip(track.poses_at(stamps_ns), (0.0, 0.11, 0.39), strict=True):
        true = exp_twist(TWIST, seconds)
        assert pose == pytest.approx([true.x, true.y, true.yaw], abs=1e-4)


def test_a_heading_that_passes_half_a_turn_does_not_leap_between_samples() -> None:
    track = OdometryTrack(START_NS)
    turn = Pose2D(0.0, 0.0, 3.0)
    track.add(MotionSample(START_NS + STEP_NS, turn, TWIST))
    track.add(MotionSample(START_NS + 2 * STEP_NS, Pose2D(0.0, 0.0, 0.3), TWIST))
    assert track.odom_T_base.yaw == pytest.approx(3.3 - 2 * math.pi)
    between = track.poses_at(np.array([START_NS + 3 * STEP_NS // 2]))
    assert between[0, 2] == pytest.approx(3.15)


def test_outside_of_what_is_kept_the_nearest_pose_holds() -> None:
    track = OdometryTrack(START_NS)
    drive(track, 200)
    ends = track.poses_at(np.array([0, START_NS + 10**12]))
    now = track.odom_T_base
    assert ends[1, :2] == pytest.approx([now.x, now.y])
    assert np.isfinite(ends).all()
