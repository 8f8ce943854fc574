"""Lidar decoders as one writes them first: byte by byte, in plain Python.

They state the rule of acceptance and nothing else: what the fast decoders are measured by, and
compared with.
"""

import itertools
import struct
from collections.abc import Callable
from functools import reduce
from operator import xor

from lidar_streams import crc8

Length = Callable[[bytes], int | None]
"""Of the first bytes: how long the frame is, 0 for none, None while that cannot be told."""


def ld19_length(data: bytes) -> int | None:
    """54 2C, 47 bytes."""
    if data[0] != 0x54:
        return 0
    return None if len(data) < 2 else 47 * (data[1] == 0x2C)


def ld19_check(frame: bytes) -> bool:
    """CRC-8."""
    return crc8(frame[:46]) == frame[46]


def xv11_length(data: bytes) -> int | None:
    """FA and A0...F9, 22 bytes."""
    if data[0] != 0xFA:
        return 0
    return None if len(data) < 2 else 22 * (0xA0 <= data[1] <= 0xF9)


def xv11_check(frame: bytes) -> bool:
    """A sum that folds."""
    total = 0
    for (word,) in struct.iter_unpack("<H", frame[:20]):
        total = (total << 1) + word & 0xFFFFFFFF
    return ((total & 0x7FFF) + (total >> 15)) & 0x7FFF == frame[20] | frame[21] << 8


def lds01_length(data: bytes) -> int | None:
    """FA and A0...DB, 42 bytes."""
    if data[0] != 0xFA:
        return 0
    return None if len(data) < 2 else 42 * (0xA0 <= data[1] <= 0xDB)


def lds01_check(frame: bytes) -> bool:
    """What the sum lacks, twice."""
    return frame[40] == frame[41] == 0xFF - sum(frame[:40]) % 256


def x4_length(data: bytes) -> int | None:
    """AA 55, kind, number of samples, two angles whose lowest bit is set."""
    if data[0] != 0xAA or (len(data) > 1 and data[1] != 0x55):
        return 0
    if len(data) > 3 and not 1 <= data[3] <= 40:
        return 0
    if (len(data) > 4 and not data[4] & 1) or (len(data) > 6 and not data[6] & 1):
        return 0
    return None if len(data) < 7 else 10 + 2 * data[3]


def x4_check(frame: bytes) -> bool:
    """XOR of header, first angle, samples, size with kind, and last angle."""
    header, kind, size, first, last, check = struct.unpack("<HBBHHH", frame[:10])
    samples = struct.unpack(f"<{size}H", frame[10:])
    return reduce(xor, (header, first, *samples, size << 8 | kind, last)) == check


def capsule_length(data: bytes) -> int | None:
    """A. 5., 84 bytes."""
    if data[0] >> 4 != 0xA:
        return 0
    return None if len(data) < 2 else 84 * (data[1] >> 4 == 5)


def capsule_check(frame: bytes) -> bool:
    """XOR of the rest, in two halves."""
    return reduce(xor, frame[2:]) == (frame[0] & 15 | (frame[1] & 15) << 4)


class PlainFrames:
    """Finds frames: at each position a good frame, or on at the next byte."""

    def __init__(self, length: Length, check: Callable[[bytes], bool]) -> None:
        self._length = length
        self._check = check
        self.held = bytearray()
        self.bad = self.skipped = 0

    def feed(self, data: bytes) -> list[bytes]:
        """Return the frames that these bytes complete."""
        found: list[bytes] = []
        for byte in data:
            self.held.append(byte)
            while self.held:
                length = self._length(self.held)
                if length is None or len(self.held) < length:
                    break
                frame = bytes(self.held[:length])
                if length and self._check(frame):
                    found.append(frame)
                    del self.held[:length]
                    continue
                self.bad += length > 0
                self.skipped += 1
                del self.held[0]
        return found


class PlainSamples:
    """Finds the samples of an RPLIDAR's standard scan, by the rule of `rplidar_samples`."""

    def __init__(self, *, in_step: bool) -> None:
        self.held = bytearray()
        self._in_step = in_step
        self._behind: int | None = None
        self._behind_step = 0
        self.lost = self.skipped = 0

    def feed(self, data: bytes) -> list[bytes]:
        """Return the samples that these bytes complete."""
        found: list[bytes] = []
        for byte in data:
            self.held.append(byte)
            while len(self.held) >= (5 if self._in_step else 40):
                if not self._in_step:
                    if self._is_step():
                        self._in_step, self._behind, self._behind_step = True, None, 0
                    else:
                        self._drop()
                    continue
                sample = bytes(self.held[:5])
                if self._accepts(sample):
                    found.append(sample)
                    del self.held[:5]
                else:
                    self._in_step = False
                    self.lost += 1
                    self._drop()
        return found

    def _drop(self) -> None:
        self.skipped += 1
        del self.held[0]

    def _is_step(self) -> bool:
        samples = [bytes(self.held[i : i + 5]) for i in range(0, 40, 5)]
        if not all(map(is_good_sample, samples)) or sum(one[0] & 1 for one in samples) > 1:
            return False
        angles = [sample_angle(one) for one in samples]
        steps = [(b - a + 180.0) % 360.0 - 180.0 for a, b in itertools.pairwise(angles)]
        return all(abs(step) < 20.0 for step in steps) and 0.0 < sum(steps) < 60.0

    def _accepts(self, sample: bytes) -> bool:
        behind = self._behind_step if self._behind is None else self._behind
        starts = sample[0] & 1 == 1
        if not is_good_sample(sample) or behind >= 4000:
            return False
        if starts and self._behind is not None and self._behind < 50:
            return False
        self._behind_step += 1
        if starts:
            self._behind = 1
        elif self._behind is not None:
            self._behind += 1
        return True


def is_good_sample(sample: bytes) -> bool:
    """S and not S differ, the check bit is set, the angle is in the circle."""
    return (
        sample[0] & 1 != sample[0] >> 1 & 1 and sample[1] & 1 == 1 and sample_angle(sample) < 360.0
    )


def sample_angle(sample: bytes) -> float:
    """Degrees."""
    return (sample[1] | sample[2] << 8) / 2 // 1 / 64.0


PLAIN: dict[str, Callable[[], PlainFrames | PlainSamples]] = {
    "RPLIDAR A1 standard": lambda: PlainSamples(in_step=True),
    "RPLIDAR A1 express": lambda: PlainFrames(capsule_length, capsule_check),
    "YDLIDAR X4": lambda: PlainFrames(x4_length, x4_check),
    "LD19": lambda: PlainFrames(ld19_length, ld19_check),
    "XV11": lambda: PlainFrames(xv11_length, xv11_check),
    "LDS-01": lambda: PlainFrames(lds01_length, lds01_check),
}
"""Decoders by the titles of `lidar_streams.STREAMS`."""
