"""LD06 and LD19 (LDROBOT): streams from power-up, 12 samples a frame, each with its intensity.

Frame of 47 bytes: 54 2C, speed [deg/s], angle of the first sample [0.01 deg], 12 × (distance [mm],
intensity), angle of the last sample, time [ms], CRC-8.

Source:
    LDROBOT, LD19 development manual.
"""

from collections import Counter

import numpy as np

from trolley.config.hardware import LidarConfig, LidarModel
from trolley_base.drivers.lidars.decoding import Decoded, FrameDecoder, words
from trolley_base.drivers.lidars.frames import Bytes, Flags, FrameFormat, Frames, Indices
from trolley_base.drivers.lidars.models import LidarDriver, LidarFacts
from trolley_base.drivers.lidars.streaming import StreamingLidar

FRAME_BYTES, SAMPLES = 47, 12
POLYNOMIAL = 0x4D

FACTS = LidarFacts(
    title="LD19",
    baud=230400,
    range_min_m=0.02,
    range_max_m=12.0,
    turns_hz=(5.0, 13.0),
    usual_hz=10.0,
    speed_hint="Its PWM wire must be tied to ground for it to keep its speed by itself.",
)


def _crc_tables() -> Bytes:
    """Return (47, 256): what each value of each byte adds to the CRC; it is linear over xor."""
    tables = np.empty((FRAME_BYTES, 256), np.uint8)
    tables[-1] = np.arange(256)  # the CRC itself: a good frame's parts cancel
    for byte in range(FRAME_BYTES - 2, -1, -1):
        tables[byte] = tables[byte + 1]
        for _ in range(8):
            tables[byte] = (tables[byte] << 1) ^ (tables[byte] >> 7) * np.uint8(POLYNOMIAL)
    return tables


_TABLES = _crc_tables()
_ROWS = np.arange(FRAME_BYTES)


def _lengths(heads: Bytes) -> Indices:
    return np.where((heads[:, 0] == 0x54) & (heads[:, 1] == 0x2C), FRAME_BYTES, 0)


def _check(frames: Bytes) -> Flags:
    return np.bitwise_xor.reduce(_TABLES[_ROWS, frames], axis=1) == 0


FORMAT = FrameFormat(2, FRAME_BYTES, _lengths, _check)


class Ld19Decoder(FrameDecoder):
    """Reads its frames."""

    def __init__(self, counts: Counter[str]) -> None:
        super().__init__(FORMAT, FACTS.usual_hz, counts)

    def _samples(self, frames: Frames) -> Decoded:
        head = words(frames.data[:, 2:6]).astype(np.float64)
        end = words(frames.data[:, 42:44])[:, 0].astype(np.float64)
        first = head[:, 1] / 100.0
        width = (end / 100.0 - first) % 360.0
        angle = first[:, None] + width[:, None] * (np.arange(SAMPLES) / (SAMPLES - 1))
        points = frames.data[:, 6:42].reshape(len(frames), SAMPLES, 3).astype(np.float64)
        range_m = (points[:, :, 0] + 256.0 * points[:, :, 1]) / 1000.0
        return self._evenly(frames, angle, head[:, 0], (range_m, points[:, :, 2]))


class Ld19(StreamingLidar):
    """The sensor, which only speaks; see the module.

    Raises:
        DriverError: the configuration asks for what it cannot do.
    """

    def __init__(self, config: LidarConfig) -> None:
        super().__init__(FACTS, config, Ld19Decoder)


DRIVERS: dict[LidarModel, LidarDriver] = {
    "ld19": LidarDriver(
        FACTS,
        Ld19,
        frames=FORMAT,
        linorobot_names=("ld06", "ld19"),
        ros_packages=("ldlidar_stl_ros",),
    )
}
