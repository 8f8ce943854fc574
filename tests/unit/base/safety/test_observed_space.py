import dataclasses
import math

import numpy as np
import pytest
from numpy.typing import NDArray

from trolley.geometry import Pose2D, Twist2D, footprint_from_box
from trolley_base.drivers import LidarScan, MotionSample
from trolley_base.odometry.track import OdometryTrack
from trolley_base.safety.observed_space import PARAMS, ObservedSpace

S = 1_000_000_000
FOOTPRINT = footprint_from_box(0.3, 0.24)
CENTRE = Pose2D.identity()
REACH = 1.0


def scan_of(
    ranges: NDArray[np.float64], stamp_ns: int = 0, view: float = 2.0 * math.pi
) -> LidarScan:
    return LidarScan(
        stamp_ns=stamp_ns,
        angle_min=-0.5 * view,
        angle_increment=view / len(ranges),
        time_increment=0.0,
        range_min=0.1,
        range_max=8.0,
        ranges=ranges.astype(np.float32),
    )


def open_all_round(beams: int = 360) -> NDArray[np.float64]:
    return np.full(beams, 3.0)


class Robot:
    """A robot with a lidar, whose odometry is exact."""

    def __init__(self) -> None:
        self.track = OdometryTrack(0)
        self.space = ObservedSpace(FOOTPRINT, CENTRE, REACH)

    def see(
        self, ranges: NDArray[np.float64], seconds: float = 0.1, view: float = 2.0 * math.pi
    ) -> None:
        self.move(0.0, 0.0, seconds)
        self.space.update(scan_of(ranges, self.track.stamp_ns, view), self.track)

    def move(self, metres: float, radians: float, seconds: float) -> None:
        stamp_ns = self.track.stamp_ns + round(seconds * S)
        self.track.add(MotionSample(stamp_ns, Pose2D(metres, 0.0, radians), Twist2D.zero()))

    def sees(self, x: float, y: float) -> bool:
        """Whether the floor there, in `base_link`, is known to be free."""
        unseen = self.space.unseen(self.track.odom_T_base)
        return not _is_among(unseen.points[~unseen.may_creep], x, y)

    def saw_something(self, x: float, y: float) -> bool:
        """Whether something stood there when the lidar last looked, a while ago."""
        unseen = self.space.unseen(self.track.odom_T_base)
        return _is_among(unseen.points[unseen.was_echo], x, y)

    def sees_lately(self, x: float, y: float) -> bool:
        """Whether it was seen in the last few seconds."""
        return not _is_among(self.space.unseen(self.track.odom_T_base).points, x, y)


def _is_among(points: NDArray[np.float64], x: float, y: float) -> bool:
    return bool(np.any(np.abs(points - [x, y]).max(axis=1) <= 0.75 * PARAMS.cell_m))


@pytest.fixture
def robot() -> Robot:
    return Robot()


def test_where_nothing_comes_back_from_a_program_may_creep_if_the_lidar_counts_that() -> None:
    ranges = open_all_round()
    ranges[160:201] = 0.0
    silent = np.zeros(360, np.bool_)
    silent[160:180] = True  # ahead to the right; to the left a mask, or frames that are lost
    robot = Robot()
    robot.space.update(dataclasses.replace(scan_of(ranges), silent=silent), robot.track)
    assert robot.sees(0.8, -0.08)
    assert not robot.sees(0.8, 0.2)
    assert not robot.sees_lately(0.8, -0.08)
    robot.see(ranges, 0.6)
    assert not robot.sees(0.8, -0.08)


def test_before_the_first_scan_nothing_is_said(robot: Robot) -> None:
    assert len(robot.space.unseen(CENTRE).points) == 0


def test_what_beams_pass_is_seen_and_what_lies_far_behind_an_echo_is_not(robot: Robot) -> None:
    ranges = open_all_round()
    ranges[170:190] = 0.5
    robot.see(ranges)
    assert robot.sees(0.4, 0.0)
    assert robot.sees(0.6, 0.0), "there the stop field keeps the robot from the echo"
    assert not robot.sees(0.77, 0.0)
    assert robot.sees(-0.77, 0.0)


def test_without_an_echo_in_reach_all_is_free(robot: Robot) -> None:
    robot.see(np.full(360, np.inf))
    assert len(robot.space.unseen(CENTRE).points) == 0


def test_beams_that_failed_say_nothing_and_the_floor_under_the_robot_is_free(robot: Robot) -> None:
    ranges = open_all_round()
    ranges[150:210] = 0.0
    robot.see(ranges)
    assert not robot.sees(0.2, 0.0)
    assert robot.sees(0.1, 0.0)
    assert robot.sees(0.0, 0.4)


@pytest.mark.parametrize(("failed", "seen_to"), [(1, 1.0), (3, 0.7), (5, 0.45)])
def test_in_a_gap_between_beams_nothing_five_centimetres_wide_may_hide(
    robot: Robot, failed: int, seen_to: float
) -> None:
    ranges = open_all_round()
    ranges[180 - failed // 2 : 181 + failed // 2] = 0.0
    robot.see(ranges)
    limit = PARAMS.hidden_m / math.radians(failed + 1)
    assert seen_to < limit
    assert robot.sees(seen_to - 0.05, 0.0)
    if limit < REACH - 0.1:
        assert not robot.sees(limit + 0.08, 0.0)


def test_a_few_beams_that_succeed_among_many_that_fail_are_luck(robot: Robot) -> None:
    ranges = np.zeros(360)
    ranges[::20] = 3.0
    ranges[180:183] = 3.0
    robot.see(ranges)
    assert not robot.sees(0.3, 0.0)
    assert not robot.sees(0.0, 0.3)


def test_what_a_beam_should_see_and_does_not_is_soon_forgotten(robot: Robot) -> None:
    robot.see(open_all_round())
    blind = open_all_round()
    blind[150:210] = 0.0
    for _ in range(4):
        robot.see(blind)
    assert robot.sees(0.5, 0.0)
    for _ in range(2):
        robot.see(blind)
    assert not robot.sees(0.5, 0.0)


def test_what_is_out_of_view_is_remembered_for_a_while(robot: Robot) -> None:
    robot.see(open_all_round())
    for _ in range(29):
        robot.see(open_all_round(180), 1.0, math.pi)
    assert robot.sees(-0.5, 0.0)
    for _ in range(2):
        robot.see(open_all_round(180), 1.0, math.pi)
    assert not robot.sees(-0.5, 0.0)
    assert robot.sees(0.5, 0.0)


def test_what_nobody_looked_at_for_some_seconds_was_free_a_while_ago(robot: Robot) -> None:
    robot.see(open_all_round())
    robot.see(open_all_round(180), 1.0, math.pi)
    robot.see(open_all_round(180), 1.0, math.pi)
    assert robot.sees_lately(-0.5, 0.0)
    robot.see(open_all_round(180), 2.0, math.pi)
    assert not robot.sees_lately(-0.5, 0.0)
    assert robot.sees(-0.5, 0.0)
    assert robot.sees_lately(0.5, 0.0)


def test_where_the_robot_was_is_free_for_longer(robot: Robot) -> None:
    robot.see(open_all_round(180), 0.1, math.pi)
    for _ in range(10):
        robot.move(0.05, 0.0, 0.1)
        robot.see(open_all_round(180), 0.1, math.pi)
    for _ in range(40):
        robot.see(open_all_round(180), 1.0, math.pi)
    assert robot.sees(-0.5, 0.0)
    assert not robot.sees(-0.5, 0.3)


def test_who_steps_into_what_was_seen_is_not_forgotten_as_free(robot: Robot) -> None:
    robot.see(open_all_round())
    ranges = open_all_round()
    ranges[:10] = 0.5
    ranges[-10:] = 0.5
    robot.see(ranges)
    assert robot.sees(-0.5, 0.0), "its echo is there: the stop field's"
    for _ in range(8):
        robot.see(open_all_round(180), 0.1, math.pi)
    assert not robot.sees(-0.53, 0.0), "it may still stand there, though no beam looks any more"
    assert robot.sees(-0.4, 0.0)
    assert robot.saw_something(-0.53, 0.0)
    assert not robot.saw_something(-0.4, 0.0)
    assert not robot.saw_something(-0.9, 0.0), "nobody knows what is behind it"
    robot.see(open_all_round())
    for _ in range(40):
        robot.see(open_all_round(180), 0.1, math.pi)
    assert not robot.saw_something(-0.53, 0.0), "it has gone"


def test_who_steps_onto_the_trail_is_not_forgotten_as_free_either(robot: Robot) -> None:
    robot.see(open_all_round())
    for _ in range(10):
        robot.move(0.05, 0.0, 0.1)
    robot.see(open_all_round())
    ranges = open_all_round()
    ranges[:10] = 0.4
    ranges[-10:] = 0.4
    robot.see(ranges)
    for _ in range(8):
        robot.see(open_all_round(180), 0.1, math.pi)
    assert not robot.sees(-0.45, 0.0)
    assert robot.sees(-0.3, 0.0)


def test_it_is_remembered_in_place_while_the_robot_drives_far(robot: Robot) -> None:
    for _ in range(100):
        robot.move(0.05, 0.01, 0.1)
        robot.see(open_all_round())
    assert len(robot.space.unseen(robot.track.odom_T_base).points) == 0


def test_as_the_robot_turns_a_narrow_view_comes_to_see_all_round(robot: Robot) -> None:
    robot.see(open_all_round(90), 0.1, 0.5 * math.pi)
    assert not robot.sees(-0.5, 0.0)
    for _ in range(16):
        robot.move(0.0, 0.4, 0.1)
        robot.see(open_all_round(90), 0.1, 0.5 * math.pi)
    assert len(robot.space.unseen(robot.track.odom_T_base).points) == 0
