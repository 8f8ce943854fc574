"""Odometry with scans: what they correct, and what is said of wheels that they contradict."""

import math
from collections.abc import Iterator

import numpy as np
import pytest
from support.rooms import furnished_room, look

from trolley.geometry import Pose2D, Twist2D, exp_twist, integrate_twist
from trolley_base.drivers import LidarScan, MotionSample
from trolley_base.odometry.lidar_odometry import LidarOdometry, WheelTrouble

MOUNT = Pose2D(0.08, -0.03, 0.4)
STEP_S, SCAN_STEPS = 0.025, 5
STILL, AHEAD, LEFT = Twist2D.zero(), Twist2D(0.2, 0.0, 0.0), Twist2D(0.0, 0.0, 0.6)


def moments(twists: list[Twist2D], seed: int) -> Iterator[tuple[int, Pose2D, LidarScan | None]]:
    """Robot times, true poses and the scans that end there, while the robot moves for 0.5 s each.

    The lidar turns once in five steps.
    """
    rng = np.random.default_rng(seed)
    walls, pose, begin = furnished_room(rng), Pose2D.identity(), Pose2D.identity()
    for number in range(len(twists) * 20):
        twist = twists[number // 20]
        stamp_ns = round(1e9 * STEP_S * (number + 1))
        pose = integrate_twist(pose, twist, STEP_S)
        scan = None
        if number % SCAN_STEPS == SCAN_STEPS - 1:
            duration_s = STEP_S * SCAN_STEPS
            seen = look(walls, begin, twist, MOUNT, rng, duration_s=duration_s)
            scan = LidarScan(
                stamp_ns - round(1e9 * duration_s) + 1,
                seen.angle_min,
                seen.angle_increment,
                duration_s / (len(seen.ranges) - 1),
                seen.range_min,
                seen.range_max,
                seen.ranges,
            )
            begin = pose
        yield stamp_ns, pose, scan


def with_wheels(
    twists: list[Twist2D], reported: list[Twist2D], seed: int
) -> tuple[LidarOdometry, Pose2D, Pose2D]:
    """Drive with wheels that report this: the odometry, where it says the robot is, the truth."""
    odometry = LidarOdometry(MOUNT, 0, has_wheels=True, has_axle=True)
    known = true = Pose2D.identity()
    for number, (stamp_ns, pose, scan) in enumerate(moments(twists, seed)):
        twist = reported[number // 20]
        motion = MotionSample(stamp_ns, exp_twist(twist, STEP_S), twist)
        known, true = known @ odometry.correct(motion, known).previous_T_base, pose
        if scan is not None:
            odometry.update(scan, None)
    return odometry, known, true


def test_wheels_that_are_a_tenth_off_are_corrected() -> None:
    drive = [STILL, *[AHEAD] * 4, *[LEFT] * 6, *[AHEAD] * 3, STILL]
    reported = [Twist2D(1.1 * one.vx, 0.0, 0.9 * one.wz) for one in drive]
    odometry, known, true = with_wheels(drive, reported, 1)
    assert odometry.trouble == ""
    assert known.distance_to(true) < 0.03
    assert known.yaw == pytest.approx(true.yaw, abs=0.03)


def test_what_the_wheels_did_while_the_lidar_was_gone_stays() -> None:
    """Longer than the tracks reach back, the robot coasts, then stands."""
    odometry = LidarOdometry(MOUNT, 0, has_wheels=True, has_axle=True)
    drive = [STILL, *[AHEAD] * 4, *[STILL] * 9]
    known = true = Pose2D.identity()
    leaps: list[float] = []
    for number, (stamp_ns, pose, scan) in enumerate(moments(drive, 1)):
        twist = drive[number // 20]
        step = odometry.correct(MotionSample(stamp_ns, exp_twist(twist, STEP_S), twist), known)
        leaps.append(math.hypot(step.previous_T_base.x, step.previous_T_base.y))
        known, true = known @ step.previous_T_base, pose
        if scan is not None and not 1.0 < stamp_ns * 1e-9 < 6.0:
            odometry.update(scan, None)
    assert max(leaps) < 0.03
    assert known.distance_to(true) < 0.03


KINDS = {
    "stuck": ([STILL] * 9, [AHEAD] * 9, WheelTrouble.SLIP),
    "ahead for back": ([AHEAD.scaled(-1.0)] * 9, [AHEAD] * 9, WheelTrouble.BACKWARDS),
    "swapped": ([LEFT] * 9, [LEFT.scaled(-1.0)] * 9, WheelTrouble.TURNS_BACKWARDS),
    "a rug": ([AHEAD] * 9, [AHEAD.scaled(1.2)] * 9, None),
}


@pytest.mark.parametrize("kind", KINDS)
def test_wheels_that_the_lidar_contradicts_are_named_and_not_followed(kind: str) -> None:
    true_twists, reported, wanted = KINDS[kind]
    odometry, known, true = with_wheels([STILL, *true_twists], [STILL, *reported], 3)
    assert odometry.trouble == ("" if wanted is None else wanted.value)
    assert known.distance_to(true) < 0.06
    assert known.yaw == pytest.approx(true.yaw, abs=0.06)


def alone(twists: list[Twist2D], seed: int, *, is_told: bool) -> tuple[float, Pose2D, Pose2D]:
    """Drive without wheels: the greatest error on the way, where it says it is, and the truth."""
    odometry = LidarOdometry(MOUNT, 0, has_wheels=False, has_axle=True)
    known = true = Pose2D.identity()
    worst_m = 0.0
    for number, (stamp_ns, pose, scan) in enumerate(moments(twists, seed)):
        if is_told:
            # The motors heard of it a moment before they did it.
            ahead = min(len(twists) - 1, (number + 5) // 20)
            odometry.command(stamp_ns, twists[ahead])
        if scan is not None:
            odometry.update(scan, None)
        motion = odometry.carried_on(stamp_ns, None)
        assert motion is not None
        known, true = known @ odometry.correct(motion, known).previous_T_base, pose
        worst_m = max(worst_m, known.distance_to(true))
    return worst_m, known, true


DRIVE = [STILL, *[AHEAD] * 3, STILL, *[LEFT] * 4, *[AHEAD] * 2, STILL, STILL]


def test_a_robot_without_encoders_is_followed() -> None:
    worst_m, known, true = alone(DRIVE, 4, is_told=True)
    assert worst_m < 0.04
    assert known.distance_to(true) < 0.015
    assert known.yaw == pytest.approx(true.yaw, abs=math.radians(1.0))


def test_commands_foretell_what_the_next_scan_will_show() -> None:
    assert alone(DRIVE, 4, is_told=True)[0] < alone(DRIVE, 4, is_told=False)[0]


def test_without_scans_a_robot_without_encoders_stands() -> None:
    odometry = LidarOdometry(MOUNT, 0, has_wheels=False, has_axle=True)
    odometry.command(0, AHEAD)
    for stamp_ns in range(20_000_000, 1_000_000_000, 20_000_000):
        motion = odometry.carried_on(stamp_ns, None)
        assert motion is not None
        assert motion.previous_T_base == Pose2D.identity()


def test_a_scan_that_is_repeated_or_old_is_left_out() -> None:
    odometry = LidarOdometry(MOUNT, 0, has_wheels=False, has_axle=True)
    (*_, first), *_, (_, _, last) = (one for one in moments([STILL], 1) if one[2] is not None)
    assert last is not None
    assert first is not None
    odometry.update(last, None)
    assert odometry.update(last, None) is None
    assert odometry.update(first, None) is None
