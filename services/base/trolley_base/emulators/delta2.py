"""3irobotix Delta-2A (also as a 2G divides its turn) and Delta-2B: stream from power-up.

A turn is divided into 16 packets (2G: 15). Here the motor has a control of its own; while it comes
up to speed, packets hold the speed alone: for a moment, which takes longer on metal.

Source:
    kaiaai/LDS, LDS_DELTA_2A_115200, 2B and 2G.
"""

import struct
from functools import partial

import numpy as np

from trolley_base.emulators.degree_lidar import DegreeLidar
from trolley_base.emulators.lidar import LidarFacts, MakeLidar, Mount
from trolley_base.world import LidarSpec

A_TURN, G_TURN, B_TURN = (16, 20), (15, 21), (16, 40)
"""Packets of a turn, and samples of a packet."""
SPIN_UP_NS = 20_000_000
QUALITY = 50


def _packet(kind: int, body: bytes) -> bytes:
    head = struct.pack(">BHBBBH", 0xAA, 8 + len(body), 1, 0x61, kind, len(body))
    return head + body + struct.pack(">H", sum(head + body) & 0xFFFF)


def encode(hz: float, angle_deg: float, samples: list[tuple[int, int]]) -> bytes:
    """Make a packet of samples: quality, and distance [mm / 4], 0 without an echo."""
    body = struct.pack(">BhH", round(hz * 20), 0, round(angle_deg * 100))
    return _packet(0xAD, body + b"".join(struct.pack(">BH", *one) for one in samples))


def encode_speed(hz: float) -> bytes:
    """Make a packet of a head that turns too slowly to measure."""
    return _packet(0xAE, bytes([round(hz * 20)]))


class Delta2(DegreeLidar):
    """The sensor; see the module."""

    def __init__(
        self,
        mount: Mount,
        errors: LidarSpec,
        rng: np.random.Generator,
        *,
        baud: int,
        turn: tuple[int, int],
    ) -> None:
        packets, samples = turn
        facts = LidarFacts(baud, 6.0, 0.13, 8.0, steps=packets * samples)
        super().__init__(facts, samples, mount, errors, rng)
        self._packets = packets
        self._fast_ns = 0

    def restart(self, now_ns: int) -> None:
        """Start streaming, before the head is fast enough."""
        super().restart(now_ns)
        self._fast_ns = now_ns + SPIN_UP_NS
        self._send(now_ns, encode_speed(2.0))

    def _encode(self, index: int, hz: float, ranges_mm: list[int]) -> bytes:
        samples = [(QUALITY if mm else 0, min(4 * mm, 0xFFFF)) for mm in ranges_mm]
        return encode(hz, index * 360.0 / self._packets, samples)

    def _send(self, due_ns: int, data: bytes) -> None:
        super()._send(due_ns, encode_speed(4.0) if due_ns < self._fast_ns else data)


LIDARS: dict[str, MakeLidar] = {
    "delta2a": partial(Delta2, baud=115200, turn=A_TURN),
    "delta2b": partial(Delta2, baud=230400, turn=B_TURN),
}
