import dataclasses
import math

import numpy as np
import pytest
from numpy.typing import NDArray

from trolley.geometry import Pose2D, Twist2D
from trolley_base.drivers import LidarScan, MotionSample
from trolley_base.odometry.track import OdometryTrack
from trolley_base.safety.near_echoes import NearEchoes

STEP_NS = 20_000_000
BEAMS = 360
MOUNT = Pose2D(0.1, 0.0, math.pi / 2)


def scan_of(
    ranges: NDArray[np.float64], stamp_ns: int = 0, time_increment: float = 0.0
) -> LidarScan:
    return LidarScan(
        stamp_ns=stamp_ns,
        angle_min=-math.pi,
        angle_increment=2.0 * math.pi / len(ranges),
        time_increment=time_increment,
        range_min=0.15,
        range_max=8.0,
        ranges=ranges.astype(np.float32),
    )


def one_echo(beam: int, distance: float) -> NDArray[np.float64]:
    ranges = np.full(BEAMS, np.inf)
    ranges[beam] = distance
    return ranges


def drive(track: OdometryTrack, metres: float, steps: int = 1) -> None:
    for _ in range(steps):
        motion = Pose2D(metres / steps, 0.0, 0.0)
        track.add(MotionSample(track.stamp_ns + STEP_NS, motion, Twist2D(0.5, 0.0, 0.0)))


def test_a_beam_becomes_a_point_in_base_link() -> None:
    echoes, track = NearEchoes(MOUNT, reach=2.0), OdometryTrack(0)
    echoes.update(scan_of(one_echo(BEAMS // 2, 0.5)), track)  # angle 0 of the laser: base's left
    assert echoes.points(track.odom_T_base) == pytest.approx(np.array([[0.1, 0.5]]), abs=1e-6)


def test_points_stay_in_place_while_the_robot_moves_on() -> None:
    echoes, track = NearEchoes(Pose2D(0.0, 0.0, 0.0), reach=2.0), OdometryTrack(0)
    echoes.update(scan_of(one_echo(BEAMS // 2, 1.0)), track)
    drive(track, 0.3)
    assert echoes.points(track.odom_T_base) == pytest.approx(np.array([[0.7, 0.0]]), abs=1e-6)


@pytest.mark.parametrize("clockwise", [False, True])
def test_each_beam_is_placed_where_the_robot_was_when_it_was_measured(clockwise: bool) -> None:
    echoes, track = NearEchoes(Pose2D(0.0, 0.0, 0.0), reach=2.0), OdometryTrack(0)
    drive(track, 0.1, steps=5)  # 0.1 m in 0.1 s
    between = (-0.1 if clockwise else 0.1) / BEAMS
    stamp_ns = 100_000_000 if clockwise else 0
    echoes.update(scan_of(one_echo(BEAMS // 2, 1.0), stamp_ns, between), track)
    # The beam straight ahead was measured half a revolution ago, 0.05 m farther back.
    expected = np.array([[0.95, 0.0]])
    assert echoes.points(track.odom_T_base) == pytest.approx(expected, abs=1e-3)


def test_invalid_silent_and_far_beams_are_no_points() -> None:
    echoes, track = NearEchoes(Pose2D(0.0, 0.0, 0.0), reach=2.0), OdometryTrack(0)
    ranges = np.array([0.0, np.inf, 3.0, 1.0, np.nan, 0.0, 0.0, 0.0])
    echoes.update(scan_of(ranges), track)
    assert len(echoes.points(track.odom_T_base)) == 1


def test_a_new_scan_replaces_the_last() -> None:
    echoes, track = NearEchoes(Pose2D(0.0, 0.0, 0.0), reach=2.0), OdometryTrack(0)
    echoes.update(scan_of(one_echo(90, 1.0)), track)
    echoes.update(scan_of(one_echo(180, 1.0)), track)
    assert echoes.points(track.odom_T_base) == pytest.approx(np.array([[1.0, 0.0]]), abs=1e-6)


def wall_ranges(distance: float) -> NDArray[np.float64]:
    """What is seen of a wall ahead: too near for the sensor becomes 0."""
    angles = -math.pi + np.arange(BEAMS) * (2.0 * math.pi / BEAMS)
    with np.errstate(divide="ignore"):
        ranges = np.where(np.cos(angles) > 0.3, distance / np.cos(angles), np.inf)
    ranges[ranges < 0.15] = 0.0
    return ranges


def test_a_wall_that_is_too_near_to_be_measured_is_not_forgotten() -> None:
    echoes, track = NearEchoes(Pose2D(0.0, 0.0, 0.0), reach=2.0), OdometryTrack(0)
    for distance in (0.17, 0.15, 0.13, 0.11, 0.09, 0.07):
        echoes.update(scan_of(wall_ranges(distance), track.stamp_ns), track)
        ahead = echoes.points(track.odom_T_base)
        ahead = ahead[np.abs(ahead[:, 1]) < 0.02]
        assert len(ahead) > 0
        assert np.min(ahead[:, 0]) == pytest.approx(distance, abs=0.005)
        drive(track, 0.02)


def test_a_stray_beam_here_and_there_makes_nothing_forgotten_that_is_too_near() -> None:
    echoes, track = NearEchoes(Pose2D(0.0, 0.0, 0.0), reach=2.0), OdometryTrack(0)
    echoes.update(scan_of(wall_ranges(0.16)), track)
    drive(track, 0.03)
    rng = np.random.default_rng(1)
    for _ in range(40):
        ranges = wall_ranges(0.13)
        ranges[(ranges == 0.0) & (rng.random(BEAMS) < 0.1)] = np.inf
        echoes.update(scan_of(ranges, track.stamp_ns), track)
    points = echoes.points(track.odom_T_base)
    for y in np.linspace(-0.05, 0.05, 6):
        gaps = np.hypot(points[:, 0] - 0.13, points[:, 1] - y)
        assert np.min(gaps) < 0.02


def test_a_thing_that_has_gone_is_forgotten_when_a_beam_sees_past() -> None:
    echoes, track = NearEchoes(Pose2D(0.0, 0.0, 0.0), reach=2.0), OdometryTrack(0)
    echoes.update(scan_of(wall_ranges(0.16)), track)
    drive(track, 0.03)
    echoes.update(scan_of(np.full(BEAMS, np.inf), track.stamp_ns), track)
    assert len(echoes.points(track.odom_T_base)) == 0


def test_noise_on_a_wall_is_averaged_but_a_post_before_it_stays() -> None:
    echoes, track = NearEchoes(Pose2D(0.0, 0.0, 0.0), reach=2.0), OdometryTrack(0)
    rng = np.random.default_rng(1)
    ranges = wall_ranges(0.5) + rng.normal(0.0, 0.01, BEAMS)
    ranges[180] = 0.4
    echoes.update(scan_of(ranges), track)
    points = echoes.points(track.odom_T_base)
    assert np.min(np.hypot(points[:, 0], points[:, 1])) == pytest.approx(0.4, abs=1e-6)
    wall = points[(np.abs(points[:, 1]) < 0.4) & (points[:, 0] > 0.45)]
    assert np.std(wall[:, 0]) < 0.008


def test_a_scan_with_few_beams_is_taken() -> None:
    echoes, track = NearEchoes(Pose2D(0.0, 0.0, 0.0), reach=2.0), OdometryTrack(0)
    for beams in (5, 2, 1):
        echoes.update(scan_of(np.full(beams, 0.3)), track)
        assert len(echoes.points(track.odom_T_base)) == beams


def half_scan(ranges: NDArray[np.float64], stamp_ns: int) -> LidarScan:
    """A lidar that looks 90 degrees to both sides of ahead only."""
    return LidarScan(
        stamp_ns=stamp_ns,
        angle_min=-math.pi / 2,
        angle_increment=math.pi / (len(ranges) - 1),
        time_increment=0.0,
        range_min=0.15,
        range_max=8.0,
        ranges=ranges.astype(np.float32),
    )


def turn(track: OdometryTrack, radians: float) -> None:
    motion = Pose2D(0.0, 0.0, radians)
    track.add(MotionSample(track.stamp_ns + STEP_NS, motion, Twist2D(0.0, 0.0, 1.0)))


def test_what_the_robot_turns_away_from_is_remembered_for_a_while() -> None:
    echoes, track = NearEchoes(Pose2D(0.0, 0.0, 0.0), reach=2.0), OdometryTrack(0)
    echoes.update(half_scan(one_echo(180, 1.0), 0), track)
    turn(track, math.pi)
    nothing = np.full(BEAMS, np.inf)
    echoes.update(half_scan(nothing, 1_000_000_000), track)
    behind = pytest.approx(np.array([[-1.0, 0.0]]), abs=0.01)
    assert echoes.points(track.odom_T_base) == behind
    echoes.update(half_scan(nothing, 29_000_000_000), track)
    assert echoes.points(track.odom_T_base) == behind
    echoes.update(half_scan(nothing, 31_000_000_000), track)
    assert len(echoes.points(track.odom_T_base)) == 0


def test_what_lies_out_of_view_is_judged_anew_when_the_robot_turns_back_to_it() -> None:
    echoes, track = NearEchoes(Pose2D(0.0, 0.0, 0.0), reach=2.0), OdometryTrack(0)
    echoes.update(half_scan(one_echo(180, 1.0), 0), track)
    nothing = np.full(BEAMS, np.inf)
    turn(track, math.pi)
    echoes.update(half_scan(nothing, 1_000_000_000), track)
    turn(track, math.pi)
    echoes.update(half_scan(nothing, 2_000_000_000), track)
    assert len(echoes.points(track.odom_T_base)) == 0


def test_what_beams_saw_is_remembered_where_they_fail() -> None:
    echoes, track = NearEchoes(Pose2D(0.0, 0.0, 0.0), reach=2.0), OdometryTrack(0)
    echoes.update(scan_of(one_echo(180, 1.0)), track)
    failing = np.full(BEAMS, np.inf)
    failing[160:200] = 0.0
    echoes.update(scan_of(failing, 1_000_000_000), track)
    assert echoes.points(track.odom_T_base) == pytest.approx(np.array([[1.0, 0.0]]), abs=0.01)


def into_the_sun(*echoes: tuple[int, float]) -> NDArray[np.float64]:
    ranges = np.full(BEAMS, np.inf)
    ranges[160:200] = 0.0
    for beam, distance in echoes:
        ranges[beam] = distance
    return ranges


def test_a_lone_echo_among_beams_that_fail_is_not_remembered() -> None:
    echoes, track = NearEchoes(Pose2D(0.0, 0.0, 0.0), reach=2.0), OdometryTrack(0)
    echoes.update(scan_of(into_the_sun((180, 0.5))), track)
    assert len(echoes.points(track.odom_T_base)) == 1  # as long as the newest scan shows it
    echoes.update(scan_of(into_the_sun(), 100_000_000), track)
    assert len(echoes.points(track.odom_T_base)) == 0


def test_lone_echoes_here_and_there_do_not_bear_each_other_out() -> None:
    echoes, track = NearEchoes(Pose2D(0.0, 0.0, 0.0), reach=2.0), OdometryTrack(0)
    for number, beam in enumerate((165, 195, 175, 185)):
        echoes.update(scan_of(into_the_sun((beam, 0.5)), number * 100_000_000), track)
    # The same place again, but long after.
    echoes.update(scan_of(into_the_sun((165, 0.5)), 5_000_000_000), track)
    echoes.update(scan_of(into_the_sun(), 5_100_000_000), track)
    assert len(echoes.points(track.odom_T_base)) == 0


@pytest.mark.parametrize("beams", [1, 2, 5, 8])
def test_a_sector_of_a_few_beams_shows_what_is_there(beams: int) -> None:
    echoes, track = NearEchoes(Pose2D(0.0, 0.0, 0.0), reach=2.0), OdometryTrack(0)
    sector = scan_of(np.full(BEAMS, 0.5))
    sector = dataclasses.replace(sector, angle_min=0.0, ranges=sector.ranges[:beams])
    echoes.update(sector, track)
    assert len(echoes.points(track.odom_T_base)) == beams


def test_a_leg_that_a_few_scans_show_among_beams_that_fail_is_remembered() -> None:
    echoes, track = NearEchoes(Pose2D(0.0, 0.0, 0.0), reach=2.0), OdometryTrack(0)
    echoes.update(scan_of(into_the_sun((180, 0.5))), track)
    echoes.update(scan_of(into_the_sun(), 300_000_000), track)
    echoes.update(scan_of(into_the_sun((180, 0.52)), 600_000_000), track)
    echoes.update(scan_of(into_the_sun(), 20_000_000_000), track)
    leg = pytest.approx(np.array([[0.52, 0.0]]), abs=0.01)
    assert echoes.points(track.odom_T_base) == leg


def test_a_few_echoes_beside_each_other_among_beams_that_fail_are_remembered() -> None:
    echoes, track = NearEchoes(Pose2D(0.0, 0.0, 0.0), reach=2.0), OdometryTrack(0)
    echoes.update(scan_of(into_the_sun((180, 0.5), (183, 0.5))), track)
    echoes.update(scan_of(into_the_sun(), 20_000_000_000), track)
    assert len(echoes.points(track.odom_T_base)) == 2


def test_a_wall_that_is_passed_again_and_again_is_remembered_once() -> None:
    echoes, track = NearEchoes(Pose2D(0.0, 0.0, 0.0), reach=2.0), OdometryTrack(0)
    beside = np.full(BEAMS, np.inf)
    beside[300:] = 0.5
    for number in range(200):
        echoes.update(half_scan(beside, number * 100_000_000), track)
        turn(track, -0.3 if number % 2 else 0.3)
    assert len(echoes.points(track.odom_T_base)) < 120


def test_what_is_too_near_and_out_of_view_is_forgotten_in_time_as_well() -> None:
    echoes, track = NearEchoes(Pose2D(0.0, 0.0, 0.0), reach=2.0), OdometryTrack(0)
    echoes.update(half_scan(one_echo(180, 0.16), 0), track)
    turn(track, math.pi)
    nothing = np.full(BEAMS, np.inf)
    echoes.update(half_scan(nothing, 29_000_000_000), track)
    assert len(echoes.points(track.odom_T_base)) == 1
    echoes.update(half_scan(nothing, 31_000_000_000), track)
    assert len(echoes.points(track.odom_T_base)) == 0
