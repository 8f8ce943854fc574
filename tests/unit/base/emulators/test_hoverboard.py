"""The FOC firmware: its frames, its filter, its time-out."""

from collections.abc import Callable

import pytest

from trolley_base.emulators.hoverboard import Hoverboard
from trolley_base.world import Simulation

from .boards import Bench

MakeSimulation = Callable[..., Simulation]
STAND = bytes.fromhex("CD AB 00 00 00 00 CD AB")
FAST = bytes.fromhex("CD AB 00 00 64 00 A9 AB")
RIGHT = bytes.fromhex("CD AB 14 00 14 00 CD AB")


def bench(simulate: MakeSimulation, *, is_tank: bool = False) -> Bench:
    board = Bench(Hoverboard(is_tank=is_tank, is_voltage=False), simulate())
    board.board.restart(0)
    board.wait(1.1)
    return board


def test_it_reports_each_10_ms_once_it_has_beeped(simulate: MakeSimulation) -> None:
    board = bench(simulate)
    frames = [data for _, data in board.wait(0.5)]
    assert len(frames) == 50
    assert frames[0][:2] == bytes.fromhex("CD AB")
    assert {len(frame) for frame in frames} == {18}


def test_its_motors_are_switched_on_while_both_inputs_are_small(simulate: MakeSimulation) -> None:
    board = bench(simulate)
    board.write(FAST)
    board.wait(0.3)
    assert board.board.wheels().is_zero
    board.write(STAND)
    board.wait(0.1)
    board.write(FAST)
    board.wait(0.5)
    assert board.board.wheels().vx == pytest.approx(100 * 3.14159 * 0.165 / 60, rel=0.02)


def test_it_mixes_and_its_right_motor_is_mirrored(simulate: MakeSimulation) -> None:
    board = bench(simulate)
    board.write(STAND)
    board.wait(0.1)
    board.write(RIGHT)
    last = board.wait(0.7)[-1][1]
    assert board.board.wheels().wz < 0.0
    left, right = (int.from_bytes(last[at : at + 2], "little", signed=True) for at in (8, 6))
    assert (left, right) == (pytest.approx(30, abs=1), pytest.approx(-10, abs=1))


def test_a_command_with_a_wrong_check_is_none(simulate: MakeSimulation) -> None:
    board = bench(simulate)
    board.write(STAND + FAST[:-1] + b"\x00" + b"\xcd")
    board.wait(0.3)
    assert board.board.wheels().is_zero


def test_it_lets_go_after_0_8_s(simulate: MakeSimulation) -> None:
    board = bench(simulate)
    board.write(STAND)
    board.wait(0.1)
    board.write(RIGHT)
    board.wait(0.75)
    assert not board.board.wheels().is_zero
    board.wait(0.1)
    assert board.board.wheels().is_zero
