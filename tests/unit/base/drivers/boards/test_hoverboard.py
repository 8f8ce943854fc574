"""A hoverboard: its vectors, its mixing, and what it reports."""

import struct
from collections.abc import Callable

import pytest
from support.emulated_boards import MS, EmulatedTalk, config_of, dialogue_of

from trolley.geometry import Twist2D
from trolley_base.drivers import DriverError
from trolley_base.drivers.boards import BOARDS, counted_track_m, make_board
from trolley_base.drivers.boards.hoverboard import command, is_sound, parse_feedback
from trolley_base.emulators.hoverboard import Hoverboard
from trolley_base.world import Simulation

MakeSimulation = Callable[..., Simulation]
AHEAD = Twist2D(0.15, 0.0, 0.0)
FEEDBACK = bytes.fromhex("CD AB 00 00 64 00 62 00 61 00 D8 0E 36 01 00 00 44 A4")


def talk_of(simulate: MakeSimulation, *, is_tank: bool = False) -> EmulatedTalk:
    wheels = {"diameter_m": 0.165, "track_m": 0.34, "tank_steering": is_tank}
    board = Hoverboard(is_tank=is_tank, is_voltage=False)
    return EmulatedTalk(dialogue_of("hoverboard", settings=wheels), board, simulate())


def frame(left: int, right: int) -> bytes:
    words = [0xABCD, 0, 0, right & 0xFFFF, left & 0xFFFF, 3800, 300, 0]
    check = 0
    for word in words:
        check ^= word
    return struct.pack("<9H", *words, check)


def test_vectors_of_the_firmware() -> None:
    assert command(0, 100) == bytes.fromhex("CD AB 00 00 64 00 A9 AB")
    assert command(-50, 200) == bytes.fromhex("CD AB CE FF C8 00 CB 54")
    assert is_sound(FEEDBACK)
    told = parse_feedback(FEEDBACK)
    assert (told.speed, told.right_rpm, told.left_rpm) == (100, 98, 97)
    assert (told.centivolts, told.decidegrees) == (3800, 310)
    assert not is_sound(FEEDBACK[:6] + b"\x01" + FEEDBACK[7:])


@pytest.mark.parametrize("is_tank", [False, True])
def test_both_ways_of_steering_turn_left(simulate: MakeSimulation, is_tank: bool) -> None:
    talk = talk_of(simulate, is_tank=is_tank)
    talk.come_up()
    talk.wanted = Twist2D(0.15, 0.0, 0.5)
    talk.run(3.0)
    truth = talk.simulation.truth().pose
    assert truth.yaw == pytest.approx(1.5, abs=0.15)
    assert truth.y > 0.1
    assert talk.pose.distance_to(truth) < 0.05


@pytest.mark.parametrize(
    ("built", "left", "right"),
    [
        ({}, 20, -20),
        ({"invert_right": True}, 20, 20),
        ({"invert_left": True}, -20, -20),
        ({"invert_left": True, "invert_right": True}, -20, 20),
    ],
)
def test_each_build_has_its_signs(built: dict[str, bool], left: int, right: int) -> None:
    wheels = {"diameter_m": 0.165, "track_m": 0.34, **built}
    dialogue = dialogue_of("hoverboard", settings=wheels)
    dialogue.begin(0)
    for number in range(10):
        dialogue.receive(frame(left, right), (number + 1) * 10 * MS)
    motions = dialogue.take(100 * MS).motions
    assert motions[-1].twist.vx == pytest.approx(20 * 3.14159265 * 0.165 / 60)
    assert motions[-1].twist.wz == pytest.approx(0.0, abs=1e-9)


def test_a_slow_speed_is_right_on_average(simulate: MakeSimulation) -> None:
    """One turn per minute is 8.6 mm/s."""
    talk = talk_of(simulate)
    talk.come_up()
    talk.wanted = Twist2D(0.03, 0.0, 0.0)
    talk.run(6.0)
    assert talk.simulation.truth().pose.x == pytest.approx(0.18, abs=0.02)


def test_its_motors_are_let_go_once_nobody_speaks(simulate: MakeSimulation) -> None:
    talk = talk_of(simulate)
    talk.come_up()
    talk.wanted = AHEAD
    talk.run(1.0)
    for _ in range(70):
        talk.step()
    assert not talk.board.wheels().is_zero
    for _ in range(12):
        talk.step()
    assert talk.board.wheels().is_zero
    assert BOARDS["hoverboard"].facts.watchdog_s == 0.8


def test_speeds_that_no_wheel_has_are_not_used() -> None:
    dialogue = dialogue_of("hoverboard")
    dialogue.begin(0)
    for number in range(5):
        dialogue.receive(frame(900, -900), (number + 1) * 10 * MS)
        dialogue.drive(AHEAD)
        assert dialogue.outgoing((number + 1) * 10 * MS) == b""
    reading = dialogue.take(50 * MS)
    assert reading.motions == ()
    assert reading.link.state == "down"
    assert reading.counts["chassis/bad_messages"] == 5


def test_a_target_beyond_what_it_takes_stays_on_the_arc() -> None:
    dialogue = dialogue_of("hoverboard")
    dialogue.begin(0)
    dialogue.receive(frame(0, 0), 10 * MS)
    dialogue.drive(Twist2D(20.0, 0.0, 20.0))
    _, steer, speed, _ = struct.unpack("<HhhH", dialogue.outgoing(11 * MS))
    assert speed == 1000
    assert steer / speed == pytest.approx(-0.34, abs=0.01)


def test_it_needs_its_wheels_and_has_two() -> None:
    for settings, wrong in (
        ({}, r"\[base.chassis.settings\] missing key `diameter_m`"),
        ({"diameter_m": 0.165, "track_m": 9.0}, r"\[base.chassis.settings.track_m\]"),
        ({"diameter_m": 0.165, "track_m": 0.3, "wheels": 4}, "unknown key `wheels`"),
    ):
        with pytest.raises(DriverError, match=wrong):
            make_board(config_of("hoverboard", settings=settings), "differential")
    with pytest.raises(DriverError, match="drives two"):
        make_board(config_of("hoverboard"), "mecanum")
    assert counted_track_m(config_of("hoverboard")) == 0.34
