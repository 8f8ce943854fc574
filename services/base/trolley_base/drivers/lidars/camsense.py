"""Camsense X1: streams from power-up, 8 samples a frame, each with its quality.

Frame of 36 bytes: 55 AA 03 08, speed [rpm / 64], angle of the first sample (A000 and 1/64 deg), 8 ×
(distance [mm], quality), angle of the last sample likewise, the folding sum of an XV11 over the 17
words before it. An angle below A000 says that its head does not yet turn evenly: such a frame is
left out. A distance of 0, or with its highest bit set, is none.

Source:
    kaiaai/LDS, LDS_CAMSENSE_X1.
"""

from collections import Counter

import numpy as np

from trolley.config.hardware import LidarConfig
from trolley.drivers import API
from trolley_base.drivers.lidars.decoding import Decoded, FrameDecoder, turned_deg, words
from trolley_base.drivers.lidars.frames import Bytes, Flags, FrameFormat, Frames, Indices
from trolley_base.drivers.lidars.models import LidarDriver, LidarFacts
from trolley_base.drivers.lidars.streaming import StreamingLidar

FRAME_BYTES, SAMPLES = 36, 8
HEAD = (0x55, 0xAA, 0x03, SAMPLES)
FIRST_ANGLE, UNITS_PER_DEG = 0xA000, 64.0
NO_ECHO = 0x8000
DPS_PER_COUNT = 360.0 / 60.0 / 64.0

FACTS = LidarFacts(
    title="Camsense X1",
    baud=115200,
    range_min_m=0.08,
    range_max_m=8.0,
    turns_hz=(4.0, 7.0),
    usual_hz=5.2,
)
_WEIGHTS = 2 ** np.arange(16, -1, -1)


def _lengths(heads: Bytes) -> Indices:
    return np.where((heads == HEAD).all(axis=1), FRAME_BYTES, 0)


def _check(frames: Bytes) -> Flags:
    numbers = words(frames).astype(np.int64)
    total = (numbers[:, :17] @ _WEIGHTS) & 0xFFFF_FFFF
    is_right = ((total & 0x7FFF) + (total >> 15)) & 0x7FFF == numbers[:, 17]
    return is_right & (numbers[:, 3] >= FIRST_ANGLE) & (numbers[:, 16] >= FIRST_ANGLE)


FORMAT = FrameFormat(len(HEAD), FRAME_BYTES, _lengths, _check)


class CamsenseDecoder(FrameDecoder):
    """Reads its frames."""

    def __init__(self, counts: Counter[str]) -> None:
        super().__init__(FORMAT, FACTS.usual_hz, counts)

    def _samples(self, frames: Frames) -> Decoded:
        head = words(frames.data[:, 4:8]).astype(np.float64)
        end = words(frames.data[:, 32:34])[:, 0].astype(np.float64)
        first = (head[:, 1] - FIRST_ANGLE) / UNITS_PER_DEG
        width = turned_deg(first, (end - FIRST_ANGLE) / UNITS_PER_DEG)
        angle = first[:, None] + width[:, None] * (np.arange(SAMPLES) / (SAMPLES - 1))
        points = frames.data[:, 8:32].reshape(len(frames), SAMPLES, 3).astype(np.int64)
        raw = points[:, :, 0] | points[:, :, 1] << 8
        range_m = np.where(raw & NO_ECHO, 0.0, raw / 1000.0)
        quality = points[:, :, 2].astype(np.float64)
        return self._evenly(frames, angle, head[:, 0] * DPS_PER_COUNT, (range_m, quality))


class Camsense(StreamingLidar):
    """The sensor, which only speaks; see the module.

    Raises:
        DriverError: the configuration asks for what it cannot do.
    """

    def __init__(self, config: LidarConfig) -> None:
        super().__init__(FACTS, config, CamsenseDecoder)


DRIVERS: dict[str, LidarDriver] = {
    "camsense_x1": LidarDriver(
        FACTS,
        Camsense,
        frames=FORMAT,
        api=API,
        page="camsense-x1.md",
        emulator="trolley_base.emulators.camsense:LIDARS",
    )
}
