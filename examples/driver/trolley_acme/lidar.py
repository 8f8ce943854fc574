"""Acme X1: streams from power-up, ten samples a frame, 36 frames a turn, clockwise.

Frame of 26 bytes: AC 01, number of the frame in its turn, speed [1/20 turns/s], 10 x distance [mm,
16 bits, 0 for none], sum of all bytes before (16 bits). Numbers are little-endian.
"""

from collections import Counter
from functools import partial
from typing import Annotated

import numpy as np
from msgspec import Meta, Struct

from trolley.config.hardware import LidarConfig
from trolley.drivers import read_settings
from trolley_base.drivers.lidars.decoding import Decoded, FrameDecoder, words
from trolley_base.drivers.lidars.frames import Bytes, Flags, FrameFormat, Frames, Indices
from trolley_base.drivers.lidars.models import LidarDriver, LidarFacts
from trolley_base.drivers.lidars.streaming import StreamingLidar

FRAME_BYTES, SAMPLES, FRAMES = 26, 10, 36

FACTS = LidarFacts(
    title="Acme X1",
    baud=460800,
    range_min_m=0.1,
    range_max_m=10.0,
    turns_hz=(4.0, 12.0),
    usual_hz=8.0,
)


class AcmeSettings(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the calibration sheet of an Acme X1 says."""

    add_m: Annotated[float, Meta(ge=-0.1, le=0.1)] = 0.0
    """Added to each distance."""


def _lengths(heads: Bytes) -> Indices:
    return np.where((heads[:, 0] == 0xAC) & (heads[:, 1] == 0x01), FRAME_BYTES, 0)


def _check(frames: Bytes) -> Flags:
    return frames[:, :24].sum(axis=1) == words(frames[:, 24:26])[:, 0]


FORMAT = FrameFormat(2, FRAME_BYTES, _lengths, _check)


class AcmeDecoder(FrameDecoder):
    """Reads its frames.

    Args:
        add_m: added to each distance.
        counts: what goes wrong is added here.
    """

    def __init__(self, add_m: float, counts: Counter[str]) -> None:
        super().__init__(FORMAT, FACTS.usual_hz, counts)
        self._add_m = add_m

    def _samples(self, frames: Frames) -> Decoded:
        width = 360.0 / FRAMES
        first = frames.data[:, 2].astype(np.float64) * width
        angle = first[:, None] + np.arange(SAMPLES) * (width / SAMPLES)
        range_m = words(frames.data[:, 4:24]) / 1000.0
        range_m = np.where(range_m > 0.0, range_m + self._add_m, 0.0)
        rate_dps = frames.data[:, 3].astype(np.float64) * 18.0
        return self._evenly(frames, angle, rate_dps, (range_m, np.zeros_like(range_m)))


def _make(config: LidarConfig) -> StreamingLidar:
    settings = read_settings(config.settings, AcmeSettings, "base.lidar.settings")
    return StreamingLidar(FACTS, config, partial(AcmeDecoder, settings.add_m))


DRIVERS = {
    "acme_x1": LidarDriver(
        FACTS,
        _make,
        frames=FORMAT,
        api=1,
        page="https://acme.example/x1",
        settings=AcmeSettings,
        emulator="trolley_acme.emulators:LIDARS",
    )
}
