"""What counts as progress, and what as trouble."""

import math

import pytest
from support.flatland import Flatland, Ice, empty_room

from trolley import codes
from trolley.config import PlannerConfig
from trolley.geometry import Pose2D
from trolley_planner.driving.progress_checker import ProgressChecker

START = Pose2D(1.0, 3.0, 0.0)
SECOND_NS = 1_000_000_000


def test_wheels_that_slip_are_noticed(ride) -> None:
    drive = ride(Ice(empty_room(), START))
    drive.send(Pose2D(5.0, 3.0, 0.0))
    drive.until(lambda: drive.navigator.current.board.state == "recovering", 30.0)
    assert drive.navigator.current.board.reason == codes.SLIP


def test_progress_is_getting_nearer_or_turning() -> None:
    checker = ProgressChecker(PlannerConfig(progress_s=5.0, progress_distance_m=0.2))
    pose = Pose2D(0.0, 0.0, 0.0)
    for second in range(20):
        assert checker.check(second * SECOND_NS, 10.0 - 0.1 * second, pose, pose) is None
    checker.reset()
    for second in range(12):
        turned = Pose2D(0.0, 0.0, 0.2 * second)
        assert checker.check(second * SECOND_NS, 8.0, turned, turned) is None


@pytest.mark.parametrize("speed", [0.02, 0.01])
def test_a_robot_that_is_told_to_creep_is_not_held_up(ride, speed: float) -> None:
    drive = ride(Flatland(empty_room(), START))
    drive.send(Pose2D(1.8, 3.0, 0.0), speed=speed)
    assert drive.until_over(200.0).state == "arrived"
    assert drive.navigator.current.status(drive.now_ns).recoveries == 0
    assert {status.state for status in drive.statuses} <= {"idle", "planning", "driving", "arrived"}


@pytest.mark.parametrize("turn_radps", [0.05, 0.01])
def test_a_robot_that_turns_slowly_is_not_held_up(turn_radps: float) -> None:
    checker = ProgressChecker(PlannerConfig(progress_s=6.0))
    for second in range(round(3.0 / turn_radps)):
        pose = Pose2D(0.0, 0.0, turn_radps * second)
        now_ns = second * SECOND_NS
        assert checker.check(now_ns, 5.0, pose, pose, max_turn=turn_radps) is None


def test_standing_going_to_and_fro_and_spinning_are_told_apart() -> None:
    def first_trouble(pose_at, odom_at) -> str | None:
        checker = ProgressChecker(PlannerConfig(progress_s=5.0))
        for step in range(2000):
            time_s = 0.1 * step
            now_ns = round(time_s * SECOND_NS)
            found = checker.check(now_ns, 5.0, pose_at(time_s), odom_at(time_s))
            if found is not None:
                return found
        return None

    def stand(_: float) -> Pose2D:
        return Pose2D(0.0, 0.0, 0.0)

    def sway(time_s: float) -> Pose2D:
        return Pose2D(0.3 * math.sin(2.0 * time_s), 0.0, 0.0)

    def go(time_s: float) -> Pose2D:
        return Pose2D(0.2 * time_s, 0.0, 0.0)

    def spin(time_s: float) -> Pose2D:
        return Pose2D(0.0, 0.0, math.remainder(1.0 * time_s, 2.0 * math.pi))

    assert first_trouble(stand, stand) == codes.BLOCKED
    assert first_trouble(sway, sway) == codes.OSCILLATION
    assert first_trouble(stand, go) == codes.SLIP
    assert first_trouble(spin, spin) == codes.BLOCKED
