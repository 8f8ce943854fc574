"""The scans of RPLIDARs that come in capsules, each with a check: 4000 samples a second and more.

Each capsule begins with A and the low half of the check, 5 and its high half (XOR of all that
follows), and holds the angle at its first sample [1/64 deg] with bit 15 set where a scan begins.

- Express (0x82), 84 bytes: 16 × (two words, a byte). A word is a distance [mm / 4] without its two
  lowest bits; those are, above four bits of the byte, by how much the beam lags behind the head
  [1/8 deg].
- Ultra (0x84), 132 bytes: 32 words of 32 bits with three samples each, one on a scale that coarsens
  with the distance, two by what they differ from it and from the next word's. Where the beam looked
  beside the head is computed from the distance.
- Dense (0x85), 84 bytes: 40 words, distances [mm].
- Ultra dense (0x86), 170 bytes: time, status, angle, 32 × (two words, a byte). A word and half of
  the byte are 20 bits: a scale, a distance on it, how strong the echo was. The SDK also averages
  two neighbours that differ by 2 mm or less; here they stay as they are.

How far the head turns during a capsule only the next one says. Two belong together if the second
begins right where the first ended and does not begin a scan: nothing is made of a capsule whose
successor was damaged. A capsule is taken to leave when its last sample has been measured.

Source:
    SLAMTEC rplidar_sdk, `handler_capsules.cpp`, `sl_lidar_driver.cpp`.
"""

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from trolley_base.drivers.lidars.decoding import Decoded, turned_deg, words
from trolley_base.drivers.lidars.frames import (
    Bytes,
    Flags,
    FrameFinder,
    FrameFormat,
    Frames,
    Indices,
)
from trolley_base.drivers.lidars.revolutions import Rotation, Samples
from trolley_base.drivers.lidars.rplidar_samples import USUAL_HZ
from trolley_base.drivers.lidars.scan_grid import Floats

SAMPLE_S = 254e-6
BEGINS_SCAN = 0x8000
NO_PREDICTION = (-512, 511)
"""Differences that stand for no distance."""
FAR_DEG, NEAR_DEG = 8.0, 7.5
"""By how much a beam of the ultra scan lags behind the head: that finds nothing; nearer than 5 cm.
The SDK says 7.5 for what finds nothing, too, where it does not matter."""
DENSE_BASE_MM = np.array([0, 2046, 8187, 24567])
DENSE_STEP_MM = np.array([2, 3, 4, 5])
"""Of the ultra dense scan, by its scale."""


def _ultra_scale() -> tuple[Indices, Indices]:
    """Return what each number of twelve bits stands for.

    Returns:
        Distances [mm], and the powers of 2 of the steps [mm] in which others differ from them.
    """
    numbers = np.arange(4096)
    found_mm, power = numbers.copy(), np.zeros(4096, np.int64)
    for level, (first, at_mm) in enumerate(
        ((512, 512), (1280, 2048), (1792, 4096), (3328, 16384)), start=1
    ):
        found_mm[first:] = at_mm + (numbers[first:] - first << level)
        power[first:] = level
    return found_mm, power


ULTRA_MM, ULTRA_POWER = _ultra_scale()


@dataclass(frozen=True, slots=True)
class Capsule:
    """A kind of capsule.

    Attributes:
        form: what it looks like.
        samples: in each.
        start_at: where the angle is.
        read: of n capsules and those that follow each: ranges (n, samples) [m], by how much the
            beams lag behind the head (n, samples) [deg], and intensities (n, samples) or (0,).
    """

    form: FrameFormat
    samples: int
    start_at: int
    read: Callable[[Bytes, Bytes], tuple[Floats, Floats, Floats]]


def _lengths(heads: Bytes, length: int) -> Indices:
    return np.where((heads[:, 0] >> 4 == 0xA) & (heads[:, 1] >> 4 == 5), length, 0)


def _check(capsules: Bytes) -> Flags:
    sent = (capsules[:, 0] & 0xF) | ((capsules[:, 1] & 0xF) << 4)
    return np.bitwise_xor.reduce(capsules[:, 2:], axis=1) == sent


def _form(length: int) -> FrameFormat:
    return FrameFormat(2, length, partial(_lengths, length=length), _check)


def _read_express(capsules: Bytes, following: Bytes) -> tuple[Floats, Floats, Floats]:
    del following
    cabins = capsules[:, 4:].reshape(len(capsules), 16, 5)
    pairs = words(cabins[:, :, :4])
    low = np.stack([cabins[:, :, 4] & 0xF, cabins[:, :, 4] >> 4], axis=2)
    lag = ((pairs & 3) << 4 | low) / 8.0
    num = len(capsules)
    return (pairs >> 2).reshape(num, -1) / 1000.0, lag.reshape(num, -1), np.empty(0)


def _read_ultra(capsules: Bytes, following: Bytes) -> tuple[Floats, Floats, Floats]:
    packed = np.ascontiguousarray(capsules[:, 4:]).view("<u4").astype(np.int64)
    first = np.ascontiguousarray(following[:, 4:8]).view("<u4").astype(np.int64)
    numbers = np.concatenate([packed, first], axis=1) & 0xFFF
    major_mm, power = ULTRA_MM[numbers], ULTRA_POWER[numbers]
    own_mm, next_mm = major_mm[:, :-1], major_mm[:, 1:]
    # Where the first of three found nothing, the second differs from the next word's first.
    base_mm = np.where(own_mm == 0, next_mm, own_mm)
    power1 = np.where(own_mm == 0, power[:, 1:], power[:, :-1])
    found_mm = np.empty((*packed.shape, 3), np.int64)
    found_mm[:, :, 0] = own_mm
    found_mm[:, :, 1] = _predicted(packed >> 12 & 0x3FF, base_mm, power1)
    found_mm[:, :, 2] = _predicted(packed >> 22, next_mm, power[:, 1:])
    found_mm = found_mm.reshape(len(capsules), -1)
    return found_mm / 1000.0, ULTRA_LAG_DEG[found_mm], np.empty(0)


def _predicted(difference: Indices, base_mm: Indices, power: Indices) -> Indices:
    """Return distances [mm] of differences in ten bits, in steps of 2 to a power [mm]."""
    signed = difference - (difference >> 9 << 10)
    found_mm = np.maximum(base_mm + (signed << power), 0)
    found_mm[(signed == NO_PREDICTION[0]) | (signed == NO_PREDICTION[1])] = 0
    return found_mm


def _ultra_lag_deg(found_mm: Indices) -> Floats:
    """Return by how much beams lag behind the head, in whole numbers as the SDK computes it."""
    part = 98361 // np.maximum(4 * found_mm, 1)
    whole = int(FAR_DEG * math.pi * 65536.0 / 180.0)
    lag = np.degrees((whole - (part << 6) - part**3 // 98304) / 65536.0)
    lag = np.where(found_mm >= 50, lag, NEAR_DEG)
    return np.where(found_mm > 0, lag, FAR_DEG)


ULTRA_LAG_DEG = _ultra_lag_deg(np.arange(int(ULTRA_MM[-1]) + (512 << int(ULTRA_POWER[-1]))))
"""By the distance [mm], up to the farthest that two numbers can make."""


def _read_dense(capsules: Bytes, following: Bytes) -> tuple[Floats, Floats, Floats]:
    del following
    range_m = words(capsules[:, 4:]) / 1000.0
    return range_m, np.zeros_like(range_m), np.empty(0)


def _read_ultra_dense(capsules: Bytes, following: Bytes) -> tuple[Floats, Floats, Floats]:
    del following
    cabins = capsules[:, 10:].reshape(len(capsules), 32, 5)
    numbers = words(cabins[:, :, :4]).astype(np.int64)
    high = cabins[:, :, 4].astype(np.int64)
    numbers[:, :, 0] |= (high & 0xF) << 16
    numbers[:, :, 1] |= high >> 4 << 16
    numbers = numbers.reshape(len(capsules), -1)
    scale = numbers & 3
    step = numbers >> 2 & (1 << 10 + scale) - 1
    # A reading of 0 on the finest scale is none.
    found_mm = DENSE_BASE_MM[scale] + DENSE_STEP_MM[scale] * step
    strength = numbers >> 12 + scale << scale
    return found_mm / 1000.0, np.zeros(found_mm.shape), strength.astype(np.float64)


EXPRESS = Capsule(_form(84), 32, 2, _read_express)
ULTRA = Capsule(_form(132), 96, 2, _read_ultra)
DENSE = Capsule(_form(84), 40, 2, _read_dense)
ULTRA_DENSE = Capsule(_form(170), 64, 8, _read_ultra_dense)
KINDS: dict[bytes, Capsule] = {
    bytes.fromhex("5400 0040 82"): EXPRESS,
    bytes.fromhex("8400 0040 84"): ULTRA,
    bytes.fromhex("5400 0040 85"): DENSE,
    bytes.fromhex("AA00 0040 86"): ULTRA_DENSE,
}
"""By what the sensor announces: length, that many follow, and which."""


class CapsuleDecoder:
    """Reads capsules.

    Args:
        counts: what goes wrong is added here.
        sample_s: between two samples, as the sensor says.
        kind: of the capsules.
    """

    def __init__(
        self, counts: Counter[str], sample_s: float = SAMPLE_S, kind: Capsule = EXPRESS
    ) -> None:
        self._kind = kind
        self._finder = FrameFinder(kind.form, counts)
        self._rotation = Rotation(USUAL_HZ)
        self._sample_s = sample_s
        self._shares = np.arange(kind.samples) / kind.samples
        self._last: Bytes = np.empty((0, kind.form.most_bytes), np.uint8)

    def decode(self, data: bytes) -> Decoded | None:
        """Return the samples that these bytes complete; None if there are none."""
        frames = self._finder.feed(data)
        if not len(frames):
            return None
        capsules = np.concatenate([self._last, frames.data])
        self._last = frames.data[-1:]
        at = self._kind.start_at
        heads: NDArray[np.int64] = words(capsules[:, at : at + 2])[:, 0].astype(np.int64)
        belongs = frames.joins & (heads[-len(frames) :] & BEGINS_SCAN == 0)
        if len(capsules) == len(frames):
            belongs = belongs[1:]
        pairs = np.flatnonzero(belongs)
        return self._samples(capsules, heads, pairs, frames) if len(pairs) else None

    def _samples(self, capsules: Bytes, heads: Indices, pairs: Indices, frames: Frames) -> Decoded:
        """Read the capsules `pairs`, each with the help of the next."""
        count = self._kind.samples
        start_deg = (heads & ~BEGINS_SCAN) / 64.0
        width_deg = turned_deg(start_deg[pairs], start_deg[pairs + 1])
        angle = start_deg[pairs, None] + width_deg[:, None] * self._shares
        angle = angle.ravel() % 360.0
        range_m, lag_deg, intensity = (
            values.ravel() for values in self._kind.read(capsules[pairs], capsules[pairs + 1])
        )
        rates = width_deg / (count * self._sample_s)
        angle, elapsed_s, begins = self._rotation.follow(angle, np.repeat(rates, count))
        samples = Samples(angle, -lag_deg, elapsed_s, begins, range_m, intensity)
        closing = np.arange(1, len(pairs) + 1) * count - 1
        # The arrival of a pair is that of its second capsule.
        second = pairs + 1 - (len(capsules) - len(frames))
        behind = frames.behind[second] + self._kind.form.most_bytes
        hz = float(rates[-1]) / 360.0
        return Decoded(samples, closing, behind, hz, ahead_s=count * self._sample_s)
