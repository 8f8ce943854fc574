"""Scans joined with the odometry that belongs to them, and which of them can be used."""

import math
import struct
from dataclasses import replace

import pytest
from msgspec import structs

from trolley.geometry import Pose2D, Twist2D
from trolley.messages import Odometry, Scan, Transform
from trolley.scanning import (
    FrontEndParams,
    Motion,
    Reject,
    ScanAssembler,
    ScanInput,
    assemble,
    is_covered,
    motion_since,
    pose_at,
    problem_of,
)

PARAMS = FrontEndParams(
    least_range_m=0.01, usable_range_share=1.0, telling_range_m=0.5, min_telling_share=0.1
)
LASER = Transform(stamp_ns=0, parent="base_link", child="laser", pose=Pose2D(0.1, 0.0, 0.0))


def message(stamp_ms: int, x: float, vx: float = 1.0) -> Odometry:
    return Odometry(
        stamp_ns=stamp_ms * 1_000_000, pose=Pose2D(x, 0.0, 0.0), twist=Twist2D(vx, 0.0, 0.0)
    )


HISTORY = [message(100, 0.1), message(150, 0.15), message(200, 0.25)]


@pytest.mark.parametrize(
    ("stamp_ms", "x"), [(100, 0.1), (125, 0.125), (180, 0.21), (200, 0.25), (220, 0.27), (90, 0.09)]
)
def test_it_is_interpolated_or_carried_on(stamp_ms: int, x: float) -> None:
    pose = pose_at(HISTORY, stamp_ms * 1_000_000)
    assert pose is not None
    assert pose.x == pytest.approx(x)


def test_moments_too_far_away_have_none() -> None:
    assert pose_at([], 0) is None
    assert pose_at(HISTORY, 500_000_000) is None
    assert pose_at(HISTORY, -500_000_000) is None


def test_it_is_covered_by_a_message_from_then_or_later() -> None:
    assert is_covered(HISTORY, 200_000_000)
    assert not is_covered(HISTORY, 200_000_001)
    assert not is_covered([], 0)


def scan(stamp_ms: int, beams: int = 3, sweep_ms: float = 20.0) -> Scan:
    return Scan(
        stamp_ns=stamp_ms * 1_000_000,
        frame="laser",
        angle_min=0.0,
        angle_increment=0.1,
        time_increment=sweep_ms * 1e-3 / (beams - 1),
        range_min=0.1,
        range_max=8.0,
        ranges=memoryview(struct.pack(f"<{beams}f", *[1.0] * beams)),
        intensities=memoryview(b""),
    )


def scan_input(stamp_ms: int, x: float) -> ScanInput:
    found = assemble(scan(stamp_ms), [message(stamp_ms, x)], LASER)
    assert isinstance(found, ScanInput)
    return found


def test_a_scan_gets_the_odometry_of_its_first_and_its_last_beam() -> None:
    found = assemble(scan(160), HISTORY, LASER)
    assert isinstance(found, ScanInput)
    assert found.odom_T_base.x == pytest.approx(0.17)
    assert found.odom_T_base_end.x == pytest.approx(0.21)
    assert found.motion.x == pytest.approx(0.04)
    assert found.base_T_laser == LASER.pose


def test_without_mounting_or_odometry_a_scan_is_useless() -> None:
    assert assemble(scan(160), HISTORY, None) is Reject.NO_LASER_MOUNTING
    elsewhere = Transform(stamp_ns=0, parent="arm", child="laser", pose=LASER.pose)
    assert assemble(scan(160), HISTORY, elsewhere) is Reject.NO_LASER_MOUNTING
    assert assemble(scan(160), [], LASER) is Reject.NO_ODOMETRY
    assert assemble(scan(900), HISTORY, LASER) is Reject.NO_ODOMETRY


@pytest.mark.parametrize("time_increment", [1e300, -1e300, 1e308])
def test_a_scan_that_takes_for_ever_is_useless(time_increment: float) -> None:
    endless = structs.replace(scan(160), time_increment=time_increment)
    assert assemble(endless, HISTORY, LASER) is Reject.NO_ODOMETRY


def test_a_scan_waits_for_the_odometry_of_its_last_beam() -> None:
    assembler = ScanAssembler()
    assembler.add(scan(190), 0)
    assert assembler.take(HISTORY, LASER, 0, 1.0) == []
    (found,) = assembler.take([*HISTORY, message(250, 0.3)], LASER, 0, 1.0)
    assert isinstance(found, ScanInput)
    assert assembler.take(HISTORY, LASER, 10**9, 1.0) == []


def test_overdue_odometry_is_extrapolated() -> None:
    assembler = ScanAssembler()
    assembler.add(scan(190), 0)
    assert assembler.take(HISTORY, LASER, 40_000_000, 2.0) == []
    (found,) = assembler.take(HISTORY, LASER, 60_000_000, 2.0)
    assert isinstance(found, ScanInput)
    assert found.odom_T_base_end.x == pytest.approx(0.26)


def test_a_newer_scan_does_not_drop_the_one_that_waits() -> None:
    assembler = ScanAssembler()
    assembler.add(scan(190), 0)
    assembler.add(scan(290), 100_000_000)
    (found,) = assembler.take(HISTORY, LASER, 100_000_000, 1.0)
    assert isinstance(found, ScanInput)
    assert found.stamp_ns == 190_000_000


def test_a_cleared_assembler_holds_nothing() -> None:
    assembler = ScanAssembler()
    assembler.add(scan(190), 0)
    assembler.add(scan(290), 0)
    assembler.clear()
    assert assembler.take(HISTORY, LASER, 10**9, 1.0) == []


def test_a_scan_must_be_new_and_finite() -> None:
    good = scan_input(100, 0.0)
    assert problem_of(good, None) is None
    assert problem_of(good, 99_000_000) is None
    assert problem_of(good, 100_000_000) is Reject.OLD_STAMP
    broken = Pose2D(math.nan, 0.0, 0.0)
    assert problem_of(replace(good, odom_T_base_end=broken), None) is Reject.BAD_ODOMETRY
    assert problem_of(replace(good, angle_min=math.inf), None) is Reject.BAD_GEOMETRY
    assert problem_of(replace(good, base_T_laser=broken), None) is Reject.BAD_GEOMETRY


@pytest.mark.parametrize("x", [400.0, 1e9, -1e308])
def test_a_scan_during_which_the_odometry_was_reset_is_not_drawn_out_over_kilometres(
    x: float,
) -> None:
    good, elsewhere = scan_input(100, 0.0), Pose2D(x, 0.0, 0.0)
    assert problem_of(replace(good, odom_T_base_end=elsewhere), None) is Reject.BAD_ODOMETRY
    assert problem_of(replace(good, odom_T_base=elsewhere), None) is Reject.BAD_ODOMETRY
    assert problem_of(replace(good, base_T_laser=elsewhere), None) is Reject.BAD_GEOMETRY


def test_the_motion_since_the_scan_before_is_that_of_the_odometry() -> None:
    assert motion_since(None, scan_input(100, 3.0), PARAMS) == Motion(Pose2D.identity(), 0.0)
    motion = motion_since(scan_input(100, 1.0), scan_input(200, 1.2), PARAMS)
    assert motion.step.x == pytest.approx(0.2)
    assert motion.elapsed_s == pytest.approx(0.1)
    assert not motion.is_jump


@pytest.mark.parametrize(("x", "is_jump"), [(0.89, False), (0.91, True), (-0.91, True)])
def test_a_step_that_no_robot_drives_is_a_jump(x: float, is_jump: bool) -> None:
    motion = motion_since(scan_input(100, 0.0), scan_input(200, x), PARAMS)
    assert motion.is_jump == is_jump
    assert motion.step.x == pytest.approx(0.0 if is_jump else x)
    assert motion.elapsed_s == pytest.approx(0.1)


@pytest.mark.parametrize(("x", "is_jump"), [(40.0, False), (41.0, True)])
def test_however_long_there_was_no_scan_a_large_step_is_a_jump(x: float, is_jump: bool) -> None:
    after_hours = scan_input(3 * 3_600_000, x)
    assert motion_since(scan_input(100, 0.0), after_hours, PARAMS).is_jump == is_jump
