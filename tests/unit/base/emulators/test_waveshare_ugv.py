"""The ESP32 of a Waveshare UGV: its lines, its stop, its two firmwares."""

import json
from collections.abc import Callable
from typing import Any

import pytest

from trolley_base.emulators.waveshare_ugv import WaveshareUgv
from trolley_base.world import Simulation

from .boards import Bench

MakeSimulation = Callable[..., Simulation]


def bench(simulate: MakeSimulation, *, robot: Any = "ugv_rover", is_general: bool = False) -> Bench:
    board = Bench(WaveshareUgv(robot, is_general=is_general), simulate())
    board.board.restart(0)
    boot = b"".join(data for _, data in board.wait(2.1))
    assert b"UGV started." in boot
    return board


def report(board: Bench) -> dict[str, Any]:
    return json.loads(board.write(b'{"T":130}\n').splitlines()[-1])


def test_it_is_deaf_while_it_boots(simulate: MakeSimulation) -> None:
    board = bench(simulate)
    board.board.restart(board.now_ns)
    board.wait(1.0)
    assert board.write(b'{"T":130}\n') == b""


def test_it_drives_and_reports_what_it_counted(simulate: MakeSimulation) -> None:
    board = bench(simulate)
    board.write(b'{"T":1,"L":0.2,"R":0.3}\n')
    board.wait(1.0)
    assert board.simulation.truth().twist.vx == pytest.approx(0.25)
    assert board.simulation.truth().twist.wz == pytest.approx(0.1 / 0.172)
    told, yaw = report(board), board.simulation.truth().pose.yaw
    assert told["T"] == 1001
    assert told["odr"] - told["odl"] == pytest.approx(0.172 * yaw, abs=0.002)
    assert told["odr"] / told["odl"] == pytest.approx(1.5, abs=0.05)
    board.write(b'{"T":13,"X":0.1,"Z":0}\n')
    board.wait(0.5)
    assert board.simulation.truth().twist.vx == pytest.approx(0.1)


@pytest.mark.parametrize(
    "line",
    [
        b'{"T":1,"L":2.1,"R":0.1}',
        b'{"T":1,"L":"0.2","R":"0.2"}',
        b'{"T":1,"L":0.2}',
        b'{"T":1,"L":0.2,"R":',
        b"[1]",
        b"",
    ],
)
def test_it_ignores_what_is_no_command(simulate: MakeSimulation, line: bytes) -> None:
    board = bench(simulate)
    board.write(line + b"\n")
    assert board.board.wheels().is_zero


def test_it_repeats_commands_where_it_is_told_to(simulate: MakeSimulation) -> None:
    board = bench(simulate)
    assert board.write(b'{"T":136,"cmd":400}\n') == b""
    board.write(b'{"T":143,"cmd":1}\n')
    assert board.write(b'{"T":136,"cmd":400}\n') == b'{"T":136,"cmd":400}\n'
    assert bench(simulate, is_general=True).write(b'{"T":142,"cmd":9}\n') == b'{"T":142,"cmd":9}\n'


@pytest.mark.parametrize(("told", "stops_s"), [(b"", 3.0), (b'{"T":136,"cmd":400}\n', 0.4)])
def test_it_stops_when_no_command_comes(
    simulate: MakeSimulation, told: bytes, stops_s: float
) -> None:
    board = bench(simulate)
    board.write(told + b'{"T":1,"L":0.2,"R":0.2}\n')
    board.wait(stops_s - 0.02)
    assert not board.board.wheels().is_zero
    board.wait(0.05)
    assert board.board.wheels().is_zero


def test_it_reports_by_itself_as_often_as_told(simulate: MakeSimulation) -> None:
    board = bench(simulate)
    board.write(b'{"T":142,"cmd":40}\n{"T":131,"cmd":1}\n')
    assert len(board.wait(2.0)) == pytest.approx(50, abs=2)
    board.write(b'{"T":131,"cmd":0}\n')
    assert board.wait(0.5) == []


def test_the_other_firmware_drives_a_rover_by_power(simulate: MakeSimulation) -> None:
    board = bench(simulate, is_general=True)
    board.write(b'{"T":1,"L":0.1,"R":0.1}\n')
    board.wait(0.2)
    told = report(board)
    assert (told["L"], told["R"], told["y"]) == (51, 51, "null")
    assert "odl" not in told


def test_told_that_it_is_the_other_robot_it_drives_backwards(simulate: MakeSimulation) -> None:
    board = bench(simulate)
    board.write(b'{"T":900,"main":3,"module":0}\n{"T":1,"L":0.2,"R":0.2}\n')
    board.wait(1.0)
    assert board.simulation.truth().pose.x < -0.15
    assert report(board)["odl"] > 0.15
