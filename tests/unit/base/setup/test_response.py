"""Delay, acceleration and braking from what wheels count after a step of the command."""

import math
from collections.abc import Sequence

import numpy as np
import pytest

from trolley.geometry import Twist2D, exp_twist
from trolley_base.drivers import MotionSample
from trolley_base.setup.record import Command, Record, SetupRefused
from trolley_base.setup.response import WheelWorth, measure

SPEED, ACCELERATION, BRAKING = 0.35, 0.9, 1.4
HALF_TRACK_M = 0.1
TRUE = WheelWorth(1.0, 1.0, HALF_TRACK_M)
PERIOD_NS = 20_000_000


def drive(
    delay_s: float,
    *,
    period_ns: int = PERIOD_NS,
    strokes: int = 8,
    driven_s: Sequence[float] = (3.0,),
    jitter_s: float = 0.0,
    speeds: Sequence[float] = (SPEED,),
    turn_per_m: float = 0.0,
) -> Record:
    """Strokes to and fro by motors that follow after a delay; reports at the end of each period."""
    record = Record()
    speed, told, way = 0.0, 0.0, 0.0
    rng = np.random.default_rng(1)
    step_ns, now_ns = 1_000_000, 0
    changes: list[tuple[int, float]] = []
    for number in range(strokes):
        start_ns = number * 6_000_000_000 + int(rng.integers(period_ns))
        direction = 1.0 if number % 2 else -1.0
        fast = speeds[number % len(speeds)]
        end_ns = start_ns + round(driven_s[number % len(driven_s)] * 1e9)
        for at_ns, velocity in ((start_ns, direction * fast), (end_ns, 0.0)):
            late_s = delay_s + jitter_s * (number % 5 - 2) / 2.0
            changes.append((at_ns + round(late_s * 1e9), velocity))
            record.commands.append(Command(at_ns, Twist2D(velocity, 0.0, 0.0)))
    while now_ns < strokes * 6_000_000_000:
        now_ns += step_ns
        while changes and changes[0][0] <= now_ns:
            told = changes.pop(0)[1]
        rate = ACCELERATION if abs(told) > abs(speed) else BRAKING
        change = rate * step_ns * 1e-9
        speed += max(-change, min(change, told - speed))
        way += speed * step_ns * 1e-9
        if now_ns % period_ns == 0:
            moved = exp_twist(Twist2D(way, 0.0, turn_per_m * way))
            record.motions.append(MotionSample(now_ns, moved, Twist2D.zero()))
            way = 0.0
    return record


@pytest.mark.parametrize("delay_s", [0.0, 0.12, 0.3])
@pytest.mark.parametrize("period_ns", [PERIOD_NS, 50_000_000])
def test_finds_how_motors_follow(delay_s: float, period_ns: int) -> None:
    found = measure(drive(delay_s, period_ns=period_ns), TRUE)
    assert found.delay.value == pytest.approx(delay_s, abs=0.008)
    assert found.longest_delay_s >= found.delay.value
    assert found.acceleration.value == pytest.approx(ACCELERATION, rel=0.08)
    assert found.braking.value == pytest.approx(BRAKING, rel=0.08)
    way_m = SPEED * delay_s + SPEED**2 / (2.0 * BRAKING)
    assert found.stopping.value == pytest.approx(way_m, rel=0.03)
    assert found.stopping_from(SPEED) == pytest.approx(way_m, rel=0.08)


def test_wheels_that_are_smaller_than_set_brake_less() -> None:
    full, small = measure(drive(0.1), TRUE), measure(drive(0.1), WheelWorth(0.9, 0.9, HALF_TRACK_M))
    assert small.braking.value == pytest.approx(0.9 * full.braking.value)
    assert small.stopping.value == pytest.approx(0.9 * full.stopping.value)


def test_strokes_too_short_for_their_speed_make_no_stop_look_late() -> None:
    record = drive(0.2, strokes=30, driven_s=(0.84, 0.84, 3.0), jitter_s=0.025)
    assert measure(record, TRUE).delay.value == pytest.approx(0.2, abs=0.003)


def test_slower_stops_count_for_what_they_would_be_from_the_highest_speed() -> None:
    found = measure(drive(0.1, strokes=12, speeds=(SPEED, 0.7 * SPEED)), TRUE)
    assert found.speed == pytest.approx(SPEED, rel=0.01)
    assert found.stopping.value == pytest.approx(0.1 * SPEED + SPEED**2 / (2.0 * BRAKING), rel=0.03)


def test_on_an_arc_the_outer_wheel_says_more_of_how_far_it_went() -> None:
    found = measure(drive(0.1, turn_per_m=2.0), WheelWorth(0.9, 1.1, HALF_TRACK_M))
    counted = measure(drive(0.1, turn_per_m=2.0), TRUE)
    # The right wheel counts 1.2 of each metre, the left one 0.8.
    outer = 0.5 * (0.8 * 0.9 + 1.2 * 1.1)
    assert found.stopping.value == pytest.approx(outer * counted.stopping.value)
    assert found.speed == pytest.approx(outer * counted.speed)


def test_how_far_it_takes_to_stop_is_no_surer_than_the_wheels() -> None:
    def said(std: float, slip_m: float) -> float:
        return measure(drive(0.1), WheelWorth(1.0, 1.0, HALF_TRACK_M, std, slip_m)).stopping.std

    way_m = measure(drive(0.1), TRUE).stopping.value
    assert said(0.01, 0.0) == pytest.approx(math.hypot(said(0.0, 0.0), 0.01 * way_m))
    # Eight stops, each of which slides by itself.
    slides_m = 0.02 * math.sqrt(way_m / 8)
    assert said(0.0, 0.02) == pytest.approx(math.hypot(said(0.0, 0.0), slides_m))


def test_two_strokes_say_nothing() -> None:
    with pytest.raises(SetupRefused, match="evenly enough"):
        measure(drive(0.1, strokes=2), TRUE)
