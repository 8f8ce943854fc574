"""The express scan of an RPLIDAR A1: capsules of 84 bytes, 32 samples each, 4000 a second.

Capsule: A and the low half of the check, 5 and its high half (XOR of the other 82 bytes), the angle
at the first sample [1/64 deg] with bit 15 set in a capsule that begins a scan, and 16 × (two words,
a byte). A word is a distance [mm / 4] without its two lowest bits; those are, above four bits of
the byte, by how much the beam lags behind the head [1/8 deg].

How far the head turns during a capsule only the next one says. Two belong together if the second
begins right where the first ended and does not begin a scan: nothing is made of a capsule whose
successor was damaged.

Source:
    SLAMTEC rplidar_sdk, `handler_capsules.cpp`.
"""

from collections import Counter

import numpy as np

from trolley_base.drivers.lidars.decoding import Decoded, words
from trolley_base.drivers.lidars.frames import (
    Bytes,
    Flags,
    FrameFinder,
    FrameFormat,
    Frames,
    Indices,
)
from trolley_base.drivers.lidars.revolutions import Rotation, Samples
from trolley_base.drivers.lidars.rplidar_samples import FACTS
from trolley_base.drivers.lidars.scan_grid import Floats

CAPSULE_BYTES, SAMPLES = 84, 32
SAMPLE_S = 254e-6
BEGINS_SCAN = 0x8000


def _lengths(heads: Bytes) -> Indices:
    return np.where((heads[:, 0] >> 4 == 0xA) & (heads[:, 1] >> 4 == 5), CAPSULE_BYTES, 0)


def _check(capsules: Bytes) -> Flags:
    sent = (capsules[:, 0] & 0xF) | ((capsules[:, 1] & 0xF) << 4)
    return np.bitwise_xor.reduce(capsules[:, 2:], axis=1) == sent


FORMAT = FrameFormat(2, CAPSULE_BYTES, _lengths, _check)


def read_cabins(capsules: Bytes) -> tuple[Floats, Floats]:
    """Return distances (n, 32) [m], and by how much each beam lags behind the head [deg].

    Args:
        capsules: (n, 84).
    """
    cabins = capsules[:, 4:].reshape(len(capsules), 16, 5)
    pairs = words(cabins[:, :, :4])
    low = np.stack([cabins[:, :, 4] & 0xF, cabins[:, :, 4] >> 4], axis=2)
    lag = ((pairs & 3) << 4 | low) / 8.0
    return (pairs >> 2).reshape(-1, SAMPLES) / 1000.0, lag.reshape(-1, SAMPLES)


class CapsuleDecoder:
    """Reads capsules.

    Args:
        counts: what goes wrong is added here.
        sample_s: between two samples, as the sensor says.
    """

    def __init__(self, counts: Counter[str], sample_s: float = SAMPLE_S) -> None:
        self._finder = FrameFinder(FORMAT, counts)
        self._rotation = Rotation(FACTS.usual_hz)
        self._sample_s = sample_s
        self._last: Bytes = np.empty((0, CAPSULE_BYTES), np.uint8)

    def decode(self, data: bytes) -> Decoded | None:
        """Return the samples that these bytes complete; None if there are none."""
        frames = self._finder.feed(data)
        if not len(frames):
            return None
        capsules = np.concatenate([self._last, frames.data])
        self._last = frames.data[-1:]
        heads = words(capsules[:, 2:4])[:, 0].astype(np.int64)
        belongs = frames.joins & (heads[-len(frames) :] & BEGINS_SCAN == 0)
        if len(capsules) == len(frames):
            belongs = belongs[1:]
        pairs = np.flatnonzero(belongs)
        return self._samples(capsules, heads, pairs, frames) if len(pairs) else None

    def _samples(self, capsules: Bytes, heads: Indices, pairs: Indices, frames: Frames) -> Decoded:
        """Read the capsules `pairs`, each with the help of the next."""
        start_deg = (heads & ~BEGINS_SCAN) / 64.0
        width_deg = (start_deg[pairs + 1] - start_deg[pairs]) % 360.0
        angle = start_deg[pairs, None] + width_deg[:, None] * (np.arange(SAMPLES) / SAMPLES)
        angle = angle.ravel() % 360.0
        range_m, lag_deg = (values.ravel() for values in read_cabins(capsules[pairs]))
        rates = width_deg / (SAMPLES * self._sample_s)
        angle, elapsed_s, begins = self._rotation.follow(angle, np.repeat(rates, SAMPLES))
        samples = Samples(angle, -lag_deg, elapsed_s, begins, range_m, np.empty(0))
        closing = np.arange(1, len(pairs) + 1) * SAMPLES - 1
        # The arrival of a pair is that of its second capsule.
        second = pairs + 1 - (len(capsules) - len(frames))
        behind = frames.behind[second] + CAPSULE_BYTES
        hz = float(rates[-1]) / 360.0
        return Decoded(samples, closing, behind, hz, ahead_s=SAMPLES * self._sample_s)
