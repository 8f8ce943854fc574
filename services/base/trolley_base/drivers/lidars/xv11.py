"""XV11 (Neato, firmware 2.4 and 2.6), LDS02RR: stream, a sample in each degree, 4 a frame.

Frame of 22 bytes: FA, index A0...F9 (of 4 degrees each), speed [rpm / 64], 4 × (distance [mm] with
flags in its two highest bits, signal strength), a folding sum of 15 bits. Bit 15 of a distance
marks it as invalid; bit 14 warns of a weak signal and is ignored. The LDS02RR (Xiaomi, Roborock)
turns the other way.

Source:
    xv_11_laser_driver; getSurreal XV Lidar Controller; kaiaai/LDS, LDS_LDS02RR.
"""

from collections import Counter
from dataclasses import replace
from functools import partial

import numpy as np

from trolley.config.hardware import LidarConfig
from trolley.drivers import API
from trolley_base.drivers.lidars.decoding import Decoded, FrameDecoder, words
from trolley_base.drivers.lidars.frames import Bytes, Flags, FrameFormat, Frames, Indices
from trolley_base.drivers.lidars.models import LidarDriver, LidarFacts
from trolley_base.drivers.lidars.streaming import StreamingLidar

FRAME_BYTES, SAMPLES = 22, 4
INVALID, DISTANCE = 0x8000, 0x3FFF
DPS_PER_COUNT = 360.0 / 60.0 / 64.0

FACTS = LidarFacts(
    title="XV11",
    baud=115200,
    range_min_m=0.06,
    range_max_m=5.0,
    turns_hz=(180.0 / 60.0, 349.0 / 60.0),
    usual_hz=5.0,
    clockwise=False,
    speed_hint="Its motor needs a controller outside the sensor: is it set to 300 rpm?",
)
FACTS_02RR = replace(FACTS, title="LDS02RR", range_min_m=0.15, range_max_m=6.0, clockwise=True)
_WEIGHTS = 2 ** np.arange(9, -1, -1)


def _lengths(heads: Bytes) -> Indices:
    is_head = (heads[:, 0] == 0xFA) & (heads[:, 1] >= 0xA0) & (heads[:, 1] <= 0xF9)
    return np.where(is_head, FRAME_BYTES, 0)


def _check(frames: Bytes) -> Flags:
    numbers = words(frames).astype(np.int64)
    total = numbers[:, :10] @ _WEIGHTS
    return ((total & 0x7FFF) + (total >> 15)) & 0x7FFF == numbers[:, 10]


FORMAT = FrameFormat(2, FRAME_BYTES, _lengths, _check)


class Xv11Decoder(FrameDecoder):
    """Reads its frames."""

    def __init__(self, counts: Counter[str]) -> None:
        super().__init__(FORMAT, FACTS.usual_hz, counts)

    def _samples(self, frames: Frames) -> Decoded:
        first = SAMPLES * (frames.data[:, 1].astype(np.float64) - 0xA0)
        angle = first[:, None] + np.arange(SAMPLES)
        numbers = words(frames.data[:, 2:20])
        raw = numbers[:, 1::2]
        range_m = np.where(raw & INVALID, 0.0, (raw & DISTANCE) / 1000.0)
        strength = numbers[:, 2::2].astype(np.float64)
        rate_dps = numbers[:, 0].astype(np.float64) * DPS_PER_COUNT
        return self._evenly(frames, angle, rate_dps, (range_m, strength))


class Xv11(StreamingLidar):
    """The sensor, which only speaks; see the module.

    Raises:
        DriverError: the configuration asks for what it cannot do.
    """

    def __init__(self, facts: LidarFacts, config: LidarConfig) -> None:
        super().__init__(facts, config, Xv11Decoder)


EMULATOR = "trolley_base.emulators.xv11:LIDARS"
DRIVERS: dict[str, LidarDriver] = {
    "xv11": LidarDriver(
        FACTS,
        partial(Xv11, FACTS),
        frames=FORMAT,
        linorobot_names=("xv11",),
        ros_packages=("xv_11_laser_driver",),
        api=API,
        page="xv11.md",
        emulator=EMULATOR,
    ),
    "lds02rr": LidarDriver(
        FACTS_02RR,
        partial(Xv11, FACTS_02RR),
        frames=FORMAT,
        api=API,
        page="xv11.md#lds02rr",
        emulator=EMULATOR,
    ),
}
