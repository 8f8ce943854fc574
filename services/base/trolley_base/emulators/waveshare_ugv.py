"""A Waveshare UGV's ESP32: JSON, one object a line; two firmwares, which differ.

`ugv_base_ros` controls the speed of each side, counts its way, and keeps in its flash which robot
it is in. That of boards with another inertial unit reports ways in whole centimetres and hundredths
of volts. `ugv_base_general` repeats commands from the start, counts no way, and controls the speed
of a UGV Beast alone: a UGV Rover's motors get the power that the command happens to be, and the
board reports that power as speed. A board that is told it is in the other robot drives backwards.

It boots for 2 s and says so. The motors stop 3 s after the last command, or after what it was told;
what it was told is forgotten when it boots.

Source:
    Waveshare ugv_base_ros 9434682 and 8a9517c, ugv_base_general 91e5871: setup, loop, serialCtrl,
    jsonCmdReceiveHandler, setGoalSpeed, heartBeatCtrl, baseInfoFeedback, mm_settings; the same
    adapted to the QMI8658, be4cf8d of tetotetodouga: baseInfoFeedback.
"""

import json
import math
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, cast

from trolley.geometry import Twist2D
from trolley_base.emulators.device import Board
from trolley_base.emulators.surroundings import EmulatedBoard, WheelFacts
from trolley_base.units import NS_PER_MS
from trolley_base.world import STEP_NS, Simulation

ESP32_BAUD = 115200
BOOT_TIME_NS = 2_000 * NS_PER_MS
HEART_BEAT_NS = 3_000 * NS_PER_MS
BOOT_LINES = (
    "ets Jun  8 2016 00:22:57\r\n\r\nrst:0x1 (POWERON_RESET),boot:0x13 (SPI_FAST_FLASH_BOOT)\r\n",
    "Initialize LittleFS for Flash files ctrl.\r\nPower up the servos.\r\nWiFi init.\r\n",
    "UGV started.\r\nApplication initialization settings.\r\n",
)
MOST_GOAL = 2.0
"""setGoalSpeed ignores what is beyond [m/s]."""
POWER_PER_UNIT, MOST_POWER = 512, 255
FULL_POWER_MPS = 1.3
"""How fast the robot is at full power [m/s]."""
DOCUMENT_BYTES = 256
"""What the JSON document of a command holds."""
LEAP_M, LEAP_PERIOD_NS = 100.0, 1_000 * NS_PER_MS
BATTERY_V = 11.8

Robot = Literal["ugv_rover", "ugv_beast"]


class Wheels(NamedTuple):
    """Of a robot: mainType, wheel diameter [m], pulses per turn, track [m], SET_MOTOR_DIR."""

    main: int
    diameter_m: float
    pulses: int
    track_m: float
    direction: bool


OF_ROBOTS: dict[Robot, Wheels] = {
    "ugv_rover": Wheels(2, 0.0800, 660, 0.172, direction=False),
    "ugv_beast": Wheels(3, 0.0523, 1092, 0.141, direction=True),
}
FACTORY_MAIN = 2


@dataclass
class Told:
    """What the host has told the board since it booted."""

    repeats: bool
    """Whether it repeats commands, if it prints at all."""
    prints: bool = True
    flows: bool = False
    """Whether it reports unasked."""
    pause_ns: int = 0
    """Least time between two reports."""
    heart_beat_ns: int = HEART_BEAT_NS
    """How long after a command its motors stop."""


class Encoders:
    """What the board counts of each side, left first."""

    def __init__(self, wheels: Wheels) -> None:
        self._metre_per_pulse = math.pi * wheels.diameter_m / wheels.pulses
        self._way_m = [0.0, 0.0]
        self._pulses = [0, 0]

    def count(self, left: float, right: float) -> tuple[float, float]:
        """Count a step of the simulation at these speeds [m/s]; return those that were counted."""
        before = list(self._pulses)
        for side, speed in enumerate((left, right)):
            self._way_m[side] += speed * STEP_NS * 1e-9
            self._pulses[side] = math.floor(self._way_m[side] / self._metre_per_pulse)
        moved = [self._metre_per_pulse * (self._pulses[side] - before[side]) for side in (0, 1)]
        return moved[0] / (STEP_NS * 1e-9), moved[1] / (STEP_NS * 1e-9)

    def leap(self) -> None:
        """Let one side have gone far at once."""
        self._way_m[0] += LEAP_M

    @property
    def ways_m(self) -> tuple[float, float]:
        """How far each side has gone, as it is counted."""
        left, right = (count * self._metre_per_pulse for count in self._pulses)
        return left, right


class WaveshareUgv(Board):
    """The board; see the module.

    Args:
        robot: which robot it is in.
        is_general: it runs `ugv_base_general`.
        is_whole: it reports whole centimetres, and hundredths of volts.
    """

    def __init__(self, robot: Robot, *, is_general: bool, is_whole: bool = False) -> None:
        self._true = OF_ROBOTS[robot]
        super().__init__(ESP32_BAUD, 0.5 * self._true.track_m)
        self.robot: Robot = robot
        """Which robot it is in."""
        self._is_general = is_general
        self._is_whole = is_whole
        self._main = FACTORY_MAIN
        self._booted_ns = 0
        self._forget(0)

    def restart(self, now_ns: int) -> None:
        """Boot: deaf for 2 s, wheels standing, everything but the robot's type forgotten."""
        self._forget(now_ns)
        self.motors.stand()
        self._booted_ns = now_ns + BOOT_TIME_NS
        for number, text in enumerate(BOOT_LINES):
            self._send(now_ns + (number + 1) * BOOT_TIME_NS // 4, text.encode())

    def _forget(self, now_ns: int) -> None:
        if self._is_general:
            self._main = FACTORY_MAIN
        self._text = bytearray()
        self._goal = (0.0, 0.0)
        self._power: tuple[float, float] | None = None
        self._commanded_ns = self._reported_ns = self._leapt_ns = now_ns
        self._has_stopped = False
        self._told = Told(repeats=self._is_general)
        self._encoders = Encoders(self._true)
        self._speeds = (0.0, 0.0)
        self._frozen: bytes | None = None

    @property
    def _is_backwards(self) -> bool:
        """Whether it has been told that it is in the other robot, whose motors turn otherwise."""
        told = next((one for one in OF_ROBOTS.values() if one.main == self._main), self._true)
        return not self._is_general and told.direction != self._true.direction

    @property
    def _has_control(self) -> bool:
        """Whether it controls speeds."""
        return not self._is_general or self._main == OF_ROBOTS["ugv_beast"].main

    def wheels(self) -> Twist2D:
        """Return what the motors do."""
        left, right = self._goal
        if self._power is not None:
            left, right = (FULL_POWER_MPS * power / MOST_POWER for power in self._power)
        sign = -1.0 if self._is_backwards else 1.0
        track = self._true.track_m
        return Twist2D(sign * 0.5 * (left + right), 0.0, sign * (right - left) / track)

    def receive(self, data: bytes, now_ns: int) -> None:
        """Take commands, each of which ends with LF."""
        if now_ns < self._booted_ns:
            return
        for byte in data:
            self._text.append(byte)
            if byte == 0x0A:
                line = bytes(self._text)
                self._text.clear()
                self._take(line, now_ns)

    def _take(self, line: bytes, now_ns: int) -> None:
        if len(line) > DOCUMENT_BYTES:
            self._remarks.append(f"the host sent a line of {len(line)} bytes, which is ignored")
            return
        try:
            command: Any = json.loads(line)
        except ValueError:
            return
        if self._told.prints and self._told.repeats:
            self._send(now_ns, line)
        if isinstance(command, dict):
            self._obey(cast("dict[str, Any]", command), now_ns)

    def _obey(self, command: dict[str, Any], now_ns: int) -> None:
        value = _number(command.get("cmd"))
        match command.get("T"):
            case 1 | 11 | 13 as kind:
                self._move(kind, command, now_ns)
            case 130:
                self._report(now_ns)
            case 131:
                self._told.flows = bool(value)
            case 136:
                self._told.heart_beat_ns = int(value) * NS_PER_MS
            case 142:
                self._told.pause_ns = abs(int(value)) * NS_PER_MS
            case 143:
                self._told.repeats = bool(value)
            case 605:
                self._told.prints = value == 1
            case 900:
                self._main = int(_number(command.get("main")))
                if not self._is_general:
                    self._send(now_ns, b"same mm_json already saved.\r\n")
            case _:
                pass

    def _move(self, kind: int, command: dict[str, Any], now_ns: int) -> None:
        """Take a speed of each side (1), a power of each (11), or a twist (13)."""
        left, right = command.get("L"), command.get("R")
        if kind == 1 and not (_is_number(left) and _is_number(right)):
            return
        self._commanded_ns, self._has_stopped = now_ns, False
        if kind == 11:
            self._set_power(_number(left), _number(right))
        elif kind == 1:
            self._set_goal(_number(left), _number(right))
        else:
            x, half = (
                _number(command.get("X")),
                0.5 * self._true.track_m * _number(command.get("Z")),
            )
            self._set_goal(x - half, x + half)
        self._keep(now_ns, self.wheels())

    def _set_goal(self, left: float, right: float) -> None:
        if not self._has_control:
            self._set_power(POWER_PER_UNIT * left, POWER_PER_UNIT * right)
        elif max(abs(left), abs(right)) <= MOST_GOAL:
            self._power = None
            self._goal = (left, right)

    def _set_power(self, left: float, right: float) -> None:
        self._power = (_limited(round(left)), _limited(round(right)))

    def step(self, simulation: Simulation, from_ns: int, to_ns: int) -> None:
        """Run the loop once: count, report, and stop when no command comes."""
        twist = self.motors.counted(simulation.take_motion().twist)
        half = 0.5 * self._true.track_m * twist.wz
        sign = -1.0 if self._is_backwards else 1.0
        speeds = self._encoders.count(sign * (twist.vx - half), sign * (twist.vx + half))
        if to_ns <= self._booted_ns:
            return
        if self.leaps and to_ns - self._leapt_ns >= LEAP_PERIOD_NS:
            self._leapt_ns = to_ns
            self._encoders.leap()
        self._speeds = speeds
        if self._told.flows and to_ns - self._reported_ns >= self._told.pause_ns:
            self._report(to_ns)
        if to_ns - self._commanded_ns > self._told.heart_beat_ns and not self._has_stopped:
            self._has_stopped = True
            self._set_goal(0.0, 0.0)

    def _report(self, now_ns: int) -> None:
        if now_ns - self._reported_ns < self._told.pause_ns:
            return
        self._reported_ns = now_ns
        speeds = self._speeds if self._has_control else self._power or (0.0, 0.0)
        told: dict[str, Any] = {"T": 1001, "L": round(speeds[0], 9), "R": round(speeds[1], 9)}
        told |= {"r": -0.41, "p": 0.87}
        if self._is_general:
            told["y"] = "null"
        else:
            told |= {"y": 1.57, "q0": 0.999, "q1": 0.003, "q2": -0.007, "q3": 0.001}
            told |= {"ax": 12.5, "ay": -3.25, "az": 1003.5, "gx": 0.02, "gy": -0.01, "gz": 0.0}
            left, right = (round(way, 9) for way in self._encoders.ways_m)
            if self._is_whole:
                left, right = int(100.0 * left), int(100.0 * right)
            told |= {"odl": left, "odr": right}
        told["v"] = int(100.0 * BATTERY_V) if self._is_whole else BATTERY_V
        line = json.dumps(told, separators=(",", ":")).encode() + b"\r\n"
        if not self.is_stuck or self._frozen is None:
            self._frozen = line
        self._send(now_ns, self._frozen)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _number(value: object) -> float:
    """What ArduinoJson makes of a value where it wants a number."""
    return float(value) if isinstance(value, int | float) else 0.0


def _limited(power: float) -> float:
    return max(-float(MOST_POWER), min(float(MOST_POWER), power))


def _tables(board: Board, wheels: WheelFacts) -> dict[str, Any]:
    del wheels
    assert isinstance(board, WaveshareUgv)
    return {"settings": {"type": board.robot}}


BOARDS = {
    "waveshare_ugv": EmulatedBoard(
        lambda options, _around, _rng: WaveshareUgv(
            "ugv_beast" if "beast" in options else "ugv_rover",
            is_general="general" in options,
            is_whole="whole" in options,
        ),
        {
            "beast": "a UGV Beast, which has tracks; else a UGV Rover",
            "general": "with ugv_base_general: no counts, and a UGV Rover drives without encoders",
            "whole": "with the ugv_base_ros that reports whole centimetres and hundredths of volts",
        },
        _tables,
    )
}
