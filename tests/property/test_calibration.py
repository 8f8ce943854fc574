"""From drives with planted errors the estimate finds them again."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.cases import cases

from trolley.geometry import Pose2D, exp_twist
from trolley.geometry import Twist2D as Twist
from trolley_base.calibration import (
    Benchmark,
    Correction,
    Leg,
    Return,
    benchmark,
    combined,
    estimate,
    square,
)
from trolley_base.calibration.report import describe_estimate, is_right, usable
from trolley_base.odometry.wheel_scales import WheelScales

TRACK_M = 0.2
planted = st.builds(Correction, st.floats(0.9, 1.1), st.floats(0.9, 1.1), st.floats(-0.4, 0.4))


def square_steps(direction: str, side_m: float) -> np.ndarray:
    """Small arcs of a square that closes by odometry, (n, 3)."""
    rows: list[tuple[float, float, float]] = []
    at = Pose2D.identity()
    for place in square(side_m, direction):  # pyrefly: ignore[bad-argument-type]
        step = at.inverse() @ place.pose
        rows += [(step.x / 40, 0.0, step.yaw / 40)] * 40
        at = place.pose
    return np.array(rows)


def legs_of(steps: np.ndarray, truth: Correction, count: int) -> list[Leg]:
    return [Leg(part, truth.integrate(part), 0.01, 0.01) for part in np.array_split(steps, count)]


@given(st.lists(st.tuples(st.floats(-0.1, 0.1), st.floats(-0.3, 0.3)), min_size=1, max_size=50))
def test_arcs_joined_at_once_are_arcs_joined_one_by_one(arcs: list[tuple[float, float]]) -> None:
    one_by_one = Pose2D.identity()
    for way, turn in arcs:
        one_by_one = one_by_one @ exp_twist(Twist(way, 0.0, turn))
    at_once = Correction().integrate(np.array([(way, 0.0, turn) for way, turn in arcs]))
    assert at_once.distance_to(one_by_one) < 1e-9
    assert math.cos(at_once.yaw - one_by_one.yaw) == pytest.approx(1.0)


@given(planted)
@settings(max_examples=cases(30))
def test_legs_measured_without_noise_give_the_planted_errors(truth: Correction) -> None:
    legs = legs_of(square_steps("ccw", 1.0), truth, 8) + legs_of(square_steps("cw", 1.0), truth, 8)
    found = estimate(legs).correction
    assert found.linear == pytest.approx(truth.linear, abs=2e-4)
    assert found.angular == pytest.approx(truth.angular, abs=2e-4)
    assert found.bend == pytest.approx(truth.bend, abs=2e-4)


@given(st.floats(0.93, 1.07), st.floats(-0.25, 0.25))
@settings(max_examples=cases(30))
def test_ends_of_squares_alone_give_turn_and_bend(angular: float, bend: float) -> None:
    """As a person measures: no heading, and the robot starts each square anew."""
    truth = Correction(1.0, angular, bend)
    legs = [
        Leg(steps, truth.integrate(steps), 0.005, math.inf)
        for steps in (square_steps("ccw", 1.5), square_steps("cw", 1.5))
    ]
    found = estimate(legs, by_hand=True)
    assert found.correction.linear == 1.0
    assert found.correction.angular == pytest.approx(angular, abs=3e-3)
    assert found.correction.bend == pytest.approx(bend, abs=3e-3)


@given(st.floats(-0.005, 0.005), st.floats(-0.02, 0.02))
def test_umbmark_finds_small_errors(short: float, bend: float) -> None:
    truth = Correction(1.0, 1.0 - short, bend)
    returns = []
    for direction in ("ccw", "cw"):
        steps = square_steps(direction, 2.0)
        returns.append(Return(direction, truth.integrate(steps), Correction().integrate(steps)))
    figures = benchmark(returns, 2.0)
    assert 1.0 / figures.track_ratio == pytest.approx(1.0 - short, abs=1e-3)
    scales = combined(truth, WheelScales(track_m=TRACK_M))
    assert figures.wheel_ratio(2.0, TRACK_M) == pytest.approx(scales.wheel_ratio, abs=1e-3)


@given(planted, planted)
def test_what_is_found_is_joined_with_what_is_in_force(first: Correction, then: Correction) -> None:
    """Two calibrations in a row are one with the product."""
    in_force = combined(first, WheelScales(track_m=TRACK_M))
    both = combined(then, in_force)
    reported = Twist(0.3, 0.0, 0.0)
    between = in_force.true_twist(reported)
    true = both.true_twist(reported)
    assert true.vx == pytest.approx(then.linear * between.vx)
    assert true.wz == pytest.approx(then.angular * between.wz + then.bend * between.vx)


def test_a_wrong_pose_among_many_counts_for_little() -> None:
    truth = Correction(1.05, 0.96, 0.1)
    legs = legs_of(square_steps("ccw", 1.0), truth, 8) + legs_of(square_steps("cw", 1.0), truth, 8)
    bad = legs[3]
    wrong = bad.start_T_end @ Pose2D(0.5, -0.3, 0.7)
    legs[3] = Leg(bad.steps, wrong, bad.error_m, bad.error_rad)
    found = estimate(legs).correction
    assert found.linear == pytest.approx(truth.linear, abs=0.005)
    assert found.angular == pytest.approx(truth.angular, abs=0.005)
    assert found.bend == pytest.approx(truth.bend, abs=0.02)


def seen_by(lidar: Pose2D, legs: list[Leg]) -> list[Leg]:
    """The legs as a localizer sees them whose lidar sits otherwise than it believes."""
    return [
        Leg(leg.steps, lidar.inverse() @ leg.start_T_end @ lidar, leg.error_m, leg.error_rad)
        for leg in legs
    ]


@given(planted, st.floats(-0.3, 0.3), st.floats(-0.1, 0.1), st.floats(-0.1, 0.1))
@settings(max_examples=cases(30))
def test_a_lidar_that_sits_otherwise_is_told_from_the_wheels(
    truth: Correction, yaw: float, x: float, y: float
) -> None:
    legs = legs_of(square_steps("ccw", 1.0), truth, 8) + legs_of(square_steps("cw", 1.0), truth, 8)
    found = estimate(seen_by(Pose2D(x, y, yaw), legs))
    assert found.correction.linear == pytest.approx(truth.linear, abs=0.003)
    assert found.correction.angular == pytest.approx(truth.angular, abs=0.003)
    assert found.correction.bend == pytest.approx(truth.bend, abs=0.01)
    assert found.lidar.yaw == pytest.approx(yaw, abs=0.01)
    assert found.lidar.distance_to(Pose2D(x, y, 0.0)) < 0.01
    said = "\n".join(describe_estimate(found))
    assert ("lidar sits otherwise" in said) or max(abs(yaw), abs(x), abs(y)) < 0.03


def slipping(rng: np.random.Generator, share: float) -> list[Leg]:
    legs = legs_of(square_steps("ccw", 1.0), Correction(), 8)
    legs += legs_of(square_steps("cw", 1.0), Correction(), 8)
    return [
        Leg(leg.steps, leg.start_T_end @ Pose2D(*rng.normal(0.0, share, 3)), 0.01, 0.01)
        for leg in legs
    ]


def test_wheels_that_slip_are_not_called_too_few_straight_stretches() -> None:
    found = estimate(slipping(np.random.default_rng(1), 0.1))
    assert usable(found) == Correction()
    said = "\n".join(describe_estimate(found))
    assert "slipped" in said
    assert "too few" not in said


def test_a_correction_that_spoils_the_squares_is_worse() -> None:
    def ends(angular: float) -> Benchmark:
        returns = [
            Return(direction, Pose2D.identity(), Correction(1.0, angular).integrate(steps))
            for direction in ("ccw", "cw")
            for steps in [square_steps(direction, 1.0)]
        ]
        return benchmark(returns, 1.0)

    assert ends(0.97).is_worse_than(ends(1.0))
    assert not ends(1.001).is_worse_than(ends(1.0))
    assert not ends(1.0).is_worse_than(ends(0.97))


def test_errors_within_what_they_may_be_are_no_errors() -> None:
    assert is_right(estimate(slipping(np.random.default_rng(1), 0.005)))
    wide = legs_of(square_steps("ccw", 1.0), Correction(1.0, 0.96, 0.0), 8)
    assert not is_right(estimate(wide))


def test_a_drive_without_turns_says_that_it_knows_nothing_of_turning() -> None:
    straight = np.tile([0.02, 0.0, 0.0], (50, 1))
    found = estimate([Leg(straight, Pose2D(1.05, 0.0, 0.0), 0.01, 0.01)] * 6)
    assert found.correction.linear == pytest.approx(1.05, abs=0.002)
    assert found.linear_std < 0.01
    assert found.angular_std > 0.1
