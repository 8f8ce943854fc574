"""The keys of `trolley teleop`: what a terminal sends, which are held, and how they drive.

Terminals that speak the kitty keyboard protocol (kitty, foot, WezTerm, Ghostty, Alacritty, Konsole,
iTerm2 ...) tell of each press, repeat and release. All others send a character, and repeat it while
the key is held, so a release is a repeat that does not come.

Source:
    https://sw.kovidgoyal.net/kitty/keyboard-protocol/; xterm control sequences (DSR, focus).
"""

import codecs
import re
from collections.abc import Collection
from dataclasses import dataclass
from typing import Literal

from trolley.geometry import Twist2D
from trolley.messages import Robot

ASK_FOR_RELEASES = "\x1b[>31u\x1b[?u"
"""Switch the protocol on (all of it: letters tell of their release only then) and ask for it."""
NO_MORE_RELEASES = "\x1b[<u"
ASK_FOR_FOCUS, NO_MORE_FOCUS = "\x1b[?1004h", "\x1b[?1004l"
ASK_ALIVE = "\x1b[5n"
"""A terminal that can be reached answers this at once."""

EVENTS_OF_ALL_KEYS = 2 | 8
FIRST_S = 0.5
"""A first character counts this long: the next one comes after the initial repeat delay."""
REPEAT_S = 0.2
"""A repeated character counts this long."""
REPEAT_GAP_S = 0.15
"""Characters nearer than this are repeats."""
SILENCE_S = 0.4
"""A terminal that is silent this long while a key is held may be out of reach."""

_ARROWS = {"A": "up", "B": "down", "C": "right", "D": "left"}
_CODES = {
    27: "escape",
    57413: "+",
    57412: "-",
    57417: "left",
    57418: "right",
    57419: "up",
    57420: "down",
}
"""Keys of the protocol that are no characters; from 57399 on those of the number pad."""
_CSI = re.compile(r"\x1b\[([<=>?]?)([0-9:;]*)[ -/]*([@-~])")
_UNFINISHED = re.compile(r"\x1b(\[[<=>?]?[0-9:;]*[ -/]*|O)?\Z")


@dataclass(frozen=True, slots=True)
class Key:
    """Something happened to a key; `name` is its character in lower case, or a word.

    A plain character says nothing about pressing: it is `typed`.
    """

    name: str
    kind: Literal["typed", "press", "repeat", "release"] = "typed"
    shift: bool = False
    ctrl: bool = False


@dataclass(frozen=True, slots=True)
class TerminalReport:
    """The terminal told something by itself, or answered."""

    what: Literal["alive", "has_releases", "focus_lost"]


class KeyDecoder:
    """Makes keys of the bytes of a terminal, however they are cut into pieces."""

    def __init__(self) -> None:
        self._text = codecs.getincrementaldecoder("utf-8")("replace")
        self._rest: str = ""

    def feed(self, data: bytes) -> list[Key | TerminalReport]:
        """Take bytes; what is not finished waits for more of them."""
        self._rest += self._text.decode(data)
        found: list[Key | TerminalReport] = []
        while self._rest and not _UNFINISHED.match(self._rest):
            event = self._take_one()
            if event is not None:
                found.append(event)
        return found

    def flush(self) -> list[Key | TerminalReport]:
        """Say that no more bytes came for a while: an Escape that waits was the key itself."""
        was_escape = self._rest == "\x1b"
        self._rest = ""
        return [Key("escape")] if was_escape else []

    def _take_one(self) -> Key | TerminalReport | None:
        text = self._rest
        if not text.startswith("\x1b"):
            self._rest = text[1:]
            return _typed(text[0])
        sequence = _CSI.match(text)
        if sequence is not None:
            self._rest = text[sequence.end() :]
            return _sequence(*sequence.groups())
        if text[1] == "O":
            self._rest = text[3:]
            return Key(_ARROWS[text[2]]) if text[2] in _ARROWS else None
        self._rest = text[1:]  # Escape, and something quickly after it
        return Key("escape")


def _typed(character: str) -> Key | None:
    if character == " ":
        return Key("space")
    if character in ("\x03", "\x1a"):
        return Key(chr(ord(character) + ord("`")), ctrl=True)
    if not character.isprintable():
        return None
    lower = character.lower()
    return Key(lower, shift=lower != character)


def _sequence(private: str, parameters: str, final: str) -> Key | TerminalReport | None:
    fields = [part.split(":") for part in parameters.split(";")]
    if private == "?" and final == "u":
        flags = _number(fields[0][0], 0)
        is_all = flags & EVENTS_OF_ALL_KEYS == EVENTS_OF_ALL_KEYS
        return TerminalReport("has_releases") if is_all else None
    if private:
        return None
    if final == "n":
        return TerminalReport("alive")
    if final == "O" and not parameters:
        return TerminalReport("focus_lost")
    if final not in _ARROWS and final != "u":
        return None
    modifiers = fields[1] if len(fields) > 1 else [""]
    state = _number(modifiers[0], 1) - 1
    kinds: dict[int, Literal["press", "repeat", "release"]]
    kinds = {1: "press", 2: "repeat", 3: "release"}
    kind = kinds.get(_number(modifiers[1] if len(modifiers) > 1 else "", 1), "press")
    name = _ARROWS.get(final) or _name(fields, is_release=kind == "release")
    shift, ctrl = bool(state & 1), bool(state & 4)
    return Key(name, kind, shift, ctrl)


def _name(fields: list[list[str]], *, is_release: bool) -> str:
    """The name of a key by its code: of a Latin letter, else of the key that it is on a US board.

    The text counts before the key for what is no letter, since "+" is on another key everywhere.
    """
    text = _number(fields[2][0], 0) if len(fields) > 2 else 0
    if not is_release and 0x20 < text < 0x7F and not chr(text).isalnum():
        return chr(text)
    code = _number(fields[0][0], 0)
    if code in _CODES:
        return _CODES[code]
    if code == 0x20:
        return "space"
    if code > 0x7F and len(fields[0]) > 2:
        code = _number(fields[0][2], code)
    return chr(code).lower() if 0x20 < code < 0xD800 else f"key {code}"


def _number(text: str, otherwise: int) -> int:
    return int(text) if text and len(text) < 9 else otherwise


class HeldKeys:
    """Which keys are held now; what is not known for sure to be held counts as released."""

    def __init__(self) -> None:
        self.has_releases = False
        """Whether the terminal tells of releases."""
        self.is_slow = False
        """Whether Shift is held too."""
        self._until_s: dict[str, float] = {}
        self._typed_s: dict[str, float] = {}
        self._heard_s = 0.0

    def note_alive(self, now_s: float) -> None:
        """Note that the terminal sent something: it is still there."""
        self._heard_s = now_s

    def take(self, key: Key, now_s: float) -> None:
        """Note what happened to a key."""
        self.is_slow = key.shift
        if key.kind == "release":
            self._until_s.pop(key.name, None)
        elif key.kind == "press" and self.has_releases:
            self._until_s[key.name] = float("inf")
        elif key.kind == "repeat" and self.has_releases:
            pass  # it is held already; one that was let go for safety waits for a new press
        else:
            gap_s = now_s - self._typed_s.get(key.name, -float("inf"))
            self._typed_s[key.name] = now_s
            self._until_s[key.name] = now_s + (REPEAT_S if gap_s < REPEAT_GAP_S else FIRST_S)

    def release_all(self) -> None:
        """Let go of everything until it is pressed again."""
        self._until_s.clear()

    def held(self, now_s: float) -> frozenset[str]:
        """Return the names of the keys that are held."""
        if self.has_releases and now_s - self._heard_s > SILENCE_S:
            self.release_all()
        return frozenset(name for name, until_s in self._until_s.items() if now_s < until_s)


MOTIONS = {
    "w": (1, 0, 0),
    "s": (-1, 0, 0),
    "a": (0, 0, 1),
    "d": (0, 0, -1),
    "q": (1, 0, 1),
    "e": (1, 0, -1),
    "j": (0, 1, 0),
    "l": (0, -1, 0),
    "up": (1, 0, 0),
    "down": (-1, 0, 0),
    "left": (0, 0, 1),
    "right": (0, 0, -1),
}
"""What each key wants: forward, to the left, turning left."""
SLOW = 0.4
"""With Shift, this share of the speed."""
STEP = 1.25
"""One press of + or -."""
SLOWEST = 0.2


class Pace:
    """How fast the keys drive.

    Args:
        speed: [m/s].
        turn: [rad/s].
    """

    def __init__(self, speed: float, turn: float) -> None:
        self._speed, self._turn = speed, turn
        self._factor = 1.0

    def faster(self, robot: Robot) -> None:
        """Drive faster, until both speed and turn rate are at the robot's limits."""
        enough = max(robot.max_speed / self._speed, robot.max_wz / self._turn)
        self._factor = min(STEP * self._factor, max(self._factor, enough))

    def slower(self) -> None:
        """Drive slower."""
        self._factor = max(self._factor / STEP, SLOWEST)

    def limits(self, robot: Robot) -> tuple[float, float]:
        """Return speed [m/s] and turn rate [rad/s], never above the robot's limits."""
        return (
            min(self._factor * self._speed, robot.max_speed),
            min(self._factor * self._turn, robot.max_wz),
        )

    def twist(self, held: Collection[str], robot: Robot, *, is_slow: bool) -> Twist2D | None:
        """Return what the held keys want, None where none of them is for driving this robot."""
        can_sideways = robot.drive == "mecanum"
        motions = [motion for name in held if (motion := MOTIONS.get(name)) is not None]
        motions = [motion for motion in motions if can_sideways or motion[1] == 0]
        if not motions:
            return None
        forward, left, turning = (max(-1, min(1, sum(part))) for part in zip(*motions, strict=True))
        speed, turn = self.limits(robot)
        return Twist2D(forward * speed, left * speed, turning * turn).scaled(
            SLOW if is_slow else 1.0
        )
