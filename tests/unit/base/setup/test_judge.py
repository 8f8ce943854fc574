"""What is wrong with a drive while it goes on, and what is not."""

from contextlib import nullcontext

import numpy as np
import pytest

from trolley.geometry import Twist2D
from trolley_base.setup.clearance import Mount
from trolley_base.setup.judge import Judge
from trolley_base.setup.motion import LidarTrack, WheelCount
from trolley_base.setup.record import Command, Record, SetupRefused


@pytest.mark.parametrize(
    ("turning", "runs_away"), [(-0.55, False), (-2.0, True)], ids=["uneven wheels", "running away"]
)
def test_wheels_that_differ_may_turn_a_robot_that_is_told_to_go_straight(
    turning: float, runs_away: bool
) -> None:
    record = Record(commands=[Command(0, Twist2D(-0.5, 0.0, 0.05))])
    judge = Judge(0.1, LidarTrack(), WheelCount(), Mount(), record)
    with pytest.raises(SetupRefused, match="faster than told") if runs_away else nullcontext():
        for number in range(5):
            judge.refuse_too_fast(Twist2D(-0.5, 0.0, turning), number * 100_000_000, 0.5)


@pytest.mark.parametrize(
    ("turn_rad", "most"), [(2.2, 1), (1.24, 2)], ids=["sees all round", "looks ahead only"]
)
def test_one_wall_alone_may_be_seen_over_part_of_a_round(turn_rad: float, most: int) -> None:
    judge = Judge(0.1, LidarTrack(), WheelCount(), Mount(), Record())
    for is_plain in [True] * most + [False] + [True] * most:
        judge.refuse_plain(turn_rad, is_plain=is_plain)
    with pytest.raises(SetupRefused, match="plain corridor"):
        judge.refuse_plain(-turn_rad, is_plain=True)


def test_once_it_drives_one_wall_alone_may_be_seen_once() -> None:
    mount = Mount(ahead=np.array([1.0, 0.0]))
    judge = Judge(0.1, LidarTrack(), WheelCount(), mount, Record())
    for is_plain in (True, False, True):
        judge.refuse_plain(0.0, is_plain=is_plain)
    with pytest.raises(SetupRefused, match="plain corridor"):
        judge.refuse_plain(0.0, is_plain=True)
