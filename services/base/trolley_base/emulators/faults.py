"""Faults on demand: what may go wrong with a device, how to write it, when it applies.

ld19:silence@10+5           from 10 s after the start on, for 5 s
linorobot:noise=500         from now on, 500 random bytes per second
arduino_bridge:pin=d4:0+2   digital pin 4 reads 0, for 2 s
ld19:ok                     everything that holds for this device ends
"""

import math
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from trolley_base.drivers.boards import BOARDS
from trolley_base.emulators.create2 import FEELINGS
from trolley_base.emulators.device import Frame
from trolley_base.world.faulty_wheels import BOTH, NONE, WELL, Sides, Trouble

KINDS = {
    "silence": "it sends nothing",
    "noise": "random bytes between its frames; =BYTES per second, else 200",
    "cut": "frames cut short; =SHARE of them, else 0.3",
    "stuck": "a lidar keeps reporting one angle, a board the same values",
    "unplug": "the port is gone; plugged in again at the end",
    "blind": "a lidar finds nothing ahead of the robot; =DEGREES in all, else 60",
    "fail": "beams of a lidar find nothing; =SHARE of them, else 0.95",
    "cover": "a lidar's every beam ends at its nearest range",
    "flood": "its last frame over and over, more than the line carries",
    "deaf": "a board ignores commands and drives on as before",
    "drives": "a board drives by itself; =M/S, else 0.3",
    "factor": "a board drives =TIMES what it is told, else -1: the wrong way",
    "motor": "a motor is dead: =left, =right or =both",
    "encoder": "an encoder is stuck: =left, =right or =both",
    "swapped": "the encoders of left and right are swapped",
    "lifted": "the wheels turn in the air",
    "pushed": "somebody pushes the robot to and fro; =M/S at most, else 0.4",
    "jump": "a board's odometry leaps once a second",
    "nan": "linorobot: its speeds are not numbers (NaN)",
    "gyro": "linorobot: its gyro reads =TIMES the truth, else -1: the wrong way round",
    "reset": "the device restarts once a second",
    "refuse": "the port accepts nothing that the host writes",
    "md5": "linorobot: other firmware, with a different `raw_vel` (linorobot2: `cmd_vel`)",
    "session": "linorobot2: it is in a session with another agent, which has gone",
    "pin": "arduino_bridge: =d4:0 or =a0:700, what a pin reads",
    "feels": "create2: =bump, =left, =right (of the bumper), =cliff, =drop (of a wheel), =near and "
    "=wall (by light), =dock or =clean (its button)",
    "ok": "all faults of the device end",
}
_FAULT = re.compile(
    r"(?P<device>[\w-]+):(?P<kind>\w+)(=(?P<value>[^@+]+))?"
    r"(@(?P<start>\d+(\.\d+)?))?(\+(?P<duration>\d+(\.\d+)?))?"
)
_PIN = re.compile(r"(?P<pin>[da]\d+):(?P<value>\d+)")
_DEFAULTS = {
    "noise": 200.0,
    "cut": 0.3,
    "blind": 60.0,
    "fail": 0.95,
    "drives": 0.3,
    "factor": -1.0,
    "pushed": 0.4,
    "gyro": -1.0,
}
_RANGES = {
    "noise": (0.0, 1e5),
    "cut": (0.0, 1.0),
    "blind": (0.0, 360.0),
    "fail": (0.0, 1.0),
    "drives": (-2.0, 2.0),
    "factor": (-5.0, 5.0),
    "pushed": (0.0, 2.0),
    "gyro": (-100.0, 100.0),
}
SIDES = {"left": frozenset(("left",)), "right": frozenset(("right",)), "both": BOTH}
OF_BOARDS = ("deaf", "drives", "factor", "motor", "encoder", "swapped", "lifted", "pushed", "jump")
OF_LIDARS = ("blind", "fail", "cover")
OF_LINOROBOT = ("md5", "nan", "gyro")
FLOOD = 1.5
"""How much more than the line carries a flood is."""


class FaultError(ValueError):
    """A fault that cannot be parsed: one sentence that says what is expected."""


@dataclass(frozen=True, slots=True)
class Fault:
    """Something that goes wrong.

    Attributes:
        device: the name of its port.
        kind: one of `KINDS`.
        amount: for noise, cut, blind and fail.
        pin: for pin: its name and what it reads; for feels: what, and 1.
        sides: for motor and encoder: which are broken.
        start_s: since the start of the emulator; None: at once.
        duration_s: None: forever.
        text: as it was written.
    """

    device: str
    kind: str
    amount: float
    pin: tuple[str, int]
    sides: Sides
    start_s: float | None
    duration_s: float | None
    text: str


def parse_fault(text: str, devices: Collection[str]) -> Fault:
    """Read a fault.

    Raises:
        FaultError: it is not a fault, or not for one of these devices.
    """
    text = text.strip()
    match = _FAULT.fullmatch(text)
    if match is None:
        raise FaultError(
            f"{text!r} is not a fault; write device:kind or device:kind=value, then optionally "
            "@start and +duration in seconds, such as ld19:silence@10+5"
        )
    device, kind, value = match["device"], match["kind"], match["value"]
    if device not in devices:
        raise FaultError(f"{text!r}: there is no {device} here, only {', '.join(devices)}")
    if kind not in KINDS:
        raise FaultError(f"{text!r}: there is no fault {kind}, only {', '.join(KINDS)}")
    is_board = device.partition("-")[0] in BOARDS.names
    if kind in OF_LINOROBOT and not device.startswith("linorobot"):
        raise FaultError(f"{text!r}: only linorobot knows {kind}")
    if kind == "session" and not device.startswith("linorobot2"):
        raise FaultError(f"{text!r}: only linorobot2 has sessions")
    if kind in OF_BOARDS and not is_board:
        raise FaultError(f"{text!r}: only motor boards know {kind}")
    if kind == "pin" and not device.startswith("arduino_bridge"):
        raise FaultError(f"{text!r}: only arduino_bridge has pins")
    if kind == "feels" and not device.startswith("create2"):
        raise FaultError(f"{text!r}: only create2 feels something")
    if kind in OF_LIDARS and is_board:
        raise FaultError(f"{text!r}: only lidars can be {kind}")
    start, duration = match["start"], match["duration"]
    return Fault(
        device,
        kind,
        _amount(text, kind, value),
        _pin(text, kind, value),
        _sides(text, kind, value),
        None if start is None else float(start),
        None if duration is None else float(duration),
        text,
    )


def _amount(text: str, kind: str, value: str | None) -> float:
    if kind not in _DEFAULTS:
        if value is not None and kind not in ("pin", "feels", "motor", "encoder"):
            raise FaultError(f"{text!r}: {kind} takes no value")
        return 0.0
    if value is None:
        return _DEFAULTS[kind]
    least, most = _RANGES[kind]
    try:
        amount = float(value)
    except ValueError:
        amount = math.nan
    if not least <= amount <= most:
        raise FaultError(f"{text!r}: the value of {kind} must be from {least:g} to {most:g}")
    return amount


def _sides(text: str, kind: str, value: str | None) -> Sides:
    if kind not in ("motor", "encoder"):
        return NONE
    if value not in SIDES:
        raise FaultError(f"{text!r}: write {kind}=left, {kind}=right or {kind}=both")
    return SIDES[value]


def trouble_of(faults: Mapping[str, Fault]) -> Trouble:
    """Return what the active faults of a board make of its wheels."""

    def amount(kind: str) -> float | None:
        return faults[kind].amount if kind in faults else None

    factor = amount("factor")
    trouble = Trouble(
        goes_on="deaf" in faults,
        drives=amount("drives"),
        factor=1.0 if factor is None else factor,
        dead_motors=faults["motor"].sides if "motor" in faults else NONE,
        stuck_encoders=faults["encoder"].sides if "encoder" in faults else NONE,
        swapped_encoders="swapped" in faults,
        lifted="lifted" in faults,
        pushed=amount("pushed"),
    )
    return WELL if trouble == WELL else trouble


def _pin(text: str, kind: str, value: str | None) -> tuple[str, int]:
    if kind == "feels":
        if value not in FEELINGS:
            known = ", ".join(f"feels={one}" for one in FEELINGS)
            raise FaultError(f"{text!r}: write what it feels: {known}")
        return value, 1
    if kind != "pin":
        return "", 0
    match = _PIN.fullmatch(value or "")
    if match is None:
        raise FaultError(f"{text!r}: write what a pin reads as pin=d4:0 or pin=a0:700")
    return match["pin"], int(match["value"])


class FaultChange(NamedTuple):
    """A fault that begins or ends."""

    fault: Fault
    begins: bool


class FaultPlan:
    """Keeps track of which faults are active when."""

    def __init__(self) -> None:
        self._waiting: list[tuple[float, Fault]] = []
        self._holding: list[tuple[float | None, Fault]] = []

    def add(self, fault: Fault, now_s: float) -> None:
        """Schedule a fault for its time, or for now if it names none."""
        self._waiting.append((now_s if fault.start_s is None else fault.start_s, fault))

    def advance(self, now_s: float) -> list[FaultChange]:
        """Return which faults begin and end now, in order."""
        changes = self._end(lambda end_s, _: end_s is not None and end_s <= now_s)
        due = sorted((one for one in self._waiting if one[0] <= now_s), key=lambda one: one[0])
        self._waiting = [one for one in self._waiting if one[0] > now_s]
        for _, fault in due:
            if fault.kind == "ok":
                changes += self._end(lambda _, held, name=fault.device: held.device == name)
                continue
            duration_s = fault.duration_s
            self._holding.append((None if duration_s is None else now_s + duration_s, fault))
            changes.append(FaultChange(fault, begins=True))
        return changes

    def of(self, device: str) -> dict[str, Fault]:
        """Return the active faults of a device, by kind; those of pins by kind and pin."""
        mine = [fault for _, fault in self._holding if fault.device == device]
        return {" ".join(filter(None, (fault.kind, fault.pin[0]))): fault for fault in mine}

    def _end(self, is_over: Callable[[float | None, Fault], bool]) -> list[FaultChange]:
        over = [held for held in self._holding if is_over(*held)]
        self._holding = [held for held in self._holding if held not in over]
        return [FaultChange(fault, begins=False) for _, fault in over]


class Damage:
    """Applies a device's faults to its frames.

    Args:
        baud: of its line, for floods.
        rng: source of the rubbish.
    """

    def __init__(self, baud: int, rng: np.random.Generator) -> None:
        self._bytes_per_s = baud / 10.0
        self._rng = rng
        self._owed = 0.0
        self._last = b""

    def apply(
        self, frames: list[Frame], faults: dict[str, Fault], from_ns: int, to_ns: int
    ) -> list[Frame]:
        """Return what is sent during a span of time instead of `frames`."""
        if frames:
            self._last = frames[-1].data
        if not faults:
            return frames
        if "silence" in faults:
            return []
        if "cut" in faults:
            frames = [self._cut(frame, faults["cut"].amount) for frame in frames]
        seconds = (to_ns - from_ns) * 1e-9
        if "noise" in faults:
            frames = self._with_noise(frames, faults["noise"].amount * seconds, to_ns)
        if "flood" in faults:
            again = self._last or self._rng.bytes(16)
            count = int(FLOOD * self._bytes_per_s * seconds / len(again)) + 1
            frames = [*frames, *(Frame(from_ns, again) for _ in range(count))]
        return frames

    def _cut(self, frame: Frame, share: float) -> Frame:
        if self._rng.random() >= share:
            return frame
        return Frame(frame.due_ns, frame.data[: int(self._rng.integers(len(frame.data)))])

    def _with_noise(self, frames: list[Frame], count: float, due_ns: int) -> list[Frame]:
        """Put `count` bytes, on average, before one of the frames or after all of them."""
        self._owed += count
        now = int(self._owed)
        if now == 0:
            return frames
        self._owed -= now
        place = int(self._rng.integers(len(frames) + 1))
        when_ns = frames[place].due_ns if place < len(frames) else due_ns
        return [*frames[:place], Frame(when_ns, self._rng.bytes(now)), *frames[place:]]
