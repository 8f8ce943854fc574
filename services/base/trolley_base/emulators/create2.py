"""An iRobot Create 2: its Open Interface, byte by byte.

Off, it heeds Start alone. In passive mode it reports, and does not drive; in safe mode it drives
until a cliff (forwards), a wheel drop or its charger put it back into passive mode. Nothing stops
it when commands cease. For 20 ms after it was put into another mode than passive it hears nothing.
Some bytes set it off by themselves, as its buttons do.

Source:
    iRobot Create 2 Open Interface Specification (2018): modes, opcodes, packets.
"""

import math
import struct
from enum import IntEnum

from trolley.geometry import Twist2D
from trolley_base.emulators.device import Board
from trolley_base.emulators.surroundings import EmulatedBoard
from trolley_base.units import NS_PER_MS
from trolley_base.world import STEP_NS, Simulation

CREATE_BAUD = 115200
AXLE_M, WHEEL_DIAMETER_M, COUNTS_PER_TURN = 0.235, 0.072, 508.8
COUNTS_PER_METRE = COUNTS_PER_TURN / (math.pi * WHEEL_DIAMETER_M)
MODE_CHANGE_NS, STREAM_NS = 20 * NS_PER_MS, 15 * NS_PER_MS
FIRST_COUNTS = (65_400.0, 120.0)
"""Where the counts stand when it is switched on: not at zero, and soon around the corner."""
BANNER = (
    b"bl-start\r\nSTR730\r\nbootloader id: #x470E6360 83EBFFFF\r\nbootloader rev: #x0001\r\n"
    b"Roomba by iRobot!\r\nstr730\r\nbattery-current-zero 255\r\n"
)
"""What it says when it boots."""
MOST_MMPS, MOST_POWER = 500, 255
CLEANING = Twist2D(0.2, 0.0, 0.0)
NEAR_M = 0.003
JUMP_COUNTS, JUMP_NS = 20_000, 1_000 * NS_PER_MS
MILLIVOLTS, CHARGE, CAPACITY = 15_200, 2_100, 2_696
FEELINGS = ("bump", "left", "right", "cliff", "drop", "near", "wall", "dock", "clean")
"""What a fault makes it feel; `left` and `right` are one half of its bumper, `near` is what its
light bumper sees ahead, `clean` is its Clean button."""


class Mode(IntEnum):
    """Of the interface, as packet 35 reports it."""

    OFF = 0
    PASSIVE = 1
    SAFE = 2
    FULL = 3


RESET, STOP_OI = 7, 173
MODE_OF = {128: Mode.PASSIVE, 130: Mode.SAFE, 131: Mode.SAFE, 132: Mode.FULL}
CLEANING_OPCODES = (134, 135, 136, 143)
BUTTONS, CLEANING_BUTTONS = 165, 0b111
POWER, RADIUS, SENSORS, DIRECT, POWERS = 133, 137, 142, 145, 146
STREAM, QUERY, PAUSE = 148, 149, 150
DRIVES = (RADIUS, DIRECT, POWERS)
STRAIGHT = (32767, -32768)
"""Radii that are none."""
GROUPS = {
    0: (7, 26), 1: (7, 16), 2: (17, 20), 3: (21, 26), 4: (27, 34), 5: (35, 42), 6: (7, 42),
    100: (7, 58), 101: (43, 58), 106: (46, 51), 107: (54, 58),
}  # fmt: skip
"""Packets that are several: the first and the last of them."""
TWO_BYTES = frozenset(
    (19, 20, 22, 23, 25, 26, 27, 28, 29, 30, 31, 33, *range(39, 45), *range(46, 52), *range(54, 58))
)
"""Packets of two bytes; the others have one."""
DATA_BYTES = {
    129: 1, 137: 4, 138: 1, 139: 3, 141: 1, 142: 1, 144: 3, 145: 4, 146: 4, 147: 1, 150: 1,
    162: 2, 163: 4, 164: 4, 165: 1, 167: 15, 168: 3,
}  # fmt: skip
"""How many bytes follow an opcode."""
COUNTED = (STREAM, QUERY)
"""Opcodes behind which a byte says how many follow."""


class Create2(Board):
    """The robot; see the module.

    Args:
        is_asleep: it sleeps until its port is opened.
    """

    def __init__(self, *, is_asleep: bool) -> None:
        super().__init__(CREATE_BAUD, 0.5 * AXLE_M)
        self._is_sleepy = is_asleep
        self.felt: frozenset[str] = frozenset()
        """What faults make it feel, of `FEELINGS`."""
        self._counts = list(FIRST_COUNTS)
        self._forget(0)

    def restart(self, now_ns: int) -> None:
        """Switch it on: the interface is off."""
        self._counts = list(FIRST_COUNTS)
        self.motors.stand()
        self._forget(now_ns)
        self._send(now_ns, BANNER)

    def _forget(self, now_ns: int) -> None:
        self._mode = Mode.OFF
        self._is_awake = not self._is_sleepy
        self._deaf_until_ns = now_ns
        self._pending = bytearray()
        self._speeds = (0, 0)
        self._asked = b""
        self._streams = False
        self._stream_ns = self._jumped_ns = now_ns
        self._is_touching = self._cleans = False
        self._ahead = [0.0, 0.0]
        self._stuck_at: tuple[int, int] | None = None

    def opened(self, now_ns: int) -> None:
        """Opening the port pulls BRC low for a moment, which wakes it."""
        self._is_awake = True

    def wheels(self) -> Twist2D:
        """Return what the motors do."""
        if self._cleans:
            return CLEANING
        left, right = (0.001 * speed for speed in self._speeds)
        return Twist2D(0.5 * (left + right), 0.0, (right - left) / AXLE_M)

    # What it hears.
    def receive(self, data: bytes, now_ns: int) -> None:
        """Take opcodes and their data, however they are cut."""
        if not self._is_awake:
            return
        if now_ns < self._deaf_until_ns:
            self._remarks.append("the host sent something within 20 ms after a change of mode")
            return
        for byte in data:
            self._pending.append(byte)
            if len(self._pending) >= self._wanted():
                command = bytes(self._pending)
                self._pending.clear()
                self._obey(command, now_ns)
                if now_ns < self._deaf_until_ns:
                    return

    def _wanted(self) -> int:
        """How many bytes the command has that has begun."""
        opcode = self._pending[0]
        if self._mode == Mode.OFF:
            return 1
        if opcode in COUNTED:
            return 2 + self._pending[1] if len(self._pending) > 1 else 2
        return 1 + DATA_BYTES.get(opcode, 0)

    def _obey(self, command: bytes, now_ns: int) -> None:
        opcode, data = command[0], command[1:]
        if opcode == RESET and self._mode != Mode.OFF:
            self.restart(now_ns)
        elif opcode in MODE_OF and (self._mode != Mode.OFF or MODE_OF[opcode] == Mode.PASSIVE):
            self._change_mode(MODE_OF[opcode], now_ns)
        elif self._mode == Mode.OFF:
            return
        elif opcode in CLEANING_OPCODES or (opcode == BUTTONS and data[0] & CLEANING_BUTTONS):
            self._change_mode(Mode.PASSIVE, now_ns)
            self._cleans = True
            self._remarks.append(f"the host made it clean (opcode {opcode})")
        elif opcode in (POWER, STOP_OI):
            self._change_mode(Mode.OFF, now_ns)
        elif opcode in DRIVES:
            self._drive(opcode, data, now_ns)
        else:
            self._answer(opcode, data, now_ns)

    def _change_mode(self, mode: Mode, now_ns: int) -> None:
        self._mode = mode
        self._speeds, self._cleans = (0, 0), False
        self._deaf_until_ns = now_ns + (MODE_CHANGE_NS if mode >= Mode.SAFE else 0)

    def _drive(self, opcode: int, data: bytes, now_ns: int) -> None:
        if self._mode < Mode.SAFE:
            return
        first, second = struct.unpack(">hh", data)
        left, right = second, first
        if opcode == POWERS:
            left, right = second * MOST_MMPS // MOST_POWER, first * MOST_MMPS // MOST_POWER
        elif opcode == RADIUS:
            # Velocity [mm/s] and radius [mm] to the left; 1 and -1 turn on the spot.
            turn = 0.0 if second in STRAIGHT else 500.0 * AXLE_M / (second or 1)
            left, right = round(first * (1.0 - turn)), round(first * (1.0 + turn))
            if abs(second) == 1:
                left, right = -second * first, second * first
        self._speeds = _within(left), _within(right)
        self._keep(now_ns, self.wheels())

    def _answer(self, opcode: int, data: bytes, now_ns: int) -> None:
        if opcode == STREAM:
            self._asked, self._streams, self._stream_ns = data[1:], True, now_ns
        elif opcode == PAUSE:
            self._streams = bool(data[0])
        elif opcode in (QUERY, SENSORS):
            asked = data[1:] if opcode == QUERY else data
            self._send(now_ns, b"".join(self._packet(number) for number in asked))

    # What it does and says.
    def step(self, simulation: Simulation, from_ns: int, to_ns: int) -> None:
        """Turn the wheels one step further, feel, and stream."""
        twist = self.motors.counted(simulation.take_motion().twist)
        half = 0.5 * AXLE_M * twist.wz
        for side, speed in enumerate((twist.vx - half, twist.vx + half)):
            self._counts[side] += speed * STEP_NS * 1e-9 * COUNTS_PER_METRE
        if self.leaps and to_ns - self._jumped_ns >= JUMP_NS:
            self._jumped_ns = to_ns
            self._counts[0] += JUMP_COUNTS
        self._is_touching = simulation.truth().clearance < NEAR_M
        if self._mode == Mode.SAFE and self._is_in_danger:
            self._change_mode(Mode.PASSIVE, to_ns)
            self._remarks.append("it has stopped by itself, and is in passive mode")
        while self._streams and self._is_awake and self._stream_ns + STREAM_NS <= to_ns:
            self._stream_ns += STREAM_NS
            # What the wheels have turned since then is not counted yet.
            self._ahead = [
                speed * (to_ns - self._stream_ns) * 1e-9 * COUNTS_PER_METRE
                for speed in (twist.vx - half, twist.vx + half)
            ]
            self._send(self._stream_ns, self._frame())
        self._ahead = [0.0, 0.0]

    @property
    def _is_in_danger(self) -> bool:
        is_ahead = sum(self._speeds) > 0
        return bool(self.felt & {"drop", "dock"}) or ("cliff" in self.felt and is_ahead)

    def _frame(self) -> bytes:
        body = b"".join(bytes((number,)) + self._packet(number) for number in self._asked)
        frame = bytes((19, len(body))) + body
        return frame + bytes((-sum(frame) % 256,))

    def _packet(self, number: int) -> bytes:
        if number in GROUPS:
            first, last = GROUPS[number]
            return b"".join(self._packet(one) for one in range(first, last + 1))
        docked = "dock" in self.felt
        left, right = self._read_counts()
        wide = {22: MILLIVOLTS, 25: CHARGE, 26: CAPACITY, 43: left, 44: right}
        wide |= {41: self._speeds[1] & 0xFFFF, 42: self._speeds[0] & 0xFFFF}
        if number in TWO_BYTES:
            return struct.pack(">H", wide.get(number, 0))
        bumped = 0b11 if self._is_touching or "bump" in self.felt else 0
        bumped |= ("right" in self.felt) | ("left" in self.felt) << 1
        narrow = {
            7: bumped | (0b1100 if "drop" in self.felt else 0),
            8: int("wall" in self.felt),
            10: int("cliff" in self.felt),
            18: int("clean" in self.felt),
            21: 2 if docked else 0,
            34: 2 if docked else 0,
            35: int(self._mode),
            45: 0b001100 if "near" in self.felt else 0,
        }
        return bytes((narrow.get(number, 0),))

    def _read_counts(self) -> tuple[int, int]:
        left, right = (self._counts[side] - self._ahead[side] for side in (0, 1))
        now = (math.floor(left) % 65536, math.floor(right) % 65536)
        if not self.is_stuck or self._stuck_at is None:
            self._stuck_at = now
        return self._stuck_at


def _within(speed: int) -> int:
    return max(-MOST_MMPS, min(MOST_MMPS, speed))


BOARDS = {
    "create2": EmulatedBoard(
        lambda options, _around, _rng: Create2(is_asleep="asleep" in options),
        {"asleep": "it sleeps until its port is opened"},
    )
}
