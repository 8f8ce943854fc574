"""LDROBOT LD19 (and LD06): streams from power-up, 12 points a packet, 4500 points a second.

Packets follow the points, not the turns: most turns begin in the middle of one.

Source:
    LDROBOT LD19 development manual.
"""

import struct

import numpy as np

from trolley_base.emulators.lidar import LidarFacts, MakeLidar, Mount, Samples, SpinningLidar
from trolley_base.world import LidarSpec

FACTS = LidarFacts(
    baud=230400, turns_hz=10.0, range_min_m=0.02, range_max_m=12.0, sample_s=1.0 / 4500.0
)
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
    """The sensor; see the module."""

    def __init__(self, mount: Mount, errors: LidarSpec, rng: np.random.Generator) -> None:
        super().__init__(FACTS, mount, errors, rng)
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


LIDARS: dict[str, MakeLidar] = {"ld19": Ld19}
