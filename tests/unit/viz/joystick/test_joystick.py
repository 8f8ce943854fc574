"""The joystick: who holds it, what it wants, and what goes to the robot."""

import json
from typing import TYPE_CHECKING, Any

import msgspec
import pytest

from trolley import topics
from trolley.geometry import Twist2D
from trolley.messages import Robot
from trolley_viz.joystick.joystick import LATE_MS, SILENCE_NS, Grip, Joystick, twist_of
from trolley_viz.joystick.teleop import PadState
from trolley_viz.server.messages import Said
from trolley_viz.server.visitors import Visitor

if TYPE_CHECKING:
    from ..conftest import Stage

MS = 1_000_000
ONE, OTHER = 1, 2
ROBOT = Robot(
    stamp_ns=0,
    name="one",
    title="",
    footprint=[(0.1, 0.1), (-0.1, 0.1), (-0.1, -0.1), (0.1, -0.1)],
    drive="differential",
    max_speed=0.5,
    max_wz=1.5,
    deceleration=1.0,
)


def grip(sent_ms: float, *, x: float = 0.0, y: float = 1.0, held: bool = True) -> Grip:
    return Grip(x=x, y=y, held=held, speed=0.25, sent_ms=sent_ms)


def wanted(joystick: Joystick, now_ms: float) -> Twist2D | None:
    return joystick.wanted(ROBOT, round(now_ms * MS))


def hear(joystick: Joystick, who: int, said: Grip, delay_ms: float = 0.0) -> None:
    joystick.hear(who, said, round((said.sent_ms + delay_ms) * MS))


@pytest.mark.parametrize(
    ("x", "y", "speed", "twist"),
    [
        (0.0, 1.0, 0.25, (0.25, 0.0, 0.0)),
        (0.0, -1.0, 0.25, (-0.25, 0.0, 0.0)),
        (1.0, 0.0, 0.25, (0.0, 0.0, -0.8)),
        (-1.0, 0.0, 0.1, (0.0, 0.0, 0.32)),
        (0.0, 1.0, 9.0, (0.5, 0.0, 0.0)),
        (0.05, 0.05, 0.25, (0.0, 0.0, 0.0)),
    ],
)
def test_up_is_forward_and_right_turns_right(
    x: float, y: float, speed: float, twist: tuple[float, float, float]
) -> None:
    found = twist_of(Grip(x=x, y=y, held=True, speed=speed, sent_ms=0.0), ROBOT)
    assert (found.vx, found.vy, found.wz) == pytest.approx(twist)


def test_a_browser_that_falls_silent_holds_nothing() -> None:
    joystick = Joystick()
    hear(joystick, ONE, grip(1000.0))
    assert wanted(joystick, 1000.0 + SILENCE_NS / MS) == Twist2D(0.25, 0.0, 0.0)
    assert wanted(joystick, 1001.0 + SILENCE_NS / MS) is None
    hear(joystick, ONE, grip(1500.0))
    assert wanted(joystick, 1500.0) is not None
    hear(joystick, ONE, grip(1510.0, held=False))
    assert wanted(joystick, 1510.0) is None


def test_who_presses_first_drives_and_the_other_presses_anew() -> None:
    joystick = Joystick()
    hear(joystick, ONE, grip(1000.0))
    hear(joystick, OTHER, grip(1010.0, y=-1.0))
    assert joystick.holder == ONE
    hear(joystick, ONE, grip(1020.0, held=False))
    hear(joystick, OTHER, grip(1030.0, y=-1.0))
    assert joystick.holder is None
    hear(joystick, OTHER, grip(1040.0, held=False))
    hear(joystick, OTHER, grip(1050.0, y=-1.0))
    assert joystick.holder == OTHER
    joystick.leave(OTHER)
    assert wanted(joystick, 1050.0) is None


def test_what_was_dropped_has_to_be_pressed_anew() -> None:
    joystick = Joystick()
    hear(joystick, ONE, grip(1000.0))
    joystick.drop()
    hear(joystick, ONE, grip(1100.0))
    assert wanted(joystick, 1100.0) is None
    hear(joystick, ONE, grip(1200.0, held=False))
    hear(joystick, ONE, grip(1300.0))
    assert wanted(joystick, 1300.0) is not None


def test_what_waited_on_its_way_does_not_drive_but_a_late_release_stops() -> None:
    joystick = Joystick()
    hear(joystick, ONE, grip(1000.0), delay_ms=20.0)
    hear(joystick, ONE, grip(1100.0), delay_ms=20.0 + LATE_MS + 10.0)
    assert wanted(joystick, 1400.0) is None
    hear(joystick, ONE, grip(1500.0), delay_ms=30.0)
    assert wanted(joystick, 1530.0) is not None
    hear(joystick, ONE, grip(1510.0, held=False), delay_ms=900.0)
    assert wanted(joystick, 2410.0) is None


def test_clocks_that_run_apart_make_nothing_late() -> None:
    joystick = Joystick()
    for second in range(0, 3600, 10):
        sent_ms = 1000.0 * second
        joystick.hear(ONE, grip(sent_ms), round(sent_ms * 1.0005 * MS))
        assert joystick.holder == ONE


# The whole viewer.
def press(stage: "Stage", browser: Any, *, held: bool = True) -> None:
    stage.say(browser, Said(grip=grip(stage.now_ms, held=held)))


FORWARD = Twist2D(0.25, 0.0, 0.0)


def test_a_held_pad_drives_the_robot_that_is_shown_then_zero_then_silence(stage: "Stage") -> None:
    browser = stage.browse()
    sent = stage.runtime.record(topics.COMMAND, "teleop")
    for _ in range(5):
        press(stage, browser)
        stage.runtime.run(0.1)
    commands = list(sent)
    assert len(commands) >= 9
    assert {command.twist for command in commands} == {FORWARD}
    assert all(command.valid_for <= 0.3 for command in commands)
    stamps = [command.stamp_ns for command in commands]
    assert stamps == sorted(set(stamps))
    press(stage, browser, held=False)
    stage.runtime.run(1.0)
    after = [command.twist for command in sent[len(commands) :]]
    assert set(after) == {Twist2D.zero()}
    assert 4 <= len(after) <= 8


def test_who_follows_another_robot_lets_go(stage: "Stage") -> None:
    browser = stage.browse()
    sent = stage.runtime.record(topics.COMMAND, "teleop")
    press(stage, browser)
    stage.runtime.run(0.1)
    assert sent[-1].twist == FORWARD
    stage.session.follow("kart")
    press(stage, browser)
    stage.runtime.run(0.2)
    assert sent[-1].twist == Twist2D.zero()
    stage.session.follow("trolley")
    press(stage, browser)
    stage.runtime.run(0.2)
    assert sent[-1].twist == Twist2D.zero()
    press(stage, browser, held=False)
    press(stage, browser)
    stage.runtime.run(0.1)
    assert sent[-1].twist == FORWARD


def test_who_follows_a_robot_for_the_first_time_has_to_press_anew(stage: "Stage") -> None:
    """A finger on the pad and another on the list of robots: the pad was the next robot's."""
    stage.runtime.add(type(stage.robot)(), robot="kart")
    browser = stage.browse()
    sent = stage.runtime.record(topics.COMMAND, "teleop", robot="kart")
    press(stage, browser)
    stage.session.follow("kart")
    for _ in range(3):
        press(stage, browser)
        stage.runtime.run(0.1)
    assert sent == []
    press(stage, browser, held=False)
    press(stage, browser)
    stage.runtime.run(0.1)
    assert sent[-1].twist == FORWARD


def test_who_held_nothing_while_choosing_a_robot_drives_it_at_the_first_press(
    stage: "Stage",
) -> None:
    browser = stage.browse()
    sent = stage.runtime.record(topics.COMMAND, "teleop")
    press(stage, browser)
    press(stage, browser, held=False)
    for robot in ("kart", "trolley"):
        stage.session.follow(robot)
        stage.runtime.run(0.5)
    press(stage, browser)
    stage.runtime.run(0.1)
    assert sent[-1].twist == FORWARD


@pytest.mark.parametrize("how", ["closed", "lost", "taken over"])
def test_whoever_is_gone_has_let_go_at_once(stage: "Stage", how: str) -> None:
    browser, other = stage.browse(), stage.browse(1)
    sent = stage.runtime.record(topics.COMMAND, "teleop")
    press(stage, browser)
    stage.runtime.run(0.05)
    assert sent[-1].twist == FORWARD
    num_sent = len(sent)
    if how == "closed":
        stage.leave(browser)
    elif how == "lost":
        browser.line.close()
    else:
        stage.connect()
    stage.runtime.run(0.1)
    assert {command.twist for command in sent[num_sent:]} == {Twist2D.zero()}
    press(stage, browser)  # was on its way
    press(stage, other)
    stage.runtime.run(0.05)
    assert sent[-1].twist == FORWARD
    stage.runtime.run(0.4)
    assert other.pad.can


def test_a_pad_is_told_what_keeps_it_from_driving(stage: "Stage") -> None:
    one, other = stage.browse(), stage.browse(1)
    assert one.pad == PadState(can=True, mine=False, max_speed=0.6, text="", tone="idle")
    press(stage, one)
    stage.runtime.run(0.25)
    assert not other.pad.can
    assert "Somebody else is driving" in other.pad.text
    stage.runtime.kill("base")
    stage.runtime.run(1.5)
    assert not one.pad.can


def test_who_may_only_look_has_no_pad_and_drives_nothing(stage: "Stage") -> None:
    guest = stage.browse(0, Visitor("guest", "viewer"))
    owner = stage.browse(1)
    sent = stage.runtime.record(topics.COMMAND, "teleop")
    for _ in range(3):
        press(stage, guest)
        stage.runtime.run(0.1)
    assert sent == []
    assert all(told.pad is None for told in guest.line.told)
    assert owner.pad.can  # nor does it keep others from driving


@pytest.mark.parametrize(
    "rubbish",
    [
        {"x": 2.0},
        {"x": float("nan")},
        {"y": None},
        {"held": 1},
        {"speed": -1.0},
        {"speed": 1e9},
        {"sent_ms": -1.0},
    ],
)
def test_no_grip_is_out_of_bounds(rubbish: dict[str, Any]) -> None:
    said = {"grip": {"x": 0.0, "y": 1.0, "held": True, "speed": 0.2, "sent_ms": 5.0}}
    msgspec.json.decode(json.dumps(said), type=Said)
    said["grip"] |= rubbish
    with pytest.raises(msgspec.DecodeError):
        msgspec.json.decode(json.dumps(said), type=Said)
