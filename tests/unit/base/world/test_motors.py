"""What lies between a command and the robot's motion."""

import numpy as np
import pytest

from trolley.geometry import Twist2D
from trolley_base.world.motors import Actuator, Backlash, Castor, CommandLine
from trolley_base.world.spec import DriveLimits, Motors

DT = 0.01
AHEAD = Twist2D(0.3, 0.0, 0.0)


def rng() -> np.random.Generator:
    return np.random.default_rng(3)


def speeds(motors: Motors, command: Twist2D, seconds: float) -> list[tuple[float, float]]:
    actuator = Actuator(motors, DriveLimits(), 0.2, rng())
    found: list[tuple[float, float]] = []
    for _ in range(round(seconds / DT)):
        actuator.step(command, DT)
        found.append((actuator.twist.vx, actuator.twist.wz))
    return found


def test_a_command_acts_after_its_delay_and_no_later_than_its_jitter() -> None:
    for seed in range(20):
        line = CommandLine(Motors(delay_s=0.1, jitter_s=0.05), np.random.default_rng(seed))
        acts = [line.step(AHEAD, DT) == AHEAD for _ in range(40)]
        assert acts == sorted(acts)
        assert 10 <= acts.index(True) <= 16


def test_no_command_overtakes_another() -> None:
    line = CommandLine(Motors(delay_s=0.05, jitter_s=0.2), rng())
    sent = [Twist2D(0.01 * k, 0.0, 0.0) for k in range(100)]
    acted = [line.step(command, DT).vx for command in sent]
    assert acted == sorted(acted)


def test_ideal_motors_follow_at_once() -> None:
    line = CommandLine(Motors(), rng())
    assert line.step(AHEAD, DT) == AHEAD


def test_a_wheel_stands_within_the_dead_band() -> None:
    motors = Motors(dead_band_mps=0.02)
    assert speeds(motors, Twist2D(0.015, 0.0, 0.0), 1.0)[-1] == (0.0, 0.0)
    assert speeds(motors, Twist2D(0.0, 0.0, 0.15), 1.0)[-1] == (0.0, 0.0)
    assert speeds(motors, Twist2D(0.025, 0.0, 0.0), 1.0)[-1] == (0.025, 0.0)
    # On a tight arc only the inner wheel stands.
    v, wz = speeds(motors, Twist2D(0.025, 0.0, 0.2), 1.0)[-1]
    assert (v, wz) == pytest.approx((0.0225, 0.225))


def test_uneven_motors_swerve_when_they_set_off_and_then_drive_straight() -> None:
    driven = speeds(Motors(uneven=0.2), AHEAD, 2.0)
    assert driven[5][1] < 0.0, "the right wheel lags, so the robot turns right"
    assert driven[-1] == pytest.approx((0.3, 0.0), abs=1e-9)


def test_an_empty_battery_drives_slower() -> None:
    motors = Motors(sag=0.2, sag_minutes=0.1)
    driven = speeds(motors, Twist2D(0.5, 0.0, 0.0), 8.0)
    assert max(v for v, _ in driven) > 0.45
    assert driven[-1][0] == pytest.approx(0.4)


def test_play_is_taken_up_before_the_wheel_moves_the_robot() -> None:
    play = Backlash(0.01)
    ahead = sum(play.drive(0.1, DT) * DT for _ in range(50))
    assert ahead == pytest.approx(0.05 - 0.01)
    back = sum(play.drive(-0.1, DT) * DT for _ in range(50))
    assert back == pytest.approx(-0.05 + 0.01)
    assert Backlash(0.0).drive(0.1, DT) == 0.1


def test_a_castor_kicks_when_the_robot_turns_back_and_only_then() -> None:
    castor = Castor(Motors(castor_kick_rad=0.1, castor_m=0.05), rng())
    assert sum(abs(castor.drive(-0.2, DT)) for _ in range(100)) == 0.0
    kick = sum(castor.drive(0.2, DT) * DT for _ in range(100))
    assert 0.0 < abs(kick) <= 0.1 + 1e-9
    assert sum(abs(castor.drive(0.2, DT)) for _ in range(100)) == 0.0
