"""The ROSArduinoBridge sketch: its answers, its ticks, its stops."""

import math
from collections.abc import Callable

import pytest

from trolley.geometry import Pose2D
from trolley_base.emulators.arduino_bridge import ArduinoBridge, WheelFacts, as_signed
from trolley_base.world import Simulation

from .boards import Bench

MakeSimulation = Callable[..., Simulation]
FACTS = WheelFacts(ticks_per_revolution=1550.0, diameter_m=0.1, track_m=0.2)


def bench(simulate: MakeSimulation, *, use_base: bool = True, start: Pose2D | None = None) -> Bench:
    board = Bench(ArduinoBridge(FACTS, use_base=use_base), simulate(start=start))
    board.board.opened(0)
    board.wait(1.1)
    return board


@pytest.mark.parametrize(
    ("asked", "answer"),
    [
        ("b", "57600"),
        ("e", "0 0"),
        ("m 0 0", "OK"),
        ("r", "OK"),
        ("u 20:12:0:50", "OK"),
        ("a 0", "816"),
        ("a 3", "0"),
        ("d 4", "1"),
        ("d 7", "0"),
        ("w 13 1", "OK"),
        ("x 9 100", "OK"),
        ("c 13 1", "OK"),
        ("z", "Invalid Command"),
        ("s 0 90", "Invalid Command"),
        ("", "Invalid Command"),
    ],
)
def test_each_command_has_one_answer(simulate: MakeSimulation, asked: str, answer: str):
    assert bench(simulate).write(f"{asked}\r".encode()) == f"{answer}\r\n".encode()


def test_opening_the_port_reboots_it(simulate: MakeSimulation):
    board = bench(simulate)
    board.write(b"m 30 30\r")
    board.wait(0.5)
    board.board.opened(board.now_ns)
    assert board.write(b"b\r") == b""
    board.wait(0.9)
    assert board.write(b"b\r") == b""
    board.wait(0.2)
    assert board.write(b"b\re\r") == b"57600\r\n0 0\r\n"


def test_a_command_ends_with_cr_however_it_is_cut(simulate: MakeSimulation):
    board = bench(simulate)
    assert board.write(b"m 1") == b""
    assert board.write(b"0 -10\r") == b"OK\r\n"
    assert board.board.wheels().wz == pytest.approx(-20 / (FACTS.ticks_per_m * 0.033) / 0.2)


def test_its_ticks_count_what_it_drives(simulate: MakeSimulation):
    board = bench(simulate)
    board.write(b"m 32 32\r")
    board.wait(1.0)
    left, right = map(int, board.write(b"e\r").split())
    x = board.simulation.truth().pose.x
    assert left == right == math.floor(x * 1550 / (math.pi * 0.1))
    assert board.simulation.truth().twist.vx == pytest.approx(32 / 0.033 / FACTS.ticks_per_m)
    board.write(b"m -20 20\r")
    board.wait(1.0)
    assert board.simulation.truth().twist.wz > 0.5
    assert board.write(b"r\r") + board.write(b"e\r") == b"OK\r\n0 0\r\n"


def test_it_stops_2_s_after_the_last_command(simulate: MakeSimulation):
    board = bench(simulate)
    board.write(b"m 20 20\r")
    board.wait(1.99)
    assert board.board.wheels().vx > 0.0
    board.wait(0.03)
    assert board.board.wheels().is_zero


def test_the_shipped_sketch_knows_no_wheels(simulate: MakeSimulation):
    board = bench(simulate, use_base=False)
    for command in (b"e\r", b"m 10 10\r", b"r\r", b"u 1:2:3:4\r"):
        assert board.write(command) == b"Invalid Command\r\n"
    assert board.write(b"b\r") == b"57600\r\n"
    assert board.board.wheels().is_zero


def test_the_bumper_feels_a_wall_and_faults_pull_pins(simulate: MakeSimulation):
    board = bench(simulate, start=Pose2D(2.8, 0.0, 0.0))
    board.write(b"m 30 30\r")
    board.wait(1.0)
    assert board.write(b"d 4\r") == b"0\r\n"
    assert board.simulation.truth().collisions == 1
    assert isinstance(board.board, ArduinoBridge)
    board.board.wired = {"d7": 1}
    assert board.write(b"d 7\r") == b"1\r\n"


def test_counters_wrap_as_the_sketch_does():
    assert as_signed(2**31, 32) == -(2**31)
    assert as_signed(-(2**31) - 1, 32) == 2**31 - 1
    assert as_signed(40000, 16) == 40000 - 65536
