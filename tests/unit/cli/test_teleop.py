"""The keys of `trolley teleop`: what terminals send, what is held, what that drives."""

import pytest

from trolley.cli.teleop import base_line
from trolley.cli.teleop_keys import (
    FIRST_S,
    REPEAT_S,
    SILENCE_S,
    HeldKeys,
    Key,
    KeyDecoder,
    Pace,
    TerminalReport,
)
from trolley.geometry import Twist2D
from trolley.messages import BaseState, Robot
from trolley.messages.motion import Battery, Drive

SQUARE = [(0.1, 0.1), (-0.1, 0.1), (-0.1, -0.1), (0.1, -0.1)]


@pytest.mark.parametrize(
    ("sent", "keys"),
    [
        (b"w", [Key("w")]),
        (b"W", [Key("w", shift=True)]),
        (b" ", [Key("space")]),
        (b"\x1b[A\x1b[D", [Key("up", "press"), Key("left", "press")]),
        (b"\x1bOB", [Key("down")]),
        (b"\x1b[1;2C", [Key("right", "press", shift=True)]),
        (b"\x03\x1a", [Key("c", ctrl=True), Key("z", ctrl=True)]),
        (b"\x1b[99;5u", [Key("c", "press", ctrl=True)]),
        (b"\x1b[119;1:1;119u\x1b[119;1:2;119u\x1b[119;1:3u", ["press", "repeat", "release"]),
        (b"\x1b[27u", [Key("escape", "press")]),
        (b"\x1b[32;1:1;32u", [Key("space", "press")]),
        # "+" is a shifted "=" on one keyboard and a key on the next.
        (b"\x1b[61:43;2:1;43u", [Key("+", "press", shift=True)]),
        (b"\x1b[43;1:1;43u", [Key("+", "press")]),
        # A Cyrillic keyboard: the letter where W is on others.
        (b"\x1b[1094::119;1:1;1094u", [Key("w", "press")]),
        (b"\x1b[57419;1:3u", [Key("up", "release")]),
        (b"\x1b[?31u\x1b[?1u", [TerminalReport("has_releases")]),
        (b"\x1b[0n\x1b[O", [TerminalReport("alive"), TerminalReport("focus_lost")]),
        ("é".encode(), [Key("é")]),
        (b"\x1b\x1b[A", [Key("escape"), Key("up", "press")]),
        (b"\x1b[I\x1b[?62;4c\x1b[200~", []),
    ],
)
def test_keys_are_known_by_what_terminals_send(
    sent: bytes, keys: list[Key | TerminalReport | str]
) -> None:
    events = KeyDecoder().feed(sent)
    if isinstance(keys[0] if keys else None, str):
        assert [(event.name, event.kind) for event in events] == [("w", kind) for kind in keys]  # type: ignore[union-attr]
    else:
        assert events == keys


def test_a_sequence_may_come_in_pieces_and_escape_alone_is_a_key() -> None:
    decoder = KeyDecoder()
    assert decoder.feed(b"\x1b") == []
    assert decoder.feed(b"[") == []
    assert decoder.feed(b"A") == [Key("up", "press")]
    assert decoder.feed(b"\x1b") == []
    assert decoder.flush() == [Key("escape")]
    assert decoder.feed(b"\x1b[1") == []
    assert decoder.flush() == []
    assert decoder.feed(b"w") == [Key("w")]


def test_typed_keys_are_held_from_repeat_to_repeat() -> None:
    keys = HeldKeys()
    keys.take(Key("w"), 10.0)
    assert keys.held(10.0 + FIRST_S - 0.01) == {"w"}
    assert keys.held(10.0 + FIRST_S + 0.01) == frozenset()
    now_s = 20.0
    keys.take(Key("w"), now_s)
    for now_s in (20.4, 20.45, 20.5):
        keys.take(Key("w"), now_s)
    assert keys.held(now_s + REPEAT_S - 0.01) == {"w"}
    assert keys.held(now_s + REPEAT_S + 0.01) == frozenset()


def test_told_keys_are_held_until_their_release() -> None:
    keys = HeldKeys()
    keys.has_releases = True
    keys.note_alive(0.0)
    keys.take(Key("w", "press"), 0.0)
    keys.take(Key("a", "press"), 0.1)
    keys.note_alive(60.0)
    assert keys.held(60.0) == {"w", "a"}
    keys.take(Key("w", "release"), 60.0)
    assert keys.held(60.1) == {"a"}


def test_a_silent_terminal_holds_nothing_until_a_new_press() -> None:
    keys = HeldKeys()
    keys.has_releases = True
    keys.note_alive(0.0)
    keys.take(Key("w", "press"), 0.0)
    assert keys.held(SILENCE_S - 0.01) == {"w"}
    assert keys.held(SILENCE_S + 0.01) == frozenset()
    keys.note_alive(1.0)
    keys.take(Key("w", "repeat"), 1.0)
    assert keys.held(1.0) == frozenset()
    keys.take(Key("w", "press"), 1.1)
    assert keys.held(1.1) == {"w"}


def test_shift_that_comes_and_goes_slows_down() -> None:
    keys = HeldKeys()
    keys.has_releases = True
    keys.take(Key("w", "press"), 0.0)
    keys.take(Key("key 57441", "press", shift=True), 0.1)
    assert keys.is_slow
    keys.take(Key("key 57441", "release"), 0.2)
    assert not keys.is_slow


def robot(drive: Drive = "differential", max_speed: float = 0.5, max_wz: float = 2.0) -> Robot:
    return Robot(
        stamp_ns=0,
        name="one",
        title="",
        footprint=SQUARE,
        drive=drive,
        max_speed=max_speed,
        max_wz=max_wz,
        deceleration=1.0,
    )


@pytest.mark.parametrize(
    ("held", "wanted"),
    [
        ({"w"}, (0.2, 0.0, 0.0)),
        ({"down"}, (-0.2, 0.0, 0.0)),
        ({"w", "up"}, (0.2, 0.0, 0.0)),
        ({"w", "left"}, (0.2, 0.0, 1.0)),
        ({"q", "a"}, (0.2, 0.0, 1.0)),
        ({"e"}, (0.2, 0.0, -1.0)),
        ({"w", "s"}, (0.0, 0.0, 0.0)),
    ],
)
def test_keys_add_up(held: set[str], wanted: tuple[float, float, float]) -> None:
    assert Pace(0.2, 1.0).twist(held, robot(), is_slow=False) == Twist2D(*wanted)


def test_only_a_mecanum_robot_drives_sideways() -> None:
    pace = Pace(0.2, 1.0)
    assert pace.twist({"j"}, robot("mecanum"), is_slow=False) == Twist2D(0.0, 0.2, 0.0)
    assert pace.twist({"j"}, robot("differential"), is_slow=False) is None
    assert pace.twist({"p", "key 57441"}, robot(), is_slow=False) is None


def test_speed_changes_between_slow_and_the_robots_limits() -> None:
    pace, one = Pace(0.25, 0.8), robot(max_speed=0.4, max_wz=1.0)
    for _ in range(20):
        pace.faster(one)
    assert pace.limits(one) == (0.4, 1.0)
    pace.slower()
    assert pace.limits(one)[0] < 0.4  # what was pressed too often need not be taken back
    for _ in range(50):
        pace.slower()
    assert pace.limits(one) == pytest.approx((0.05, 0.16))
    slow = Pace(0.2, 1.0).twist({"w"}, one, is_slow=True)
    assert slow is not None
    assert slow.vx == pytest.approx(0.08)


def test_limits_of_the_robot_hold_for_what_is_asked_for() -> None:
    assert Pace(3.0, 9.0).limits(robot(max_speed=0.4, max_wz=1.0)) == (0.4, 1.0)


def test_base_is_told_in_words() -> None:
    state = BaseState(stamp_ns=0, mode="held", reason="stop_field", battery=Battery(fraction=0.8))
    assert base_line(state) == (
        "Held: Something is too close in the direction of travel.  Battery 80%.",
        "yellow",
    )
    assert base_line(BaseState(stamp_ns=0, mode="ok")) == ("Ready.", None)
    why = "The lidar sees nothing behind, so it creeps there."
    creeping = BaseState(stamp_ns=0, mode="ok", reason="blind", message=why)
    assert base_line(creeping) == (why, "yellow")
    assert "R lets it drive" in base_line(BaseState(stamp_ns=0, mode="stopped"))[0]
