"""An Arduino with the sketch ROSArduinoBridge: a text protocol, one answer to each command.

Opening the port reboots it, for about a second. It counts ticks of two wheels; `m` sets ticks per
frame of its speed control, 33 ms, and the wheels stop 2 s after the last one. A bumper is wired to
digital pin 4 (0 while the robot touches something), a sensor that looks for the floor to pin 7,
and the battery to analog pin 0.

Source:
    ros_arduino_bridge ROSArduinoBridge.ino, commands.h, diff_controller.h.
"""

import math
from typing import Any

from trolley.geometry import Pose2D, Twist2D
from trolley_base.differential import sides_of
from trolley_base.emulators.device import Board
from trolley_base.emulators.sonar import nearest_m
from trolley_base.emulators.surroundings import EmulatedBoard, WheelFacts
from trolley_base.units import NS_PER_MS
from trolley_base.world import STEP_NS, Simulation

ARDUINO_BAUD = 57600
BOOT_NS = 1_000 * NS_PER_MS
AUTO_STOP_NS = 2_000 * NS_PER_MS
PID_INTERVAL_S = 0.033
"""The firmware's PID_INTERVAL: 1000 / 30 as a whole number of ms."""
ARGUMENT_CHARS = 15
BUMPER_PIN, CLIFF_PIN, SONAR_PIN, BATTERY_PIN = 4, 7, 8, 0
BATTERY_COUNTS, BATTERY_VOLTS_PER_COUNT = 816, 0.0147
LEAP_TICKS, LEAP_NS = 1 << 20, 1_000 * NS_PER_MS
"""A bit of the left count that falls over."""
TOUCHING_M = 0.003
NO_SONAR_CM, NO_ECHO_CM = 0, 318
"""What a pin without a sonar reads, after a second, and a sonar without an echo."""
SONAR_MOUNT, SONAR_CONE, SONAR_REACH_M = Pose2D(0.15, 0.0, 0.0), math.radians(20.0), 3.0
SONAR_NS = 20 * NS_PER_MS


class ArduinoBridge(Board):
    """The board; see the module.

    Args:
        facts: its wheels.
        use_base: whether the sketch was built with `USE_BASE` (the shipped one is not).
    """

    def __init__(self, facts: WheelFacts, *, use_base: bool = True) -> None:
        super().__init__(ARDUINO_BAUD, 0.5 * facts.track_m)
        self._facts = facts
        self._use_base = use_base
        self._booted_ns = 0
        self.wired: dict[str, int] = {}
        """Pins with a fixed reading, whatever the world says, such as {"d4": 0}; set by faults."""
        self._forget(0)

    def restart(self, now_ns: int) -> None:
        """Reboot: deaf and mute for a second, wheels standing, encoders at zero."""
        self._forget(now_ns)
        self.motors.stand()
        self._booted_ns = now_ns + BOOT_NS

    def _forget(self, now_ns: int) -> None:
        self._line = bytearray()
        self._target = (0, 0)
        self._moved_ns = now_ns
        self._ticks = [0.0, 0.0]
        self._leapt_ns = now_ns
        self._frozen: str | None = None
        self._outputs: dict[str, int] = {}
        self._is_touching = False
        self._ahead_cm, self._pinged_ns = NO_ECHO_CM, now_ns

    def opened(self, now_ns: int) -> None:
        """Opening the port raises DTR, and DTR resets an Arduino."""
        self._remarks.append("the host opened the port: the board reboots")
        self.restart(now_ns)

    def wheels(self) -> Twist2D:
        """Return the velocity that the targets of both wheels amount to."""
        return self._as_twist(*self._target)

    def _as_twist(self, left: int, right: int) -> Twist2D:
        per_tick = 1.0 / (self._facts.ticks_per_m * PID_INTERVAL_S)
        vx = 0.5 * (left + right) * per_tick
        return Twist2D(vx, 0.0, (right - left) * per_tick / self._facts.track_m)

    def step(self, simulation: Simulation, from_ns: int, to_ns: int) -> None:
        """Turn the wheels one step further, and stop them when no command comes."""
        twist = self.motors.counted(simulation.take_motion().twist)
        if to_ns <= self._booted_ns:
            return  # nobody counts
        for wheel, speed in enumerate(sides_of(twist, 0.5 * self._facts.track_m)):
            self._ticks[wheel] += speed * STEP_NS * 1e-9 * self._facts.ticks_per_m
        if self.leaps and to_ns - self._leapt_ns >= LEAP_NS:
            self._leapt_ns = to_ns
            self._ticks[0] += LEAP_TICKS
        if to_ns - self._moved_ns > AUTO_STOP_NS:
            self._target = (0, 0)
        self._is_touching = simulation.truth().clearance < TOUCHING_M
        if to_ns - self._pinged_ns >= SONAR_NS:
            self._pinged_ns = to_ns
            ahead_m = nearest_m(simulation, SONAR_MOUNT, SONAR_CONE, SONAR_REACH_M)
            self._ahead_cm = int(100.0 * ahead_m) if ahead_m < math.inf else NO_ECHO_CM

    def receive(self, data: bytes, now_ns: int) -> None:
        """Answer each command, which ends with a CR."""
        if now_ns < self._booted_ns:
            return
        for byte in data:
            if byte != 0x0D:
                if len(self._line) < 256:
                    self._line.append(byte)
                continue
            text = self._line.decode("ascii", "replace")
            self._line.clear()
            self._send(now_ns, f"{self._answer(text, now_ns)}\r\n".encode())

    def _answer(self, text: str, now_ns: int) -> str:
        command, one, two = _parse(text)
        if max(len(one), len(two)) > ARGUMENT_CHARS:
            self._remarks.append(
                f"the host sent an argument of over {ARGUMENT_CHARS} characters: a real board's "
                "memory is overwritten"
            )
        if command in "emru" and command and self._use_base:
            return self._drive(command, one, two, now_ns)
        pin = _atoi(one)
        match command:
            case "b":
                return str(ARDUINO_BAUD)
            case "a":
                return str(self._read(f"a{pin}", BATTERY_COUNTS if pin == BATTERY_PIN else 0))
            case "d":
                free = {BUMPER_PIN: int(not self._is_touching), CLIFF_PIN: 0}
                return str(self._read(f"d{pin}", free.get(pin, 0)))
            case "w":
                self._outputs[f"d{pin}"] = int(_atoi(two) != 0)
                return "OK"
            case "x" | "c":
                return "OK"
            case "p":
                return str(self._ahead_cm if pin == SONAR_PIN else NO_SONAR_CM)
            case _:
                return "Invalid Command"

    def _read(self, pin: str, free: int) -> int:
        return self.wired.get(pin, self._outputs.get(pin, free))

    def _drive(self, command: str, one: str, two: str, now_ns: int) -> str:
        match command:
            case "e":
                now = " ".join(str(as_signed(math.floor(ticks), 32)) for ticks in self._ticks)
                if not self.is_stuck or self._frozen is None:
                    self._frozen = now
                return self._frozen
            case "m":
                self._target, self._moved_ns = (_atoi(one), _atoi(two)), now_ns
                self._keep(now_ns, self._as_twist(*self._target))
            case "r":
                self._ticks = [0.0, 0.0]
            case _:
                gains = [str(_atoi(gain)) for gain in one.split(":")]
                self._remarks.append(f"gains Kp:Kd:Ki:Ko = {':'.join(gains)}")
        return "OK"


def as_signed(count: int, bits: int) -> int:
    """Wrap a count like a signed counter of this many bits."""
    half = 1 << (bits - 1)
    return (count + half) % (2 * half) - half


def _parse(text: str) -> tuple[str, str, str]:
    """Split a line as the sketch does: the last character before a space, two arguments."""
    words = text.split(" ")
    rest = [*words[1:], "", ""]
    return words[0][-1:], rest[0], "".join(rest[1:])


def _atoi(text: str) -> int:
    """C's atoi: leading digits, 0 without any; an int of the AVR holds 16 bits."""
    text = text.strip()
    sign = text[:1] if text[:1] in ("+", "-") else ""
    digits = ""
    for character in text[len(sign) :]:
        if character not in "0123456789":
            break
        digits += character
    return as_signed(int(f"{sign}{digits}"), 16) if digits else 0


def _tables(board: Board, wheels: WheelFacts) -> dict[str, Any]:
    del board
    return {
        "wheels": {
            "ticks_per_revolution": wheels.ticks_per_revolution,
            "diameter_m": wheels.diameter_m,
            "track_m": wheels.track_m,
        },
        "inputs": {
            "bumper_pins": [BUMPER_PIN],
            "cliff_pins": [CLIFF_PIN],
            "sonar_pins": {"ahead": SONAR_PIN},
            "battery_pin": BATTERY_PIN,
            "battery_volts_per_count": BATTERY_VOLTS_PER_COUNT,
        },
    }


BOARDS = {
    "arduino_bridge": EmulatedBoard(
        lambda options, around, _: ArduinoBridge(around.wheels, use_base="no-base" not in options),
        {"no-base": "built without USE_BASE, as the sketch ships"},
        _tables,
    )
}
