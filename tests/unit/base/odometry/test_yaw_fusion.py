"""Fusing the turn of wheels and gyro: judged by the heading at the end of a simulated drive."""

import dataclasses
import math
from collections.abc import Callable

import numpy as np
import pytest

from trolley_base.odometry.yaw_fusion import GyroState, YawFusion

STEP_NS = 50_000_000
STEP_S = STEP_NS * 1e-9
START_NS = 1_764_000_000_000_000_000
SKID_SLIP = 0.12

Gyro = Callable[[float, float], float]
"""What the gyro reads, of time since the start [s] and true turn rate [rad/s]."""


@dataclasses.dataclass
class Outcome:
    fused_error: float
    wheels_error: float
    states: list[GyroState]
    bias: float | None


def turn_rates(seconds: float, rest_s: float) -> np.ndarray:
    """Rest, then turns and straights of a robot in rooms, more to the left than to the right."""
    times = np.arange(0.0, seconds, STEP_S)
    rates = 0.5 * np.sin(0.9 * times) + 0.3 * np.sign(np.sin(0.37 * times)) + 0.1
    return np.where(times < rest_s, 0.0, rates)


def drive(
    gyro: Gyro,
    rest_s: float = 4.0,
    seconds: float = 120.0,
    wheel_share: float = 1.1,
    lag_ns: int = 13_000_000,
) -> Outcome:
    """Wheels report `wheel_share` of each turn; gyro samples are stamped beside the wheels'."""
    fusion = YawFusion(SKID_SLIP)
    rng = np.random.default_rng(5)
    true_yaw = wheels_yaw = fused_yaw = 0.0
    states: list[GyroState] = []
    for index, rate in enumerate(turn_rates(seconds, rest_s).tolist()):
        start_ns = START_NS + index * STEP_NS
        end_ns = start_ns + STEP_NS
        fusion.add_gyro(end_ns - lag_ns, gyro(index * STEP_S, rate) + 0.002 * rng.normal())
        wheel_turn = wheel_share * rate * STEP_S
        way = 0.0 if rate == 0.0 else 0.2 * STEP_S
        fused_yaw += fusion.fuse(start_ns, end_ns, way, wheel_turn)
        wheels_yaw += wheel_turn
        true_yaw += rate * STEP_S
        states.append(fusion.state)
    return Outcome(abs(fused_yaw - true_yaw), abs(wheels_yaw - true_yaw), states, fusion.bias)


def test_a_biased_gyro_makes_the_heading_of_a_slipping_robot_much_better() -> None:
    outcome = drive(lambda _, rate: rate + 0.05)
    assert outcome.bias == pytest.approx(0.05, abs=0.002)
    assert outcome.wheels_error > 0.8
    assert outcome.fused_error < 0.2 * outcome.wheels_error


def test_a_gyro_that_was_never_measured_at_rest_is_not_used() -> None:
    outcome = drive(lambda _, rate: rate + 0.05, rest_s=0.0)
    assert outcome.bias is None
    assert outcome.fused_error == outcome.wheels_error


RUBBISH: dict[str, Gyro] = {
    "noise": lambda at_s, _: 3.0 * math.sin(1e4 * at_s * at_s),
    "reversed": lambda _, rate: -rate,
    "degrees": lambda _, rate: math.degrees(rate),
    "another axis": lambda _, __: 0.0,
    "not a number": lambda _, __: math.nan,
    "saturated": lambda at_s, rate: rate if at_s < 20.0 else 4.36,
    "broken off": lambda at_s, rate: 0.1 if at_s < 4.0 else rate + 2.0 * math.sin(at_s),
}


@pytest.mark.parametrize("kind", RUBBISH)
@pytest.mark.parametrize("wheel_share", [1.0, 1.1])
def test_a_gyro_that_measures_rubbish_is_no_worse_than_none(kind: str, wheel_share: float) -> None:
    outcome = drive(RUBBISH[kind], wheel_share=wheel_share)
    assert outcome.fused_error <= outcome.wheels_error + 0.05


def test_a_reversed_gyro_is_reported() -> None:
    assert GyroState.DISAGREES in drive(RUBBISH["reversed"]).states


def test_a_gyro_that_falls_silent_leaves_the_wheels_at_once() -> None:
    fusion = YawFusion(SKID_SLIP)
    outcome_states: list[GyroState] = []
    for index, rate in enumerate(turn_rates(60.0, 4.0).tolist()):
        start_ns = START_NS + index * STEP_NS
        if index * STEP_S < 40.0:
            fusion.add_gyro(start_ns + STEP_NS, rate + 1e-4 * (index % 7))
        turn = fusion.fuse(start_ns, start_ns + STEP_NS, 0.01 * (rate != 0.0), 1.1 * rate * STEP_S)
        outcome_states.append(fusion.state)
        if index * STEP_S > 40.2:
            assert turn == 1.1 * rate * STEP_S
    assert GyroState.USED in outcome_states
    assert outcome_states[-1] is GyroState.SILENT


def test_a_gyro_that_repeats_one_value_is_stuck() -> None:
    fusion = YawFusion(SKID_SLIP)
    for index in range(100):
        end_ns = START_NS + (index + 1) * STEP_NS
        fusion.add_gyro(end_ns, 0.0)
        assert fusion.fuse(end_ns - STEP_NS, end_ns, 0.0, 0.01) == 0.01
    assert fusion.state is GyroState.STUCK


def test_a_gyro_that_reads_zero_while_hardly_anything_turns_is_not_stuck() -> None:
    """As a board's that reports no turn below 0.01 rad/s."""
    fusion = YawFusion(SKID_SLIP)
    states: list[GyroState] = []
    for index in range(600):
        rate = 0.5 if index % 200 > 120 else 0.0
        end_ns = START_NS + (index + 1) * STEP_NS
        fusion.add_gyro(end_ns, rate + 1e-3 * (index % 7) if rate else 0.0)
        fusion.fuse(end_ns - STEP_NS, end_ns, 0.01, (rate + 0.005) * STEP_S)
        states.append(fusion.state)
    assert GyroState.STUCK not in states


@pytest.mark.parametrize("gap_s", [0.3, 0.8, 2.0])
def test_a_turn_in_which_the_gyro_was_not_heard_is_that_of_the_wheels(gap_s: float) -> None:
    fusion = YawFusion(SKID_SLIP)
    rng = np.random.default_rng(2)
    end_ns = START_NS
    for rate in turn_rates(60.0, 4.0).tolist():
        end_ns += STEP_NS
        fusion.add_gyro(end_ns, rate + 0.002 * float(rng.normal()))
        way_m = 0.01 if rate else 0.0
        fusion.fuse(end_ns - STEP_NS, end_ns, way_m, rate * STEP_S)
    assert fusion.state is GyroState.USED
    start_ns, end_ns = end_ns, end_ns + round(gap_s * 1e9)
    fusion.add_gyro(end_ns, 1.0)
    # It stood, then turned: nobody knows since when.
    assert fusion.gyro_rate(start_ns, end_ns) is None
    assert fusion.fuse(start_ns, end_ns, 0.0, 0.2) == 0.2
    assert fusion.state is GyroState.SILENT


@pytest.mark.parametrize("rate", [0.05, 0.2])
def test_who_is_turned_by_hand_does_not_rest(rate: float) -> None:
    """The wheels stand all the time; in the middle somebody turns the robot evenly."""
    fusion = YawFusion(SKID_SLIP)
    rng = np.random.default_rng(3)
    for index in range(400):
        end_ns = START_NS + (index + 1) * STEP_NS
        carried = rate if 120 <= index < 180 else 0.0
        fusion.add_gyro(end_ns, 0.05 + carried + 0.002 * rng.normal())
        assert fusion.fuse(end_ns - STEP_NS, end_ns, 0.0, 0.0) == 0.0
    assert fusion.bias == pytest.approx(0.05, abs=0.002)
