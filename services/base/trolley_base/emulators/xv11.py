"""The lidar of a Neato XV-11 (firmware 2.4 and later): streams, 90 packets of 4 degrees a turn.

Seen from above its angles grow counter-clockwise; an LDS02RR sends the same and turns the other
way. Its motor has a control of its own here, as on
the boards that are sold for it.

Source:
    xv_11_laser_driver; kaiaai/LDS, LDS_LDS02RR; berndporr/neato-xv11-lidar.
"""

import struct
from functools import partial

import numpy as np

from trolley_base.emulators.degree_lidar import DegreeLidar
from trolley_base.emulators.lidar import LidarFacts, MakeLidar, Mount
from trolley_base.world import LidarSpec

FACTS = LidarFacts(baud=115200, turns_hz=5.0, range_min_m=0.06, range_max_m=5.0, clockwise=False)
FACTS_02RR = LidarFacts(baud=115200, turns_hz=5.0, range_min_m=0.15, range_max_m=6.0)
PER_PACKET = 4
INVALID, NO_SIGNAL = 0x8000, 0x35
STRENGTH_AT_1M = 400


def checksum(data: bytes) -> int:
    """Fold twenty bytes, as ten words, into 15 bits."""
    total = 0
    for (word,) in struct.iter_unpack("<H", data):
        total = (total << 1) + word & 0xFFFFFFFF
    return (total & 0x7FFF) + (total >> 15) & 0x7FFF


def encode(index: int, hz: float, samples: list[tuple[int, int]]) -> bytes:
    """Make a packet of four samples: distance [mm], or a word with bit 15 set, and strength."""
    body = struct.pack("<BBH", 0xFA, 0xA0 + index, round(hz * 60 * 64))
    body += b"".join(struct.pack("<HH", *sample) for sample in samples)
    return body + struct.pack("<H", checksum(body))


class Xv11(DegreeLidar):
    """The sensor; see the module."""

    def __init__(
        self,
        mount: Mount,
        errors: LidarSpec,
        rng: np.random.Generator,
        facts: LidarFacts = FACTS,
    ) -> None:
        super().__init__(facts, PER_PACKET, mount, errors, rng)

    def _encode(self, index: int, hz: float, ranges_mm: list[int]) -> bytes:
        return encode(index, hz, [_sample(mm) for mm in ranges_mm])


def _sample(range_mm: int) -> tuple[int, int]:
    if range_mm == 0:
        return INVALID | NO_SIGNAL, 0
    return range_mm, min(2000, round(STRENGTH_AT_1M * 1000 / range_mm))


LIDARS: dict[str, MakeLidar] = {"xv11": Xv11, "lds02rr": partial(Xv11, facts=FACTS_02RR)}
