"""Whole sessions with a strict ROSArduinoBridge, in simulated time."""

import math
import random
from itertools import pairwise
from typing import Any

import pytest
from support.fake_boards import MS, FakeArduino, Talk

from trolley.config.hardware import ChassisConfig, InputsConfig, PidConfig, WheelsConfig
from trolley.geometry import Pose2D, Twist2D, integrate_twist
from trolley.messages.types import floats_from_bytes
from trolley_base.drivers import DriverError
from trolley_base.drivers.boards import BOARDS, make_board
from trolley_base.drivers.dialogue import BoardDialogue

WHEELS = WheelsConfig(ticks_per_revolution=1200.0, diameter_m=0.065, track_m=0.2)
TURNING = Twist2D(0.3, 0.0, 0.6)


def make(**settings: Any) -> BoardDialogue:
    config = ChassisConfig(board="arduino_bridge", port="/dev/x", wheels=WHEELS, **settings)
    return make_board(config, "differential")


@pytest.fixture
def board() -> FakeArduino:
    return FakeArduino()


@pytest.fixture
def talk(board: FakeArduino) -> Talk:
    return Talk(make(), board)


def lines_of(board: FakeArduino, letter: str) -> list[int]:
    """When the board got lines that begin so."""
    return [at_ns for at_ns, line in board.lines if line.startswith(letter)]


def test_it_comes_up_and_drives_as_it_was_told(talk: Talk) -> None:
    assert talk.run(0.4).link.state == "up"
    talk.wanted = TURNING
    talk.run(10.0)
    talk.wanted = Twist2D.zero()
    talk.run(0.5)
    true = integrate_twist(Pose2D.identity(), TURNING, 10.0)
    # A command takes a few ticks of 20 ms to act, at both ends.
    assert talk.pose.distance_to(true) < 0.05
    assert talk.total("stray_lines") == talk.total("timeouts") == 0


def test_motions_join_without_gaps(talk: Talk) -> None:
    talk.run(1.0)
    talk.wanted = TURNING
    talk.run(3.0)
    motions = [motion for reading in talk.readings for motion in reading.motions]
    assert len(motions) > 65
    assert all(0 < b.stamp_ns - a.stamp_ns <= 101 * MS for a, b in pairwise(motions))
    assert motions[-1].twist.vx == pytest.approx(0.3, abs=0.05)
    assert motions[-1].twist.wz == pytest.approx(0.6, abs=0.3)


def test_one_question_at_a_time(talk: Talk, board: FakeArduino) -> None:
    board.answer_ns = 45 * MS
    talk.run(2.0)
    assert talk.readings[-1].link.state == "up"
    assert all(b - a >= 60 * MS for (a, _), (b, _) in pairwise(board.lines))


def test_the_board_never_stops_by_itself(talk: Talk, board: FakeArduino) -> None:
    talk.run(1.0)
    talk.wanted = TURNING
    talk.run(5.0)
    motors = lines_of(board, "m")
    assert all(b - a <= 120 * MS for a, b in pairwise(motors))
    assert board.auto_stops == 0


@pytest.mark.parametrize("answer_ms", [3, 45])
def test_a_zero_is_in_the_very_next_bytes(talk: Talk, board: FakeArduino, answer_ms: int) -> None:
    board.answer_ns = answer_ms * MS
    talk.run(1.0)
    for ticks in range(20, 30):
        talk.wanted = TURNING
        for _ in range(ticks):
            talk.tick()
        assert board.targets != [0, 0]
        talk.wanted = Twist2D.zero()
        talk.tick()
        assert board.targets == [0, 0]
    talk.run(1.0)
    assert talk.total("stray_lines") == 0


class GarblingArduino(FakeArduino):
    """Understands the next so many stops not."""

    garbled = 0

    def _answer(self, line: str, now_ns: int) -> bytes:
        if line == "m 0 0" and self.garbled:
            self.garbled -= 1
            return b"Invalid Command\r\n"
        return super()._answer(line, now_ns)


def test_a_stop_that_came_garbled_is_said_again_at_once() -> None:
    board = GarblingArduino()
    talk = Talk(make(), board)
    talk.run(1.0)
    for ticks in range(20, 26):
        talk.wanted = TURNING
        for _ in range(ticks):
            talk.tick()
        assert board.targets != [0, 0]
        board.garbled, talk.wanted = 1, Twist2D.zero()
        for _ in range(3):
            talk.tick()
        assert board.targets == [0, 0]
    assert talk.readings[-1].link.state == "up"


def test_a_new_velocity_does_not_wait_for_the_old_pace(talk: Talk, board: FakeArduino) -> None:
    talk.run(1.0)
    talk.wanted = TURNING
    talk.run(0.1)
    assert board.targets != [0, 0]
    before = list(board.targets)
    talk.wanted = Twist2D(0.1, 0.0, 0.0)
    talk.run(0.1)
    assert board.targets != before


def test_nothing_is_commanded_before_it_is_known_who_is_there(talk: Talk) -> None:
    talk.board.is_deaf = True
    talk.wanted = TURNING
    talk.run(3.0)
    assert {data for _, data in talk.sent} == {b"b\r"}
    assert len(talk.sent) <= 7
    assert talk.dialogue.goodbye() == ()


def test_a_slow_velocity_is_not_lost(board: FakeArduino) -> None:
    coarse = WheelsConfig(ticks_per_revolution=40.0, diameter_m=0.065, track_m=0.2)
    config = ChassisConfig(board="arduino_bridge", wheels=coarse)
    talk = Talk(make_board(config, "differential"), board)
    talk.run(1.0)
    talk.wanted = Twist2D(0.05, 0.0, 0.0)
    talk.run(20.0)
    assert talk.pose.x == pytest.approx(1.0, abs=0.05)


def test_gains_are_sent_in_the_order_of_the_wire_and_after_a_reboot(board: FakeArduino) -> None:
    talk = Talk(make(pid=PidConfig(p=20.0, i=1.0, d=12.0, o=50.0)), board)
    talk.run(1.0)
    assert board.gains == "20:12:1:50"
    talk.wanted = TURNING
    talk.run(3.0)
    board.is_deaf = True
    talk.run(0.3)
    talk.wanted = Twist2D.zero()
    talk.run(1.0)
    assert talk.readings[-1].link.state == "down"
    x = talk.pose.x
    board.is_deaf = False
    board.reboot()
    assert talk.run(1.5).link.state == "up"
    assert board.gains == "20:12:1:50"
    assert talk.pose.x == pytest.approx(x)
    assert talk.total("restarts") == 1


def test_one_that_a_brown_out_restarts_while_it_drives_has_not_moved(
    talk: Talk, board: FakeArduino
) -> None:
    talk.run(1.0)
    talk.wanted = Twist2D(0.3, 0.0, 0.0)
    talk.run(1.5)
    board.is_deaf = True
    talk.run(0.08)
    board.is_deaf = False
    board.reboot()
    board.counts = [400.0, 400.0]  # it has rolled on by 7 cm
    x = talk.pose.x
    talk.run(1.0)
    assert x - 0.01 < talk.pose.x < x + 0.3
    assert talk.total("restarts") == 1


@pytest.mark.parametrize("deaf_ms", [20, 80])
def test_lost_answers_while_it_drives_back_over_its_start_are_no_restart(
    talk: Talk, board: FakeArduino, deaf_ms: int
) -> None:
    talk.run(1.0)
    talk.wanted = Twist2D(0.3, 0.0, 0.0)
    talk.run(2.0)
    talk.wanted = Twist2D(-0.3, 0.0, 0.0)
    ticks_per_m = 1200.0 / (math.pi * 0.065)
    while board.counts[0] > 0.11 * ticks_per_m:
        talk.run(0.02)
    board.is_deaf = True
    talk.run(deaf_ms * 1e-3)
    board.is_deaf = False
    talk.run(0.5)
    talk.wanted = Twist2D.zero()
    talk.run(0.5)
    assert talk.total("restarts") == 0
    assert talk.pose.x == pytest.approx(board.counts[0] / ticks_per_m, abs=0.01)


def test_a_busy_board_that_drives_back_over_its_start_has_not_restarted(board: FakeArduino) -> None:
    inputs = InputsConfig(
        bumper_pins=[2, 3], cliff_pins=[4, 5], sonar_pins={"left": 6, "ahead": 7, "right": 8}
    )
    talk = Talk(make(inputs=inputs), board)
    for vx, seconds in ((0.0, 1.0), (0.3, 2.0), (-0.3, 4.0), (0.0, 0.5)):
        talk.wanted = Twist2D(vx, 0.0, 0.0)
        talk.run(seconds)
    assert talk.pose.x == pytest.approx(board.counts[0] * math.pi * 0.065 / 1200.0, abs=0.002)
    assert talk.total("restarts") == 0


def test_gains_are_sent_until_they_are_acknowledged(board: FakeArduino) -> None:
    talk = Talk(make(pid=PidConfig(p=20.0, i=1.0, d=12.0)), board)
    talk.spoil = lambda data: data.replace(b"OK\r\n", b"")
    talk.run(1.0)
    talk.spoil = lambda data: data
    talk.run(0.5)
    board.lines.clear()
    talk.run(1.0)
    assert lines_of(board, "u") == []
    assert talk.readings[-1].link.state == "up"


def test_a_reboot_within_a_moment_is_noticed(board: FakeArduino) -> None:
    talk = Talk(make(pid=PidConfig(p=20.0, i=1.0, d=12.0)), board)
    talk.run(1.0)
    talk.wanted = TURNING
    talk.run(5.0)
    talk.wanted = Twist2D.zero()
    talk.run(0.5)
    pose = talk.pose
    board.reboot()
    talk.run(1.0)
    assert talk.pose == pose
    assert board.gains == "20:12:1:50"


def test_a_lost_answer_costs_a_moment(talk: Talk, board: FakeArduino) -> None:
    talk.run(1.0)
    talk.wanted = TURNING
    talk.run(1.0)
    for _ in range(10):
        talk.spoil = lambda data: b""
        talk.tick()
        talk.spoil = lambda data: data
        talk.run(0.5)
    assert 0 < talk.total("timeouts") <= 10
    assert {reading.link.state for reading in talk.readings[20:]} == {"up"}
    assert board.auto_stops == 0


def test_noise_on_the_line_moves_nothing_that_stands(talk: Talk) -> None:
    dice = random.Random(7)
    talk.run(1.0)
    talk.spoil = lambda data: dice.randbytes(dice.randrange(6)) + data if data else data
    talk.run(20.0)
    assert talk.pose.distance_to(Pose2D.identity()) == 0.0
    assert talk.total("stray_lines") > 0
    talk.spoil = lambda data: data
    assert talk.run(2.0).link.state == "up"


def test_an_endless_line_is_not_kept(talk: Talk) -> None:
    talk.run(1.0)
    for _ in range(100):
        talk.dialogue.receive(b"0" * 1000, talk.now_ns)
    talk.run(1.0)
    assert talk.readings[-1].link.state == "up"
    assert talk.total("stray_lines") >= 100


def test_a_board_that_is_not_heard_is_stopped_all_the_same(talk: Talk, board: FakeArduino) -> None:
    talk.run(1.0)
    talk.wanted = TURNING
    talk.run(1.0)
    talk.spoil = lambda data: b"?" * len(data)
    while talk.tick().link.state == "up":
        assert board.targets != [0, 0]
    talk.wanted = Twist2D.zero()
    talk.tick()
    assert board.targets == [0, 0]
    board.targets = [9, 9]  # as if that had not been heard
    talk.run(0.3)
    assert board.targets == [0, 0]
    assert talk.dialogue.goodbye() != ()
    talk.spoil = lambda data: data
    assert talk.run(1.0).link.state == "up"


def test_a_sketch_without_motors_is_named() -> None:
    talk = Talk(make(), FakeArduino(has_base=False))
    link = talk.run(2.0).link
    assert link.state == "down"
    assert "USE_BASE" in link.message


def test_one_garbled_command_is_no_sketch_without_motors(talk: Talk) -> None:
    talk.run(1.0)
    for _ in range(5):
        talk.spoil = lambda data: b"Invalid Command\r\n" if data else data
        talk.tick()
        talk.spoil = lambda data: data
        assert talk.run(0.5).link.state == "up"
    assert talk.total("invalid_commands") > 0


def test_silence_is_told_then_reopened(talk: Talk, board: FakeArduino) -> None:
    talk.run(1.0)
    board.is_deaf = True
    talk.run(0.8)
    status = talk.dialogue.status(talk.now_ns)
    assert (status.state, status.reopen) == ("down", False)
    assert "stopped answering" in status.message
    talk.run(5.0)
    assert talk.dialogue.status(talk.now_ns).reopen
    board.is_deaf = False
    assert talk.run(1.0).link.state == "up"


def test_another_device_is_told_from_silence() -> None:
    dialogue = make()
    dialogue.begin(0)
    dialogue.receive(b"hello\r\n" * 3, 100 * MS)
    assert "not ROSArduinoBridge" in dialogue.status(200 * MS).message
    assert dialogue.status(6000 * MS).reopen


def test_bumpers_and_cliffs_alarm_while_they_are_active(board: FakeArduino) -> None:
    inputs = InputsConfig(bumper_pins=[4, 5], cliff_pins=[7])
    board.pins = {"d 4": 1, "d 5": 1, "d 7": 0}
    talk = Talk(make(inputs=inputs), board)
    assert talk.run(1.0).alarms == ()
    board.pins["d 5"] = 0
    assert talk.run(0.2).alarms == ("bumper",)
    board.pins["d 7"] = 1
    assert talk.run(0.3).alarms == ("bumper", "cliff")
    board.pins |= {"d 5": 1, "d 7": 0}
    assert talk.run(0.3).alarms == ()


def test_its_sonars_are_ranges_by_name(board: FakeArduino) -> None:
    """Whole centimetres; 318 is a sonar without an echo, 0 a pin without a sonar."""
    inputs = InputsConfig(sonar_pins={"ahead": 5, "left": 6, "loose": 9}, bumper_pins=[4])
    board.pins = {"p 5": 42, "p 6": 318, "p 9": 0, "d 4": 0}
    talk = Talk(make(inputs=inputs), board)
    talk.run(2.0)
    scans = [scan for reading in talk.readings for scan in reading.ranges]
    newest = {scan.frame: floats_from_bytes(scan.ranges) for scan in scans}
    assert newest["ahead"] == pytest.approx(0.42)
    assert (newest["left"] == math.inf).all()
    assert not newest["loose"].any()
    assert all(len([one for one in scans if one.frame == name]) >= 4 for name in newest)
    assert len(lines_of(board, "e")) > 30
    assert talk.total("stray_lines") == talk.total("timeouts") == 0
    [bumper] = talk.readings[-1].contacts
    assert bumper.name == "bumper"
    assert len(bumper.sectors) == 1


def test_many_pins_take_nothing_from_the_motors(board: FakeArduino) -> None:
    inputs = InputsConfig(bumper_pins=[1, 2, 3, 4], cliff_pins=[5, 6, 7, 8], battery_pin=0)
    board.pins = {f"d {pin}": 0 for pin in (5, 6, 7, 8)} | {"a 0": 0}
    talk = Talk(make(inputs=inputs), board)
    talk.run(1.0)
    board.lines.clear()
    talk.run(10.0)
    assert talk.readings[-1].link.state == "up"
    assert len(lines_of(board, "e")) > 80
    assert len(lines_of(board, "m")) > 40
    assert all(len(lines_of(board, f"d {pin}")) > 30 for pin in range(1, 9))
    assert len(lines_of(board, "a")) >= 5


def test_an_empty_battery_alarms_when_it_stays_empty(board: FakeArduino) -> None:
    inputs = InputsConfig(
        battery_pin=0, battery_volts_per_count=0.02, battery_empty_v=10.0, battery_full_v=12.0
    )
    board.pins = {"a 0": 550}
    talk = Talk(make(inputs=inputs), board)
    reading = talk.run(1.5)
    assert reading.battery is not None
    assert reading.battery.voltage == pytest.approx(11.0)
    assert reading.battery.fraction == pytest.approx(0.5)
    board.pins["a 0"] = 480
    assert talk.run(1.5).alarms == ()
    assert talk.run(2.5).alarms == ("battery",)
    board.pins["a 0"] = 502  # a little more, because nothing is driven
    assert talk.run(2.0).alarms == ("battery",)
    board.pins["a 0"] = 520
    assert talk.run(2.0).alarms == ()


def test_goodbye_is_a_stop(talk: Talk, board: FakeArduino) -> None:
    talk.run(1.0)
    talk.wanted = TURNING
    talk.run(1.0)
    (stop,) = talk.dialogue.goodbye()
    board.receive(stop, 0)
    assert board.targets == [0, 0]


@pytest.mark.parametrize(
    ("pid", "sentence"),
    [
        (PidConfig(p=0.6, i=0.3, d=0.5), "whole numbers"),
        (PidConfig(p=10000.0, i=10000.0, d=10000.0), "too long"),
    ],
)
def test_gains_that_the_firmware_cannot_read_are_refused(pid: PidConfig, sentence: str) -> None:
    with pytest.raises(DriverError, match=sentence):
        make(pid=pid)


def test_what_a_board_cannot_do_is_refused() -> None:
    config = ChassisConfig(board="arduino_bridge", wheels=WHEELS)
    with pytest.raises(DriverError, match="mecanum"):
        make_board(config, "mecanum")
    wired = ChassisConfig(board="linorobot", inputs=InputsConfig(bumper_pins=[4]))
    with pytest.raises(DriverError, match="pins"):
        make_board(wired, "differential")
    with pytest.raises(DriverError, match="names no board"):
        make_board(ChassisConfig(), "differential")


def test_the_line_is_the_boards_unless_it_is_configured() -> None:
    assert make().line.baud == BOARDS["arduino_bridge"].facts.baud
    assert make().line.settle_s > 0.0
    assert make(baud=115200).line.baud == 115200
