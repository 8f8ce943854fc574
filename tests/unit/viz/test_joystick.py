"""The joystick: who holds it, what it wants, and what goes to the robot."""

import asyncio
import json
from typing import TYPE_CHECKING, Any

import pytest
import websockets
from support.waiting import wait_until
from websockets.asyncio.client import connect

from trolley import topics
from trolley.geometry import Twist2D
from trolley.messages import Robot
from trolley_viz.joystick.joystick import LATE_MS, SILENCE_NS, Grip, Joystick, twist_of
from trolley_viz.server.access import AccessTokens
from trolley_viz.server.page_pieces import pad_html

if TYPE_CHECKING:
    from .conftest import Stage

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


def test_every_part_of_the_pad_is_in_the_page() -> None:
    page = pad_html(7)
    for part in ("startPad", "hand-pad", "pointercancel", "touch-action"):
        assert part in page


# The whole viewer.
def press(stage: "Stage", who: int, held: bool = True, y: float = 1.0) -> None:
    now_ms = stage.viz.monotonic_ns / MS
    stage.viz.joystick._said(who, 0, grip(now_ms, y=y, held=held))


def test_a_held_pad_drives_the_robot_that_is_shown_then_zero_then_silence(stage: "Stage") -> None:
    stage.browse()
    sent = stage.runtime.record(topics.COMMAND, "teleop")
    for _ in range(5):
        press(stage, ONE)
        stage.runtime.run(0.1)
    commands = list(sent)
    assert len(commands) >= 9
    assert {command.twist for command in commands} == {Twist2D(0.25, 0.0, 0.0)}
    assert all(command.valid_for <= 0.3 for command in commands)
    stamps = [command.stamp_ns for command in commands]
    assert stamps == sorted(set(stamps))
    press(stage, ONE, held=False)
    stage.runtime.run(1.0)
    after = [command.twist for command in sent[len(commands) :]]
    assert set(after) == {Twist2D.zero()}
    assert 4 <= len(after) <= 8


def test_who_follows_another_robot_lets_go(stage: "Stage") -> None:
    stage.browse()
    hands = stage.viz.joystick
    hands.sockets._clients[ONE] = 0
    sent = stage.runtime.record(topics.COMMAND, "teleop")
    press(stage, ONE)
    stage.runtime.run(0.1)
    assert sent[-1].twist == Twist2D(0.25, 0.0, 0.0)
    stage.session.follow("kart")
    press(stage, ONE)
    stage.runtime.run(0.2)
    assert sent[-1].twist == Twist2D.zero()
    stage.session.follow("trolley")
    press(stage, ONE)
    stage.runtime.run(0.2)
    assert sent[-1].twist == Twist2D.zero()
    press(stage, ONE, held=False)
    press(stage, ONE)
    stage.runtime.run(0.1)
    assert sent[-1].twist == Twist2D(0.25, 0.0, 0.0)


def ask(port: int, message: Any, path: str = "joystick?client=0", **options: Any) -> int | None:
    """Say something over the pad's own connection; the code with which it is closed, if it is."""

    async def talk() -> int | None:
        async with connect(f"ws://127.0.0.1:{port}/{path}", **options) as socket:
            try:
                await socket.send(message)
                await asyncio.wait_for(socket.recv(), 1.0)
            except websockets.ConnectionClosed:
                return socket.close_code
            except TimeoutError:
                return None
        return None

    return asyncio.run(talk())


def test_the_pads_own_connection_takes_grips_and_nothing_else(stage: "Stage") -> None:
    port = stage.config.viz.port
    said = {"x": 0.0, "y": 1.0, "held": True, "speed": 0.2, "sent_ms": 5.0}
    assert ask(port, json.dumps(said)) is None
    for bad in ({**said, "x": 2.0}, {**said, "y": None}, {"x": 0.0}, ["x"] * 500):
        assert ask(port, json.dumps(bad)) == 1008, bad
    assert ask(port, "[" * 900) == 1008
    assert ask(port, b"\xff\xfe") == 1008
    for path in (
        "joystick",
        "joystick?client=-1",
        "joystick?client=x",
        f"joystick?client={'9' * 99}",
    ):
        assert ask(port, json.dumps(said), path) == 1008
    wait_until(lambda: not stage.viz.joystick.sockets.clients(), "all are gone")


def test_the_overlays_own_connection_takes_clicks_also_of_those_who_only_look(
    stage: "Stage",
) -> None:
    stage.browse()
    port = stage.config.viz.port
    access = stage.viz.state.read("viewer_access.toml", AccessTokens)
    assert access is not None
    cookie = {"Cookie": f"trolley-{port}=0123456789abcdef.{access.viewer}"}
    path = "overlays?client=0"
    assert ask(port, '{"id": "mode", "index": 1}', path, additional_headers=cookie) is None
    for bad in ("[]", '{"index": 1}', '{"id": "x", "index": "1"}', "[" * 900, "x" * 2000):
        assert ask(port, bad, path) == 1008, bad
    with pytest.raises(websockets.InvalidStatus):
        ask(port, "{}", path, origin="http://elsewhere.example")


def test_pages_of_other_sites_do_not_drive(stage: "Stage") -> None:
    with pytest.raises(websockets.InvalidStatus):
        ask(stage.config.viz.port, "{}", origin="http://elsewhere.example")


def test_who_may_only_look_cannot_drive_in_anothers_name(stage: "Stage") -> None:
    stage.browse()
    port = stage.config.viz.port
    said = json.dumps({"x": 0.0, "y": 1.0, "held": True, "speed": 0.2, "sent_ms": 5.0})
    access = stage.viz.state.read("viewer_access.toml", AccessTokens)
    assert access is not None
    cookie = f"trolley-{port}=0123456789abcdef.{access.viewer}"
    assert ask(port, said, "joystick?client=0", additional_headers={"Cookie": cookie}) == 1008
    cookie = f"trolley-{port}=0123456789abcdef.{access.operator}"
    assert ask(port, said, "joystick?client=0", additional_headers={"Cookie": cookie}) is None
