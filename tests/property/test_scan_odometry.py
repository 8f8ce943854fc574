"""The lidar's odometry in random rooms: it follows, and says how well."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.rooms import Walls, corridor, furnished_room, look

from trolley.geometry import Pose2D, Twist2D, angle_difference, integrate_twist
from trolley.scan_matching.scan_odometry import Prior, ScanMotion, ScanOdometry

MOUNT = Pose2D(0.08, -0.03, 0.4)
EVERY_S = 0.125
FEW = settings(max_examples=12, deadline=None)
seeds = st.integers(0, 2**32 - 1)


def twists_of(rng: np.random.Generator) -> list[Twist2D]:
    """A drive of some seconds around the origin: ahead, turning, back, with soft changes."""
    way = rng.uniform(0.25, 0.5)
    turn = rng.uniform(0.4, 1.2) * rng.choice([-1.0, 1.0])
    parts = [(way, 0.0), (0.0, turn), (-way, 0.0), (-way, turn), (way, -turn), (0.0, -turn)]
    wanted = np.repeat(np.array(parts), 8, axis=0)
    smooth = np.stack([np.convolve(wanted[:, k], np.ones(4) / 4, "full") for k in (0, 1)], axis=1)
    return [Twist2D(float(v), 0.0, float(w)) for v, w in smooth]


def drive(
    walls: Walls, twists: list[Twist2D], rng: np.random.Generator, odometry: ScanOdometry
) -> list[tuple[Pose2D, ScanMotion]]:
    """The true step since the scan before, and what was made of the scan, of a whole drive."""
    pose, before = Pose2D.identity(), Pose2D.identity()
    found: list[tuple[Pose2D, ScanMotion]] = []
    for number, twist in enumerate(twists):
        scan = look(walls, pose, twist, MOUNT, rng, stamp_s=EVERY_S * number, duration_s=EVERY_S)
        found.append((before.inverse() @ pose, odometry.update(scan, EVERY_S)))
        before, pose = pose, integrate_twist(pose, twist, EVERY_S)
    return found


def end_of(steps: list[tuple[Pose2D, ScanMotion]]) -> Pose2D:
    """Where the true steps lead."""
    pose = Pose2D.identity()
    for step, _ in steps:
        pose = pose @ step
    return pose


@FEW
@given(seed=seeds)
def test_a_drive_in_a_room_is_followed(seed: int) -> None:
    rng = np.random.default_rng(seed)
    odometry = ScanOdometry()
    steps = drive(furnished_room(rng), twists_of(rng), rng, odometry)
    true = end_of(steps)
    assert not any(motion.is_lost for _, motion in steps)
    assert odometry.pose.distance_to(true) < 0.04
    assert abs(angle_difference(odometry.pose.yaw, true.yaw)) < math.radians(1.2)


@FEW
@given(seed=seeds)
def test_steps_err_as_their_covariances_say(seed: int) -> None:
    rng = np.random.default_rng(seed)
    steps = drive(furnished_room(rng), twists_of(rng), rng, ScanOdometry())
    squares: list[float] = []
    for true, motion in steps[1:]:
        off = (true.inverse() @ motion.step).as_array()
        squares.append(float(off @ np.linalg.solve(motion.covariance, off)))
    # Three numbers each: 3 is honest, and to claim more than is so is worse than to claim less.
    assert 0.1 < np.mean(squares) < 4.5


def test_a_circle_is_seen_as_large_as_it_is() -> None:
    # A scan that is straightened along the chord of its arc makes circles 0.16 % too large.
    rng = np.random.default_rng(4)
    steps = drive(furnished_room(rng), [Twist2D(0.5, 0.0, 1.1)] * 200, rng, ScanOdometry())
    true, seen = Pose2D.identity(), Pose2D.identity()
    ways: list[tuple[float, float]] = []
    for number, (step, motion) in enumerate(steps[8:], start=1):
        true, seen = true @ step, seen @ motion.step
        if number % 8 == 0:
            ways.append((math.hypot(seen.x, seen.y), math.hypot(true.x, true.y)))
            true, seen = Pose2D.identity(), Pose2D.identity()
    found, real = np.sum(ways, axis=0)
    assert found / real == pytest.approx(1.0, abs=0.0007)


def test_a_robot_that_stands_does_not_drift() -> None:
    rng = np.random.default_rng(5)
    odometry = ScanOdometry()
    drive(furnished_room(rng), [Twist2D.zero()] * 60, rng, odometry)
    assert odometry.pose.distance_to(Pose2D.identity()) < 0.008
    assert abs(odometry.pose.yaw) < 0.004


@FEW
@given(seed=seeds, heading=st.floats(-math.pi, math.pi))
def test_a_corridor_shows_everything_but_the_way_along_it(seed: int, heading: float) -> None:
    rng = np.random.default_rng(seed)
    odometry = ScanOdometry()
    walls = corridor()
    cos, sin = math.cos(heading), math.sin(heading)
    turned = walls @ np.array([[cos, sin], [-sin, cos]])
    steps = drive(turned, [Twist2D(0.1 * k, 0.0, 0.0) for k in (0, 1, 2, 2, 2)], rng, odometry)
    motion = steps[-1][1]
    along = np.array([cos, sin, 0.0])
    aside = np.array([-sin, cos, 0.0])
    assert along @ motion.shown @ along < 0.05 * (aside @ motion.shown @ aside)
    assert math.sqrt(aside @ motion.covariance @ aside) < 0.01
    if abs(cos) > 0.9:  # the axle holds the robot where it stands across the corridor
        assert math.sqrt(along @ motion.covariance @ along) > 0.015


def test_in_a_corridor_the_wheels_say_how_far() -> None:
    rng = np.random.default_rng(2)
    odometry = ScanOdometry()
    pose, wheels = Pose2D.identity(), Pose2D(0.06, 0.0, 0.01)
    prior = Prior(wheels, np.diag([0.005, 0.005, 0.02]) ** 2)
    for number in range(10):
        scan = look(corridor(), pose, Twist2D.zero(), MOUNT, rng, stamp_s=0.2 * number)
        odometry.update(scan, prior=prior)
        pose = pose @ Pose2D(0.06, 0.0, 0.0)
    assert odometry.pose.x == pytest.approx(9 * 0.06, abs=0.01)
    assert odometry.pose.yaw == pytest.approx(0.0, abs=0.01)


def test_a_covered_lidar_is_lost_and_followed_again() -> None:
    rng = np.random.default_rng(3)
    walls, odometry = furnished_room(rng), ScanOdometry()
    lost: list[bool] = []
    for number in range(12):
        scan = look(walls, Pose2D.identity(), Twist2D.zero(), MOUNT, rng, stamp_s=0.1 * number)
        if 4 <= number < 9:
            scan = replace(scan, ranges=np.full_like(scan.ranges, 0.1))
        lost.append(odometry.update(scan).is_lost)
    assert lost == [False] * 4 + [True] * 5 + [False] * 3
    assert odometry.pose.distance_to(Pose2D.identity()) < 0.02


def test_a_robot_carried_to_another_room_is_lost_and_begins_anew() -> None:
    rng = np.random.default_rng(11)
    odometry = ScanOdometry()
    rooms = [furnished_room(rng), furnished_room(rng) + np.array([1.0, 0.4])]
    lost: list[bool] = []
    for number in range(16):
        walls = rooms[number >= 5]
        scan = look(walls, Pose2D.identity(), Twist2D.zero(), MOUNT, rng, stamp_s=0.1 * number)
        lost.append(odometry.update(scan).is_lost)
    assert lost[5]
    assert not any(lost[-5:])


@FEW
@given(seed=seeds)
def test_without_a_known_mount_the_lidar_itself_is_followed(seed: int) -> None:
    rng = np.random.default_rng(seed)
    walls, odometry = furnished_room(rng), ScanOdometry(has_axle=False)
    x, y, yaw = rng.uniform((-0.25, -0.25, -math.pi), (0.25, 0.25, math.pi)).tolist()
    mount = Pose2D(x, y, yaw)
    pose = last = Pose2D.identity()
    for number, twist in enumerate(twists_of(rng)):
        scan = look(walls, pose, twist, mount, rng, stamp_s=EVERY_S * number, duration_s=EVERY_S)
        odometry.update(replace(scan, base_T_laser=Pose2D.identity()), EVERY_S)
        last, pose = pose, integrate_twist(pose, twist, EVERY_S)
    true = mount.inverse() @ last @ mount
    assert odometry.pose.distance_to(true) < 0.04
    assert abs(angle_difference(odometry.pose.yaw, true.yaw)) < math.radians(1.2)


def test_an_old_scan_is_refused() -> None:
    rng = np.random.default_rng(1)
    odometry = ScanOdometry()
    scan = look(corridor(), Pose2D.identity(), Twist2D.zero(), MOUNT, rng)
    odometry.update(scan)
    with pytest.raises(ValueError, match="newer"):
        odometry.update(scan)
