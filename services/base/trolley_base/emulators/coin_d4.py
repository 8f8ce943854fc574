"""COIN-D4 (LDS-03): waits until it is told to scan, then sends up to 25 points a packet.

A time-of-flight sensor: 5000 points a second, 10 turns. The packet that begins a turn says how fast
the last one was.

Source:
    ROBOTIS, coin_d4_driver.
"""

import struct

import numpy as np

from trolley_base.emulators.lidar import LidarFacts, MakeLidar, Mount, Samples, SpinningLidar
from trolley_base.world import LidarSpec

FACTS = LidarFacts(
    baud=230400, turns_hz=10.0, range_min_m=0.1, range_max_m=8.0, sample_s=1.0 / 5000.0
)
POINTS = 25
INTENSITY = 150
LONGEST = 4


def point(mm: int, intensity: int) -> bytes:
    """Pack a distance of 14 bits and an intensity of 8 into 24, two of which stay free."""
    return struct.pack("<I", (mm & 0x3FFF) << 10 | (intensity & 0xFF) << 2)[:3]


def encode(tenth_hz: int | None, heads_64: tuple[int, int], points: bytes) -> bytes:
    """Make a packet.

    Args:
        tenth_hz: ten times the speed, in the packet that begins a turn; None in all others.
        heads_64: where the head pointed at the first and the last point, in 1/64 degrees.
        points: three bytes each.
    """
    kind = 0 if tenth_hz is None else tenth_hz << 1 | 1
    first, last = (head << 1 | 1 for head in heads_64)
    head = struct.pack("<BBBBHH", 0xAA, 0x55, kind, len(points) // 3, first, last)
    even = odd = 0
    for low, high in zip(head[::2], head[1::2], strict=True):
        even, odd = even ^ low, odd ^ high
    for i in range(0, len(points), 3):
        even ^= points[i] ^ points[i + 1]
        odd ^= points[i + 2]
    return head + bytes([even, odd]) + points


class CoinD4(SpinningLidar):
    """The sensor; see the module."""

    def __init__(self, mount: Mount, errors: LidarSpec, rng: np.random.Generator) -> None:
        super().__init__(FACTS, mount, errors, rng)
        self._heard = b""
        self._rows: list[tuple[int, int, bytes]] = []
        self._begins = True

    def restart(self, now_ns: int) -> None:
        """Stand still and wait for a command."""
        del now_ns
        self._heard = b""
        self._halt()

    def receive(self, data: bytes, now_ns: int) -> None:
        """Start or stop; four bytes that fit each other are a command."""
        for byte in data:
            self._heard = (self._heard + bytes([byte]))[-LONGEST:]
            if len(self._heard) < LONGEST or self._heard[:2] != b"\xaa\x55":
                continue
            which, check = self._heard[2:]
            if which ^ check != 0xAA ^ 0x55:
                continue
            if which == 0xF0 and self._head is None:
                self._rows, self._begins = [], True
                self._spin(now_ns)
            elif which == 0xF5:
                self._halt()

    def _emit(self, samples: Samples) -> None:
        heads_64 = (np.rint(samples.heads_deg * 64.0).astype(np.int64) % 23040).tolist()
        for time_ns, head_64, mm in zip(
            samples.times_ns.tolist(), heads_64, samples.ranges_mm.tolist(), strict=True
        ):
            if self._rows and head_64 < self._rows[-1][1]:
                self._flush(samples.hz)
                self._begins = True
            self._rows.append((time_ns, head_64, point(mm, INTENSITY if mm else 0)))
            if len(self._rows) == POINTS:
                self._flush(samples.hz)

    def _flush(self, hz: float) -> None:
        """Send what there is."""
        rows, self._rows = self._rows, []
        tenth_hz = round(10.0 * hz) if self._begins else None
        self._begins = False
        points = b"".join(row[2] for row in rows)
        self._send(rows[-1][0], encode(tenth_hz, (rows[0][1], rows[-1][1]), points))


LIDARS: dict[str, MakeLidar] = {"coin_d4": CoinD4}
