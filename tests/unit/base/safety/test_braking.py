"""Where a robot comes to before it stands."""

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from trolley.geometry import Twist2D
from trolley_base.safety.braking import PARAMS, CommandsUnderWay, along, braking_steps
from trolley_base.safety.motion_limits import MotionLimits

LIMITS = MotionLimits(
    speed=2.0, wz=2.0, acceleration=1.0, deceleration=1.0, angular_acceleration=4.0
)
PERIOD = 0.02


def driven(delay_s: float, *commands: tuple[Twist2D, int]) -> CommandsUnderWay:
    under_way = CommandsUnderWay(delay_s, LIMITS)
    for twist, count in commands:
        for _ in range(count):
            under_way.add(twist, PERIOD)
    return under_way


def test_nothing_is_under_way_at_first_nor_after_standing_for_long() -> None:
    for under_way in (driven(0.2), driven(0.2, (Twist2D(0.1, 0.0, 0.0), 5), (Twist2D.zero(), 50))):
        poses, _ = under_way.paths(0.01)
        assert under_way.is_standing
        assert np.all(poses == 0.0)


def test_what_is_under_way_is_what_was_commanded_during_the_delay() -> None:
    poses, slowest = driven(0.2, (Twist2D(0.5, 0.0, 0.0), 30)).paths(0.01)
    assert poses[0, -1] == pytest.approx([0.1, 0.0, 0.0, 0.1])
    assert slowest.tolist() == [True], "driven evenly, all delays and brakes are one path"


def test_an_arc_ends_where_arcs_end() -> None:
    steps = np.tile([0.01, 0.0, 0.02], (1, 50, 1))
    end = along(np.zeros((1, 4)), steps)[0, -1]
    radius = 0.01 / 0.02
    assert end[:2] == pytest.approx(
        [radius * math.sin(1.0), radius * (1 - math.cos(1.0))], rel=1e-4
    )
    assert end[2:] == pytest.approx([1.0, 0.5])


def test_a_sudden_stop_may_still_be_driven_slowly_or_promptly() -> None:
    poses, slowest = driven(0.2, (Twist2D(0.5, 0.0, 0.0), 30), (Twist2D.zero(), 10)).paths(0.01)
    ways = dict(zip(slowest.tolist(), poses[:2, -1, 0].tolist(), strict=False))
    assert ways[False] == pytest.approx(0.0)
    assert 0.05 < ways[True] < 0.1


twists = st.builds(Twist2D, st.floats(-2.0, 2.0), st.just(0.0), st.floats(-2.0, 2.0))


@given(twists, twists, st.floats(0.005, 0.5))
def test_at_the_slowest_wheels_lose_as_much_as_the_brakes_surely_take(
    now: Twist2D, wanted: Twist2D, seconds: float
) -> None:
    under_way = driven(0.2, (now, 12))
    vx, _, wz = under_way.at_slowest(np.array([[wanted.vx, 0.0, wanted.wz]]), seconds)[0]
    for slowest, before, after, rate in (
        (vx, now.vx, wanted.vx, LIMITS.deceleration),
        (wz, now.wz, wanted.wz, LIMITS.angular_acceleration),
    ):
        most = rate * seconds if before * after < before * before else math.inf
        assert slowest == pytest.approx(before + np.clip(after - before, -most, most))
    for _ in range(115):  # 2 s of braking, and the delay
        under_way.add(Twist2D.zero(), PERIOD)
    assert under_way.is_standing


def test_before_it_turns_back_every_delay_has_its_own_path() -> None:
    poses, _ = driven(0.2, (Twist2D(0.1, 0.0, 0.0), 30), (Twist2D(-0.1, 0.0, 0.0), 5)).paths(0.01)
    ends = poses[:, -1, 0]
    assert ends.max() > 0.0 > ends.min()


@given(vx=st.floats(-2.0, 2.0), wz=st.floats(-2.0, 2.0))
@example(vx=0.0, wz=2.0)
def test_it_brakes_over_the_way_of_even_braking(vx: float, wz: float) -> None:
    steps = braking_steps(np.array([[vx, 0.0, wz]]), LIMITS, 0.05)[0]
    way, turn = steps[0].sum(axis=0)[[0, 2]]
    assert way == pytest.approx(vx * PERIOD + 0.5 * vx * abs(vx), abs=1e-9)
    assert turn == pytest.approx(wz * PERIOD + 0.5 * wz * abs(wz) / 4.0, abs=1e-9)
    # Two poses are no farther apart than they may be, but for the period before it brakes.
    assert np.all(np.abs(steps[:, 1:, 0]) <= 0.1 + 1e-9)
    assert np.all(np.abs(steps[:, 1:, 2]) <= 2.0 * PARAMS.turn_rad + 1e-9)


def test_the_paths_fan_out_from_straight_ahead_to_a_turn_in_place() -> None:
    steps = braking_steps(np.array([[1.0, 0.0, 1.0]]), LIMITS, 0.05)[0]
    ways, turns = np.abs(steps).sum(axis=1)[:, [0, 2]].T
    assert ways.max() > 0.5
    assert ways.min() < 0.05
    assert turns.max() > 0.1
    assert turns.min() < 0.03
