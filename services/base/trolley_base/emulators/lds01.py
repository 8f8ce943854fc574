"""HLS-LFCD2, the LDS-01 of a TurtleBot3: 60 packets of 6 degrees a turn.

It streams from power-up, like units made since October 2017; `e` stops it, `b`
starts it.

Source:
    hls_lfcd_lds_driver; thijses/HLS_LFCD for the checksum.
"""

import struct

import numpy as np

from trolley_base.emulators.degree_lidar import DegreeLidar
from trolley_base.emulators.lidar import LidarFacts, MakeLidar, Mount
from trolley_base.world import LidarSpec

FACTS = LidarFacts(baud=230400, turns_hz=5.0, range_min_m=0.12, range_max_m=3.5)
PER_PACKET = 6
INTENSITY_AT_1M = 600


def encode(index: int, hz: float, samples: list[tuple[int, int]]) -> bytes:
    """Make a packet of six samples: intensity and distance [mm], in this order."""
    body = struct.pack("<BBH", 0xFA, 0xA0 + index, round(hz * 60 * 10))
    body += b"".join(struct.pack("<HHH", *sample, 0) for sample in samples)
    return body + bytes([0xFF - sum(body) % 256]) * 2


class Lds01(DegreeLidar):
    """The sensor; see the module."""

    def __init__(self, mount: Mount, errors: LidarSpec, rng: np.random.Generator) -> None:
        super().__init__(FACTS, PER_PACKET, mount, errors, rng)

    def receive(self, data: bytes, now_ns: int) -> None:
        """Start at `b`, stop at `e`."""
        for byte in data:
            if byte == ord("b") and self._head is None:
                self.restart(now_ns)
            elif byte == ord("e"):
                self._halt()

    def _encode(self, index: int, hz: float, ranges_mm: list[int]) -> bytes:
        return encode(index, hz, [_sample(mm) for mm in ranges_mm])


def _sample(range_mm: int) -> tuple[int, int]:
    if range_mm == 0:
        return 0, 0
    return min(2000, round(INTENSITY_AT_1M * 1000 / range_mm)), range_mm


LIDARS: dict[str, MakeLidar] = {"lds01": Lds01}
