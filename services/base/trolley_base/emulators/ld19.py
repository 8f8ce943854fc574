"""LDROBOT LD19, STL-27L and LD14P: stream from power-up, 12 points a packet.

4500, 21600 and 4000 points a second. Packets follow the points, not the turns: most turns begin in
the middle of one. The LD14P triangulates, and it hears commands: start, stop, how fast to turn. It
answers none of them (what a real one says is not known).

Source:
    LDROBOT LD19 development manual; ldlidar_stl_sdk; kaiaai/LDS for the LD14P.
"""

import dataclasses
import struct
from functools import partial

import numpy as np

from trolley_base.emulators.lidar import (
    Floats,
    LidarFacts,
    MakeLidar,
    Mount,
    Samples,
    SpinningLidar,
)
from trolley_base.world import LidarSpec

FACTS = LidarFacts(
    baud=230400, turns_hz=10.0, range_min_m=0.02, range_max_m=12.0, sample_s=1.0 / 4500.0
)
FACTS_27L = LidarFacts(
    baud=921600, turns_hz=10.0, range_min_m=0.03, range_max_m=25.0, sample_s=1.0 / 21600.0
)
FACTS_14P = LidarFacts(
    baud=230400, turns_hz=6.0, range_min_m=0.1, range_max_m=8.0, sample_s=1.0 / 4000.0
)
COMMAND_BYTES, START, STOP, TURN = 8, 0xA0, 0xA1, 0xA2
POINTS = 12
STAMP_WRAP_MS = 30_000


def _crc_table() -> tuple[int, ...]:
    table: list[int] = []
    for value in range(256):
        for _ in range(8):
            value = (value << 1 ^ (0x4D if value & 0x80 else 0)) & 0xFF
        table.append(value)
    return tuple(table)


_CRC = _crc_table()


def crc8(data: bytes) -> int:
    """CRC-8 with polynomial 0x4D, from 0, not reflected."""
    value = 0
    for byte in data:
        value = _CRC[value ^ byte]
    return value


def encode(speed_dps: int, angles: tuple[int, int], points: bytes, stamp_ms: int) -> bytes:
    """Make a packet.

    Args:
        speed_dps: of the head, in degrees per second.
        angles: of the first and the last point, in 0.01 degrees.
        points: twelve of u16 distance [mm] and u8 intensity.
        stamp_ms: below 30000.
    """
    body = struct.pack("<BBHH", 0x54, 0x2C, speed_dps, angles[0]) + points
    body += struct.pack("<HH", angles[1], stamp_ms)
    return body + bytes([crc8(body)])


class Ld19(SpinningLidar):
    """LD19 or, with other facts, STL-27L; see the module."""

    def __init__(
        self,
        mount: Mount,
        errors: LidarSpec,
        rng: np.random.Generator,
        facts: LidarFacts = FACTS,
    ) -> None:
        super().__init__(facts, mount, errors, rng)
        self._points: list[tuple[int, float, int, int]] = []

    def restart(self, now_ns: int) -> None:
        """Start streaming."""
        super().restart(now_ns)
        self._points.clear()

    def _emit(self, samples: Samples) -> None:
        fade = np.clip(225.0 - 10.0 * samples.ranges_m, 20.0, 255.0).astype(np.int64)
        intensity = np.where(samples.ranges_m > 0.0, fade, 0)
        self._points += zip(
            samples.times_ns.tolist(),
            samples.heads_deg.tolist(),
            samples.ranges_mm.tolist(),
            intensity.tolist(),
            strict=True,
        )
        while len(self._points) >= POINTS:
            packet, self._points = self._points[:POINTS], self._points[POINTS:]
            angles = round(packet[0][1] * 100) % 36000, round(packet[-1][1] * 100) % 36000
            points = b"".join(struct.pack("<HB", mm, light) for _, _, mm, light in packet)
            last_ns = packet[-1][0]
            speed_dps = 0 if self.is_stuck else round(360.0 * samples.hz)
            stamp_ms = last_ns // 1_000_000 % STAMP_WRAP_MS
            self._send(last_ns, encode(speed_dps, angles, points, stamp_ms))


class Ld14p(Ld19):
    """LD14P; see the module."""

    def __init__(self, mount: Mount, errors: LidarSpec, rng: np.random.Generator) -> None:
        super().__init__(mount, errors, rng, FACTS_14P)
        self._heard = bytearray()

    def restart(self, now_ns: int) -> None:
        """Start streaming."""
        super().restart(now_ns)
        self._heard.clear()

    def receive(self, data: bytes, now_ns: int) -> None:
        """Do what commands say whose checksum is right."""
        for byte in data:
            if not self._heard and byte != 0x54:
                continue
            self._heard.append(byte)
            if len(self._heard) == COMMAND_BYTES:
                command, self._heard = bytes(self._heard), bytearray()
                if command[2] == 4 and crc8(command[:7]) == command[7]:
                    self._do(command[1], int.from_bytes(command[3:7], "little"), now_ns)

    def _do(self, command: int, value: int, now_ns: int) -> None:
        if command == STOP:
            self._halt()
        elif command == START and self._head is None:
            self._points.clear()
            self._spin(now_ns)
        elif command == TURN and 2 * 360 <= value <= 8 * 360:
            self._points.clear()
            self._spin(now_ns, dataclasses.replace(FACTS_14P, turns_hz=value / 360.0))

    def _offset_deg(self, ranges_m: Floats) -> Floats:
        """It looks from 19 mm beside its axis, 6.8 degrees to the side."""
        ahead_mm, beside_mm = 1000.0 * ranges_m + 5.9, 119.23 * ranges_m - 18.975571
        return -np.degrees(np.arctan(beside_mm / ahead_mm)).astype(np.float64)


LIDARS: dict[str, MakeLidar] = {
    "ld19": Ld19,
    "stl27l": partial(Ld19, facts=FACTS_27L),
    "ld14p": Ld14p,
}
