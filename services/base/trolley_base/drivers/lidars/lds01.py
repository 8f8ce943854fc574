"""LDS-01, HLS-LFCD2 (TurtleBot3): a sample in each degree, 6 a frame; `b` starts it, `e` stops it.

Frame of 42 bytes: FA, index A0...DB (of 6 degrees each), speed [rpm / 10], 6 × (intensity, distance
[mm], 0), and twice what the sum of the bytes before lacks to FF.

Source:
    ROBOTIS hls_lfcd_lds_driver; thijses/HLS_LFCD for the checksum.
"""

from collections import Counter

import numpy as np

from trolley.config.hardware import LidarConfig, LidarModel
from trolley_base.drivers.lidars.decoding import Decoded, FrameDecoder, words
from trolley_base.drivers.lidars.frames import Bytes, Flags, FrameFormat, Frames, Indices
from trolley_base.drivers.lidars.models import LidarDriver, LidarFacts
from trolley_base.drivers.lidars.streaming import StartedLidar

FRAME_BYTES, SAMPLES = 42, 6
DPS_PER_COUNT = 360.0 / 60.0 / 10.0
START, STOP = b"b", b"e"

FACTS = LidarFacts(
    title="LDS-01",
    baud=230400,
    range_min_m=0.12,
    range_max_m=3.5,
    turns_hz=(4.5, 5.5),
    usual_hz=5.0,
)


def _lengths(heads: Bytes) -> Indices:
    is_head = (heads[:, 0] == 0xFA) & (heads[:, 1] >= 0xA0) & (heads[:, 1] <= 0xDB)
    return np.where(is_head, FRAME_BYTES, 0)


def _check(frames: Bytes) -> Flags:
    lacks = 0xFF - (frames[:, :40].sum(axis=1, dtype=np.int64) & 0xFF)
    return (frames[:, 40] == lacks) & (frames[:, 41] == lacks)


FORMAT = FrameFormat(2, FRAME_BYTES, _lengths, _check)


class Lds01Decoder(FrameDecoder):
    """Reads its frames."""

    def __init__(self, counts: Counter[str]) -> None:
        super().__init__(FORMAT, FACTS.usual_hz, counts)

    def _samples(self, frames: Frames) -> Decoded:
        first = SAMPLES * (frames.data[:, 1].astype(np.float64) - 0xA0)
        angle = first[:, None] + np.arange(SAMPLES)
        numbers = words(frames.data[:, 2:40]).astype(np.float64)
        values = numbers[:, 2::3] / 1000.0, numbers[:, 1::3]
        return self._evenly(frames, angle, numbers[:, 0] * DPS_PER_COUNT, values)


def _make(config: LidarConfig) -> StartedLidar:
    return StartedLidar(FACTS, config, Lds01Decoder, START, STOP)


DRIVERS: dict[LidarModel, LidarDriver] = {
    "lds01": LidarDriver(
        FACTS,
        _make,
        frames=FORMAT,
        start=START,
        stop=STOP,
        linorobot_names=("lds01",),
        ros_packages=("hls_lfcd_lds_driver",),
    )
}
