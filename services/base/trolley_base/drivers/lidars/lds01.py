"""LDS-01, HLS-LFCD2 (TurtleBot3): a sample in each degree, 6 a frame; `b` starts it, `e` stops it.

Frame of 42 bytes: FA, index A0...DB (of 6 degrees each), speed [rpm / 10], 6 × (intensity, distance
[mm], 0), and twice what the sum of the bytes before lacks to FF.

Angles are as the frames number them. ROBOTIS' driver turns the row of degrees round, so that degree
0 comes to lie at 359: everything a degree clockwise of here.

Nobody but one library tells of the sum, and the maker's driver ignores it. So a sensor none of
whose sums was right in a whole turn of frames that followed each other in order is believed from
then on wherever they do; each wrong sum counts as `lidar/bad_checksum`.

It sends 0 for nothing in reach and for what it could not measure alike, as all of them do; but its
reach of 3.5 m ends inside of many a living room, where it would hold every program.

Source:
    ROBOTIS hls_lfcd_lds_driver; thijses/HLS_LFCD for the checksum.
"""

from collections import Counter

import numpy as np

from trolley.config.hardware import LidarConfig
from trolley.drivers import API
from trolley_base.drivers.lidars.decoding import Decoded, FrameDecoder, words
from trolley_base.drivers.lidars.frames import (
    BAD_CHECKSUM,
    Bytes,
    Flags,
    FrameFinder,
    FrameFormat,
    Frames,
    Indices,
)
from trolley_base.drivers.lidars.models import LidarDriver, LidarFacts
from trolley_base.drivers.lidars.streaming import StartedLidar

FRAME_BYTES, SAMPLES = 42, 6
FRAMES_A_TURN = 60
DPS_PER_COUNT = 360.0 / 60.0 / 10.0
START, STOP = b"b", b"e"

FACTS = LidarFacts(
    title="LDS-01",
    baud=230400,
    range_min_m=0.12,
    range_max_m=3.5,
    turns_hz=(4.5, 5.5),
    usual_hz=5.0,
    no_echo="creep",
)


def _lengths(heads: Bytes) -> Indices:
    is_head = (heads[:, 0] == 0xFA) & (heads[:, 1] >= 0xA0) & (heads[:, 1] <= 0xDB)
    return np.where(is_head, FRAME_BYTES, 0)


def _check(frames: Bytes) -> Flags:
    lacks = 0xFF - (frames[:, :40].sum(axis=1, dtype=np.int64) & 0xFF)
    return (frames[:, 40] == lacks) & (frames[:, 41] == lacks)


def _check_nothing(frames: Bytes) -> Flags:
    return np.ones(len(frames), np.bool_)


FORMAT = FrameFormat(2, FRAME_BYTES, _lengths, _check)
UNSUMMED = FrameFormat(2, FRAME_BYTES, _lengths, _check_nothing)


class Lds01Decoder(FrameDecoder):
    """Reads its frames."""

    def __init__(self, counts: Counter[str]) -> None:
        super().__init__(FORMAT, FACTS.usual_hz, counts)
        self._counts = counts
        # Until the first right sum: frames in order, and how many of them there were in a row.
        self._order: InOrder | None = InOrder()
        self._is_summed = True

    def decode(self, data: bytes) -> Decoded | None:
        """Return the samples that these bytes complete; None if there are none."""
        if self._is_summed:
            decoded = super().decode(data)
            if decoded is not None:
                self._order = None
            elif self._order is not None:
                self._order.take(data)
                self._is_summed = self._order.in_a_row < FRAMES_A_TURN
            return decoded
        assert self._order is not None
        frames = self._order.take(data)
        self._counts[BAD_CHECKSUM] += len(frames)
        return self._samples(frames) if len(frames) else None

    def _samples(self, frames: Frames) -> Decoded:
        first = SAMPLES * (frames.data[:, 1].astype(np.float64) - 0xA0)
        angle = first[:, None] + np.arange(SAMPLES)
        numbers = words(frames.data[:, 2:40]).astype(np.float64)
        values = numbers[:, 2::3] / 1000.0, numbers[:, 1::3]
        return self._evenly(frames, angle, numbers[:, 0] * DPS_PER_COUNT, values)


class InOrder:
    """Finds frames by their headers alone: those that follow another, and are next in the turn."""

    def __init__(self) -> None:
        self._finder = FrameFinder(UNSUMMED, Counter())
        self._last: int | None = None
        self.in_a_row = 0

    def take(self, data: bytes) -> Frames:
        """Return the frames in order that these bytes complete."""
        frames = self._finder.feed(data)
        if not len(frames):
            return frames
        number = frames.data[:, 1].astype(np.int64) - 0xA0
        before = np.append(-2 if self._last is None else self._last, number[:-1])
        self._last = int(number[-1])
        fits = frames.joins & ((before + 1) % FRAMES_A_TURN == number)
        breaks = np.flatnonzero(~fits)
        self.in_a_row = (
            len(fits) - 1 - int(breaks[-1]) if len(breaks) else self.in_a_row + len(fits)
        )
        return Frames(frames.data[fits], frames.lengths[fits], frames.behind[fits], fits[fits])


def _make(config: LidarConfig) -> StartedLidar:
    return StartedLidar(FACTS, config, Lds01Decoder, START, STOP)


DRIVERS: dict[str, LidarDriver] = {
    "lds01": LidarDriver(
        FACTS,
        _make,
        frames=FORMAT,
        start=START,
        stop=STOP,
        linorobot_names=("lds01",),
        ros_packages=("hls_lfcd_lds_driver",),
        api=API,
        page="lds-01.md",
        emulator="trolley_base.emulators.lds01:LIDARS",
    )
}
