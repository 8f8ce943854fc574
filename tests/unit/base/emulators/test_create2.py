"""The Create's interface: modes, lengths of commands, what stops it and what does not."""

from collections.abc import Callable

import pytest

from trolley_base.emulators.create2 import Create2
from trolley_base.world import Simulation

from .boards import Bench

MakeSimulation = Callable[..., Simulation]
FORWARD = bytes.fromhex("91 00 C8 00 C8")


def bench(simulate: MakeSimulation, *commands: bytes, is_asleep: bool = False) -> Bench:
    board = Bench(Create2(is_asleep=is_asleep), simulate())
    for command in commands:
        board.write(command)
        board.wait(0.03)
    return board


def test_it_drives_in_safe_mode_only(simulate: MakeSimulation) -> None:
    for commands, drives in (((b"\x83",), False), ((b"\x80",), False), ((b"\x80", b"\x83"), True)):
        board = bench(simulate, *commands, FORWARD)
        assert (not board.board.wheels().is_zero) == drives


def test_it_is_deaf_for_a_moment_after_a_change_of_mode(simulate: MakeSimulation) -> None:
    board = bench(simulate, b"\x80")
    board.write(b"\x83" + FORWARD)
    assert board.board.wheels().is_zero
    board.wait(0.03)
    board.write(FORWARD)
    assert board.board.wheels().vx == pytest.approx(0.2)


def test_the_right_wheel_comes_first(simulate: MakeSimulation) -> None:
    board = bench(simulate, b"\x80", b"\x83", bytes.fromhex("91 00 64 00 00"))
    assert board.board.wheels().wz == pytest.approx(0.1 / 0.235)


def test_it_streams_what_it_is_asked_for(simulate: MakeSimulation) -> None:
    board = bench(simulate, b"\x80")
    board.write(bytes((148, 1, 43)))
    frames = [data for _, data in board.wait(0.3)]
    assert len(frames) == 20
    assert frames[0][:3] == bytes.fromhex("13 03 2B")
    assert int.from_bytes(frames[0][3:5], "big") == 65400
    assert all(sum(frame) % 256 == 0 for frame in frames)
    board.write(b"\x96\x00")
    assert board.wait(0.1) == []
    assert board.write(bytes((149, 2, 35, 44))) == bytes((1, 0, 120))


def test_its_packets_have_the_lengths_of_the_interface(simulate: MakeSimulation) -> None:
    board = bench(simulate, b"\x80")
    for group, length in ((0, 26), (1, 10), (2, 6), (3, 10), (4, 14), (5, 12), (6, 52), (100, 80)):
        assert len(board.write(bytes((142, group)))) == length
    assert len(board.write(bytes((149, 3, 101, 106, 107)))) == 28 + 12 + 9


@pytest.mark.parametrize(
    ("command", "vx", "wz"),
    [
        ("89 00 C8 7F FF", 0.2, 0.0),
        ("89 00 C8 00 01", 0.0, 0.4 / 0.235),
        ("89 00 C8 FF FF", 0.0, -0.4 / 0.235),
        ("89 00 C8 03 E8", 0.2, 0.2),
        ("92 00 7F 00 7F", 0.249, 0.0),
    ],
)
def test_other_ways_to_drive(simulate: MakeSimulation, command: str, vx: float, wz: float) -> None:
    board = bench(simulate, b"\x80", b"\x83", bytes.fromhex(command))
    assert board.board.wheels().vx == pytest.approx(vx, abs=1e-3)
    assert board.board.wheels().wz == pytest.approx(wz, abs=0.01)


def test_nothing_stops_it_when_commands_cease(simulate: MakeSimulation) -> None:
    board = bench(simulate, b"\x80", b"\x83", FORWARD)
    board.wait(5.0)
    assert board.board.wheels().vx == pytest.approx(0.2)


@pytest.mark.parametrize("felt", ["cliff", "drop", "dock"])
def test_danger_stops_it_in_safe_mode(simulate: MakeSimulation, felt: str) -> None:
    board = bench(simulate, b"\x80", b"\x83", FORWARD)
    assert isinstance(board.board, Create2)
    board.board.felt = frozenset((felt,))
    board.wait(0.05)
    assert board.board.wheels().is_zero
    board.write(FORWARD)
    assert board.board.wheels().is_zero


def test_a_lidars_question_presses_its_buttons(simulate: MakeSimulation) -> None:
    board = bench(simulate, b"\x80", b"\xa5\x25")
    assert board.board.wheels().vx > 0.0
    board = bench(simulate, b"\xa5\x25")
    assert board.board.wheels().is_zero


def test_asleep_it_hears_nothing(simulate: MakeSimulation) -> None:
    board = bench(simulate, b"\x80", b"\x83", FORWARD, is_asleep=True)
    assert board.board.wheels().is_zero
    board.board.opened(board.now_ns)
    for command in (b"\x80", b"\x83", FORWARD):
        board.write(command)
        board.wait(0.03)
    assert board.board.wheels().vx == pytest.approx(0.2)
