"""A gyro that measures the wrong thing is named, and not used for the heading."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from trolley_base.odometry.gyro_check import GyroCheck, GyroTrouble
from trolley_base.odometry.yaw_fusion import YawFusion

STEP_NS, STEP_S = 50_000_000, 0.05

KINDS: dict[str, tuple[Callable[[float], float], GyroTrouble | None]] = {
    "as it should be": (lambda rate: rate, None),
    "a bit off": (lambda rate: 0.9 * rate + 0.05, None),
    "the wrong sign": (lambda rate: -rate, GyroTrouble.REVERSED),
    "degrees": (lambda rate: math.degrees(rate + 0.01), GyroTrouble.DEGREES),
    "lifted": (lambda _: 0.02, GyroTrouble.STILL),
}


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_wrong_is_known_after_a_turn(kind: str) -> None:
    reads, wanted = KINDS[kind]
    fusion, rng = YawFusion(0.03), np.random.default_rng(3)
    rates = [0.0] * 80 + [0.8] * 60 + [0.0] * 20 + [-0.8] * 60
    for index, rate in enumerate(rates):
        end_ns = (index + 1) * STEP_NS
        fusion.add_gyro(end_ns, reads(rate) + 0.002 * rng.normal())
        turn = fusion.fuse(end_ns - STEP_NS, end_ns, 0.0, rate * STEP_S)
        if wanted is not None:
            assert turn == pytest.approx(rate * STEP_S, abs=0.3 * abs(rate) * STEP_S + 1e-9)
    assert fusion.trouble is wanted


def test_a_robot_that_only_drives_straight_says_nothing_of_its_gyro() -> None:
    check = GyroCheck()
    for _ in range(1000):
        check.add(0.001, -0.001, STEP_S)
    assert check.trouble is None


def test_a_robot_that_is_set_down_again_trusts_its_gyro_after_some_turns() -> None:
    check = GyroCheck()
    for turned in (0.0, 0.04):
        for _ in range(400):
            check.add(0.04, turned, STEP_S)
        assert (check.trouble is None) == (turned > 0.0)


def test_a_robot_that_is_lifted_is_known_after_a_moment_of_turning() -> None:
    check = GyroCheck()
    for _ in range(400):
        check.add(0.05, 0.05, STEP_S)
    moments = 0
    while check.trouble is not GyroTrouble.STILL and moments < 100:
        check.add(0.05, 0.001, STEP_S)
        moments += 1
    assert moments * STEP_S <= 1.0, "at 1 rad/s"
    for _ in range(20):
        check.add(0.05, 0.05, STEP_S)
    assert check.trouble is None
