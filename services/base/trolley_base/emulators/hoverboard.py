"""A hoverboard's mainboard with the FOC firmware, VARIANT_USART, as it ships but for SPD_MODE.

Each 5 ms it limits and smooths its two inputs, mixes them, and turns the motors, the right one the
other way round; each 10 ms it reports. Without a command for 0.8 s its motors are let go. They are
switched on only while both inputs are small.

Source:
    EFeru hoverboard-firmware-hack-FOC a0751d5: main.c, util.c (readCommand, usart_process_command,
    filtLowPass32, rateLimiter16, mixerFcn), config.h.
"""

import math
import struct

from trolley.geometry import Twist2D
from trolley_base.differential import sides_of
from trolley_base.emulators.device import Board
from trolley_base.emulators.surroundings import EmulatedBoard
from trolley_base.units import NS_PER_MS
from trolley_base.world import STEP_NS, Simulation

HOVERBOARD_BAUD = 115200
TIRE_M, GAUGE_M = 0.165, 0.34
"""Diameter of a wheel, and the distance between both."""
LOOP_NS, SERIAL_TIMEOUT_NS, BEEPING_NS = 5 * NS_PER_MS, 800 * NS_PER_MS, 1_000 * NS_PER_MS
MOST_INPUT, SMALL_INPUT = 1000, 50
RATE, SMOOTHING, STEERING = 30.0, 0.1, 0.5
"""DEFAULT_RATE per loop, DEFAULT_FILTER, DEFAULT_STEER_COEFFICIENT."""
CENTIVOLTS, DECIDEGREES = 3_800, 310
LEAP_RPM_OF_ONE, LEAP_EVERY_NS = 2_500, 1_000 * NS_PER_MS


class Hoverboard(Board):
    """The board; see the module.

    Args:
        is_tank: built with TANK_STEERING: each input is a wheel's.
        is_voltage: built with VLT_MODE, as it ships: the wheels turn at half the speed, and stand
            where they should turn slowly.
    """

    def __init__(self, *, is_tank: bool, is_voltage: bool) -> None:
        super().__init__(HOVERBOARD_BAUD, 0.5 * GAUGE_M)
        self._is_tank, self._is_voltage = is_tank, is_voltage
        self._forget(0)

    def restart(self, now_ns: int) -> None:
        """Switch it on: it beeps for a second, motors off."""
        self._forget(now_ns)
        self.motors.stand()
        self._ready_ns = now_ns + BEEPING_NS

    def _forget(self, now_ns: int) -> None:
        self._ready_ns = now_ns
        self._pending = b""
        self._inputs = (0, 0)
        self._limited = [0.0, 0.0]
        self._smooth = [0.0, 0.0]
        self._heard_ns = now_ns - SERIAL_TIMEOUT_NS
        self._leapt_ns = now_ns
        self._is_enabled = False
        self._rpm = (0, 0)
        self._frozen: bytes | None = None

    def wheels(self) -> Twist2D:
        """Return what the motors do."""
        if not self._is_enabled:
            return Twist2D.zero()
        left, right = (self._turning(rpm) for rpm in self._mixed(*self._smooth))
        return self._as_twist(left, right)

    def _mixed(self, steer: float, speed: float) -> tuple[float, float]:
        """Return the targets of the left and the right wheel [rpm]."""
        if self._is_tank:
            return steer, speed
        return speed + STEERING * steer, speed - STEERING * steer

    def _turning(self, target: float) -> float:
        """Return how fast a wheel turns [rpm]."""
        if not self._is_voltage:
            return target
        return 0.0 if abs(target) < 20.0 else 0.5 * target

    def _as_twist(self, left_rpm: float, right_rpm: float) -> Twist2D:
        metres = math.pi * TIRE_M / 60.0
        vx = 0.5 * metres * (left_rpm + right_rpm)
        return Twist2D(vx, 0.0, metres * (right_rpm - left_rpm) / GAUGE_M)

    def receive(self, data: bytes, now_ns: int) -> None:
        """Take commands of 8 bytes with the right sum."""
        if now_ns < self._ready_ns:
            return
        self._pending += data
        while len(self._pending) >= 8:
            start, steer, speed, check = struct.unpack_from("<HhhH", self._pending)
            is_whole = start == 0xABCD and check == start ^ (steer & 0xFFFF) ^ (speed & 0xFFFF)
            if not is_whole:
                self._pending = self._pending[1:]
                continue
            self._pending = self._pending[8:]
            self._inputs = (_within(steer), _within(speed))
            self._heard_ns = now_ns
            self._keep(now_ns, self._as_twist(*self._mixed(*self._inputs)))

    def step(self, simulation: Simulation, from_ns: int, to_ns: int) -> None:
        """Run the main loop for a step of the world, and report once."""
        twist = self.motors.counted(simulation.take_motion().twist)
        if to_ns <= self._ready_ns:
            return
        for _ in range(STEP_NS // LOOP_NS):
            self._loop(to_ns)
        metres = math.pi * TIRE_M / 60.0
        left, right = (math.trunc(v / metres) for v in sides_of(twist, 0.5 * GAUGE_M))
        if self.leaps and to_ns - self._leapt_ns >= LEAP_EVERY_NS:
            self._leapt_ns = to_ns
            left += LEAP_RPM_OF_ONE
        self._rpm = (left, -right)
        self._report(to_ns)

    def _loop(self, now_ns: int) -> None:
        is_late = now_ns - self._heard_ns > SERIAL_TIMEOUT_NS
        if is_late:
            self._inputs, self._is_enabled = (0, 0), False
        elif not self._is_enabled and max(map(abs, self._inputs)) < SMALL_INPUT:
            self._is_enabled = True
            self._limited, self._smooth = [0.0, 0.0], [0.0, 0.0]
        for place, wanted in enumerate(self._inputs):
            change = max(-RATE, min(RATE, wanted - self._limited[place]))
            self._limited[place] += change
            self._smooth[place] += SMOOTHING * (self._limited[place] - self._smooth[place])

    def _report(self, now_ns: int) -> None:
        left, right = self._rpm
        words = (0xABCD, *self._inputs, right, left, CENTIVOLTS, DECIDEGREES, 0)
        body = struct.pack("<H6hH", *words)
        check = 0
        for (word,) in struct.iter_unpack("<H", body):
            check ^= word
        frame = body + struct.pack("<H", check)
        if not self.is_stuck or self._frozen is None:
            self._frozen = frame
        self._send(now_ns, self._frozen)


def _within(value: int) -> int:
    return max(-MOST_INPUT, min(MOST_INPUT, value))


BOARDS = {
    "hoverboard": EmulatedBoard(
        lambda options, _around, _rng: Hoverboard(
            is_tank="tank" in options, is_voltage="voltage" in options
        ),
        {
            "tank": "built with TANK_STEERING",
            "voltage": "built with VLT_MODE, as it ships: its targets are no speeds",
        },
        lambda _board, _wheels: {
            "settings": {"diameter_m": TIRE_M, "track_m": GAUGE_M},
            "inputs": {"battery_empty_v": 35.0, "battery_full_v": 42.0},
        },
    )
}
