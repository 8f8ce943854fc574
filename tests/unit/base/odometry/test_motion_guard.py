"""Motions that a robot can do are believed, leaps are not, whatever comes after them."""

import math

import pytest

from trolley.geometry import Pose2D, Twist2D, exp_twist
from trolley_base.drivers import MotionSample
from trolley_base.odometry.motion_guard import MotionGuard

START_NS = 1_764_000_000_000_000_000  # as long after 1970 as real stamps are
STEP_NS = 50_000_000


class Board:
    """One that reports 20 times a second, and whom nobody need believe."""

    def __init__(self) -> None:
        self.guard = MotionGuard(START_NS)
        self.now_ns = START_NS

    def reports(self, vx: float, wz: float = 0.0, step_ns: int = STEP_NS) -> bool:
        """Whether the motion of the next interval is believed."""
        self.now_ns += step_ns
        twist = Twist2D(vx, 0.0, wz)
        return self.guard.accepts(
            MotionSample(self.now_ns, exp_twist(twist, step_ns * 1e-9), twist)
        )


@pytest.mark.parametrize(
    "motion",
    [
        Pose2D(0.5, 0.0, 0.0),
        Pose2D(0.0, -50.0, 0.0),
        Pose2D(0.0, 0.0, 2.0),
        Pose2D(math.nan, 0.0, 0.0),
        Pose2D(0.0, math.inf, 0.0),
    ],
)
def test_a_motion_that_no_robot_can_do_is_refused(motion: Pose2D) -> None:
    guard = MotionGuard(START_NS)
    assert not guard.accepts(MotionSample(START_NS + STEP_NS, motion, Twist2D.zero()))


def test_a_motion_from_the_past_is_refused_and_a_quick_one_is_not() -> None:
    motion = exp_twist(Twist2D(2.0, 0.0, 4.0), STEP_NS / 1e9)
    assert not MotionGuard(START_NS).accepts(MotionSample(START_NS - 1, motion, Twist2D.zero()))
    assert MotionGuard(START_NS).accepts(MotionSample(START_NS + STEP_NS, motion, Twist2D.zero()))


@pytest.mark.parametrize(("vx", "wz"), [(5.0, 0.0), (-5.0, 0.0), (0.3, 11.0), (0.3, -11.0)])
def test_a_leap_that_fits_neither_before_nor_after_is_refused(vx: float, wz: float) -> None:
    board = Board()
    believed = [
        board.reports(vx, wz) if step % 6 == 5 else board.reports(0.3) for step in range(60)
    ]
    assert [step for step, is_believed in enumerate(believed) if not is_believed] == list(
        range(5, 60, 6)
    )


def test_leaps_are_refused_for_as_long_as_they_come() -> None:
    board = Board()
    assert not any(board.reports(9.9) for _ in range(50))
    assert board.reports(0.3)


def test_who_rolls_fast_when_the_board_is_heard_first_is_believed_from_the_second_time() -> None:
    board = Board()
    assert [board.reports(4.0, 6.0) for _ in range(4)] == [False, True, True, True]


@pytest.mark.parametrize("step_ns", [2_000_000, 10_000_000, STEP_NS, 200_000_000, 3_000_000_000])
def test_what_robots_and_hands_do_is_believed(step_ns: int) -> None:
    board = Board()
    for vx, wz in ((2.0, 0.0), (0.0, 0.0), (-1.5, 3.0), (1.5, -3.0), (0.0, 0.0), (0.02, -0.6)):
        way, turn = 0.0, 0.0
        for _ in range(max(1, round(0.4e9 / step_ns))):
            way += max(-1.0, min(1.0, vx - way))
            turn += max(-3.0, min(3.0, wz - turn))
            assert board.reports(way, turn, step_ns)
        assert board.reports(0.0, 0.0, step_ns), "somebody holds it"
