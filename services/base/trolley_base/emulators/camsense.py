"""Camsense X1: streams from power-up, 8 points a packet, and has its motor turn by itself.

2080 points a second, 5.2 turns. While its head comes up to speed its angles say that they are none:
here for a moment, which takes longer on metal.

Source:
    kaiaai/LDS, LDS_CAMSENSE_X1.
"""

import struct

import numpy as np

from trolley_base.emulators.lidar import LidarFacts, MakeLidar, Mount, Samples, SpinningLidar
from trolley_base.emulators.xv11 import checksum
from trolley_base.world import LidarSpec

FACTS = LidarFacts(
    baud=115200, turns_hz=5.2, range_min_m=0.08, range_max_m=8.0, sample_s=1.0 / 2080.0
)
POINTS = 8
RAMP_NS = 20_000_000


def encode(hz: float, angles_deg: tuple[float, float] | None, points: bytes) -> bytes:
    """Make a packet.

    Args:
        hz: turns a second.
        angles_deg: of the first and the last point; None: the head does not turn evenly yet.
        points: eight of u16 distance [mm] and u8 quality.
    """
    first, last = (
        (0, 0) if angles_deg is None else (0xA000 + int(deg % 360.0 * 64.0) for deg in angles_deg)
    )
    body = struct.pack("<4BHH", 0x55, 0xAA, 3, POINTS, round(hz * 60 * 64), first)
    body += points + struct.pack("<H", last)
    return body + struct.pack("<H", checksum(body))


class Camsense(SpinningLidar):
    """The sensor; see the module."""

    def __init__(self, mount: Mount, errors: LidarSpec, rng: np.random.Generator) -> None:
        super().__init__(FACTS, mount, errors, rng)
        self._points: list[tuple[int, float, int]] = []
        self._even_ns = 0

    def restart(self, now_ns: int) -> None:
        """Start streaming."""
        super().restart(now_ns)
        self._points.clear()
        self._even_ns = now_ns + RAMP_NS

    def _emit(self, samples: Samples) -> None:
        self._points += zip(
            samples.times_ns.tolist(),
            samples.heads_deg.tolist(),
            samples.ranges_mm.tolist(),
            strict=True,
        )
        while len(self._points) >= POINTS:
            packet, self._points = self._points[:POINTS], self._points[POINTS:]
            is_even = packet[0][0] >= self._even_ns
            angles = (packet[0][1], packet[-1][1]) if is_even else None
            points = b"".join(struct.pack("<HB", mm, 50 if mm else 0) for _, _, mm in packet)
            self._send(packet[-1][0], encode(0.0 if self.is_stuck else samples.hz, angles, points))


LIDARS: dict[str, MakeLidar] = {"camsense_x1": Camsense}
