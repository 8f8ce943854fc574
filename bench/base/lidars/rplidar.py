"""Slamtec's RPLIDARs, by the scans that they send."""

import itertools
import math
import struct
from collections import Counter
from collections.abc import Callable, Iterator
from functools import reduce
from operator import xor

import numpy as np
from bench.base.lidars.record import (
    Example,
    Frame,
    Judged,
    LidarRecord,
    Make,
    PlainFrames,
    Polar,
    Start,
    distance_m,
    distances,
)

from trolley_base.drivers.lidars import rplidar_capsules, rplidar_samples
from trolley_base.drivers.lidars.decoding import Decoder
from trolley_base.emulators import rplidar


def standard_sample(begins: bool, angle_deg: float, mm: float) -> bytes:
    """Make a sample of an RPLIDAR's standard scan."""
    flags = 15 << 2 | (1 if begins else 2)
    return struct.pack("<BHH", flags, round(angle_deg * 64) % 23040 << 1 | 1, round(mm * 4))


def capsule(begins: bool, angle_deg: float, samples: list[tuple[int, int]]) -> bytes:
    """Make an RPLIDAR's capsule of 32 distances [mm] and lags [1/8 deg]."""
    body = struct.pack("<H", round(angle_deg * 64) % 23040 | begins << 15)
    for (one, lag1), (two, lag2) in zip(samples[::2], samples[1::2], strict=True):
        body += struct.pack(
            "<HHB", one << 2 | lag1 >> 4, two << 2 | lag2 >> 4, (lag2 & 15) << 4 | lag1 & 15
        )
    check = 0
    for byte in body:
        check ^= byte
    return bytes([0xA0 | check & 15, 0x50 | check >> 4]) + body


def standard_stream(hz: float = 5.5) -> Iterator[Frame]:
    """A sample each 508 us."""
    step = 360.0 * hz * 508e-6
    index = 0
    while True:
        angle = index * step % 360.0
        yield Frame(index * 508e-6, standard_sample(angle < step, angle, 1000 * distance_m(angle)))
        index += 1


def express_stream(hz: float = 5.5) -> Iterator[Frame]:
    """A capsule of 32 samples each 8 ms."""
    step = 360.0 * hz * 254e-6
    index = 0
    while True:
        head = index * step % 360.0
        samples = [(round(1000 * distance_m(head + i * step - 7.0)), 56) for i in range(32)]
        yield Frame((index + 31) * 254e-6, capsule(index == 0, head, samples))
        index += 32


def capsule_stream(
    hz: float, sample_s: float, count: int, make: Callable[[bool, int, list[int]], bytes]
) -> Iterator[Frame]:
    """Capsules of so many ranges where the head points; the first of the next goes along."""
    step = 360.0 * hz * sample_s
    index = 0
    while True:
        head = index * step % 360.0
        ranges_mm = [round(1000 * distance_m(head + i * step)) for i in range(count + 1)]
        at_s = (index + count - 1) * sample_s
        yield Frame(at_s, make(index == 0, round(head * 64) % 23040, ranges_mm))
        index += count


def ultra_stream() -> Iterator[Frame]:
    """An A3: 16000 samples a second, by a sensor that looks from beside its axis."""
    step = 360.0 * 15.0 * 62.5e-6
    index = 0
    while True:
        head = index * step % 360.0
        ranges_mm = []
        for i in range(97):
            seen = distance_m(head + i * step - 7.5)
            for _ in range(3):
                part = 98361 / (4000 * seen)
                lag = 8.0 - math.degrees((64 * part + part**3 / 98304) / 65536)
                seen = distance_m(head + i * step - lag)
            ranges_mm.append(round(1000 * seen))
        frame = rplidar.encode_ultra(index == 0, round(head * 64) % 23040, ranges_mm)
        yield Frame((index + 95) * 62.5e-6, frame)
        index += 96


def dense_stream() -> Iterator[Frame]:
    """A C1: 5000 samples a second."""
    return capsule_stream(
        10.0, 200e-6, 40, lambda first, head, mm: rplidar.encode_dense(first, head, mm[:40])
    )


def fast_dense_stream() -> Iterator[Frame]:
    """An S2: 32000 samples a second."""
    return capsule_stream(
        10.0, 31.25e-6, 40, lambda first, head, mm: rplidar.encode_dense(first, head, mm[:40])
    )


def ultra_dense_stream() -> Iterator[Frame]:
    """An S3: 32000 samples a second."""
    return capsule_stream(
        10.0,
        31.25e-6,
        64,
        lambda first, head, mm: rplidar.encode_ultra_dense(first, head, mm[:64], 0),
    )


def capsule_length(data: bytes) -> int | None:
    """A. 5., 84 bytes."""
    if data[0] >> 4 != 0xA:
        return 0
    return None if len(data) < 2 else 84 * (data[1] >> 4 == 5)


def ultra_length(data: bytes) -> int | None:
    """A. 5., 132 bytes."""
    length = capsule_length(data)
    return length and 132


def ultra_dense_length(data: bytes) -> int | None:
    """A. 5., 170 bytes."""
    length = capsule_length(data)
    return length and 170


def capsule_check(frame: bytes) -> bool:
    """XOR of the rest, in two halves."""
    return reduce(xor, frame[2:]) == (frame[0] & 15 | (frame[1] & 15) << 4)


class PlainSamples:
    """Finds the samples of an RPLIDAR's standard scan, by the rule of `rplidar_samples`."""

    def __init__(self, *, in_step: bool) -> None:
        self.held = bytearray()
        self._in_step = in_step
        self._behind: int | None = None
        self._behind_step = 0
        self.bad = self.skipped = 0

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
                    self.bad += 1
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


def standard_samples(frame: bytes) -> Polar:
    """One."""
    return [(sample_angle(frame), (frame[3] | frame[4] << 8) / 4)]


Lagging = list[tuple[float, float]]
"""Distances [mm], and by how much the beams lag behind the head [deg]."""


def plain_express(capsule: bytes, _following: bytes) -> Lagging:
    """Two samples in five bytes."""
    found: Lagging = []
    for at in range(4, 84, 5):
        one, two, low = struct.unpack_from("<HHB", capsule, at)
        for word, rest in ((one, low & 15), (two, low >> 4)):
            found.append((word >> 2, ((word & 3) << 4 | rest) / 8))
    return found


def plain_dense(capsule: bytes, _following: bytes) -> Lagging:
    """Forty words."""
    return [(mm, 0.0) for mm in struct.unpack_from("<40H", capsule, 4)]


def plain_ultra_dense(capsule: bytes, _following: bytes) -> Lagging:
    """Two samples of twenty bits in five bytes."""
    found: Lagging = []
    for at in range(10, 170, 5):
        one, two, high = struct.unpack_from("<HHB", capsule, at)
        for bits in (one | (high & 15) << 16, two | (high >> 4) << 16):
            match bits & 3:
                case 0:
                    mm = 2 * (bits >> 2 & 0x3FF)
                case 1:
                    mm = 2046 + 3 * (bits >> 2 & 0x7FF)
                case 2:
                    mm = 8187 + 4 * (bits >> 2 & 0xFFF)
                case _:
                    mm = 24567 + 5 * (bits >> 2 & 0x1FFF)
            found.append((mm, 0.0))
    return found


def from_ultra_scale(number: int) -> tuple[int, int]:
    """Distance [mm], and by how many bits what differs from it is shifted."""
    if number >= 3328:
        return 16384 + (number - 3328) * 16, 4
    if number >= 1792:
        return 4096 + (number - 1792) * 8, 3
    if number >= 1280:
        return 2048 + (number - 1280) * 4, 2
    if number >= 512:
        return 512 + (number - 512) * 2, 1
    return number, 0


def plain_ultra(capsule: bytes, following: bytes) -> Lagging:
    """Three samples in four bytes, the last of which needs the next capsule's first."""
    packed = [*struct.unpack_from("<32I", capsule, 4), *struct.unpack_from("<I", following, 4)]
    found_mm: list[int] = []
    for one, two in itertools.pairwise(packed):
        (major, shift), (after, after_shift) = (from_ultra_scale(x & 0xFFF) for x in (one, two))
        found_mm.append(major)
        if major == 0 and after != 0:
            major, shift = after, after_shift
        for bits, base, by in ((one >> 12 & 0x3FF, major, shift), (one >> 22, after, after_shift)):
            signed = bits - 1024 if bits >= 512 else bits
            found_mm.append(0 if bits in (0x1FF, 0x200) else max(0, base + signed * 2**by))
    found: Lagging = []
    for mm in found_mm:
        lag = 7.5
        if mm >= 50:
            part = 98361 // (4 * mm)
            whole = int(8 * math.pi * 65536 / 180) - part * 64 - part * part * part // 98304
            lag = math.degrees(whole / 65536)
        found.append((mm, lag))
    return found


class PlainCapsules:
    """Reads capsules, each with the next.

    Args:
        count: of samples in each.
        at: where its angle is.
        read: its samples, of it and the next.
    """

    def __init__(self, count: int, at: int, read: Callable[[bytes, bytes], Lagging]) -> None:
        self._count, self._at, self._read = count, at, read
        self._last: bytes | None = None

    def __call__(self, frame: bytes) -> Polar:
        """Return the samples of the capsule before this one."""
        before, self._last = self._last, frame
        if before is None:
            return []
        at = self._at
        start, end = ((one[at] | one[at + 1] << 8) & 0x7FFF for one in (before, frame))
        step = (end - start) % 23040 / 64 / self._count
        return [
            ((start / 64 + number * step - lag) % 360, mm)
            for number, (mm, lag) in enumerate(self._read(before, frame))
        ]


def capsules(make: Callable[[bool, int, list[int]], bytes], most: int, count: int) -> Make:
    """Capsules of so many ranges below `most` [mm]."""

    def frames(rng: np.random.Generator) -> list[bytes]:
        head_64, width_64 = int(rng.integers(23040)), int(rng.integers(64, 1280))
        # Of the ultra scan a neighbour's distance tells the next one's.
        near = rng.integers(1, most, 5 * (count + 1) // 4 + 4)
        around = np.repeat(near, 4)[: 4 * (count + 1)] + rng.integers(-300, 300, 4 * (count + 1))
        ranges = np.clip(around, 0, most - 1).tolist()
        return [
            make(False, (head_64 + i * width_64) % 23040, ranges[i * count : (i + 1) * count + 1])
            for i in range(3)
        ]

    return frames


def express_frames(rng: np.random.Generator) -> list[bytes]:
    """Make three capsules of the express scan."""
    first_deg = rng.uniform(0.0, 300.0)
    return [
        capsule(
            False,
            first_deg + 15 * i,
            list(zip(distances(rng, 16384, 32), rng.integers(0, 64, 32).tolist(), strict=True)),
        )
        for i in range(3)
    ]


def of_kind(kind: rplidar_capsules.Capsule) -> Callable[[Counter[str]], Decoder]:
    """Return what makes a decoder of such capsules."""
    return lambda counts: rplidar_capsules.CapsuleDecoder(counts, 62.5e-6, kind)


STANDARD, EXPRESS = b"\xa5\x20", bytes.fromhex("A58205000000000022")
"""Requests for the two scans of an A1."""
TYPICAL = bytes.fromhex("A58205 01 0000 0000 23")
TYPICAL_ULTRA = bytes.fromhex("A58205 02 0000 0000 20")
"""Requests for the scan that a newer one is made for."""
PWM = bytes.fromhex("A5F0029402C1")
"""Starts the motor of an A3."""
ULTRA, DENSE, ULTRA_DENSE = (
    bytes.fromhex(text) for text in ("A55A84000040 84", "A55A54000040 85", "A55AAA000040 86")
)
"""What begins their streams."""
OLD_SCANS = {
    STANDARD: bytes.fromhex("A55A05000040 81"),
    EXPRESS: bytes.fromhex("A55A54000040 82"),
}
ENDS = frozenset({b"\xa5\x25", b"\xa5\x40"})
ANSWERS = {
    b"\xa5\x50": bytes.fromhex("A55A14000000 04 18") + bytes(19),
    b"\xa5\x52": bytes.fromhex("A55A03000000 06 000000"),
    b"\xa5\x59": bytes.fromhex("A55A04000000 15") + struct.pack("<HH", 508, 254),
}
"""What an A1 says of itself, its health and its rates."""


def typical_answers(number: int, period: int) -> dict[bytes, bytes]:
    """What a newer one says: its number, and the period of its typical mode [1/256 us]."""
    period_hex = struct.pack("<I", period).hex()
    said = {
        "A58404 7C000000 59": "A55A06000000 20 7C000000 0100",
        "A58406 71000000 0000 56": f"A55A08000000 20 71000000 {period_hex}",
        "A58406 71000000 0100 57": f"A55A08000000 20 71000000 {period_hex}",
        "A58404 01000000 24": "A55A08000000 20 01000000 58020000",
    }
    asked = {bytes.fromhex(question): bytes.fromhex(answer) for question, answer in said.items()}
    info = bytes.fromhex("A55A14000000 04") + bytes([number, 30, 1]) + bytes(17)
    return ANSWERS | {b"\xa5\x50": info} | asked


def scans(typical: bytes) -> dict[bytes, bytes]:
    """The scans that a newer one can send."""
    return OLD_SCANS | {TYPICAL: typical}


RECORDS = {
    "RPLIDAR A1 standard": LidarRecord(
        model="rplidar_a1",
        mode="standard",
        baud=115200,
        turns_hz=5.5,
        samples_per_s=1 / 508e-6,
        stream=standard_stream,
        finder=lambda: PlainSamples(in_step=True),
        reader=lambda: standard_samples,
        answers=ANSWERS,
        begins=OLD_SCANS,
        ends=ENDS,
        emulated=Start(STANDARD, OLD_SCANS[STANDARD]),
        examples=(Example("3D 81 16 A0 0F", [45.0], [1.0], [15]),),
        judged=Judged(rplidar_samples.StandardDecoder),
    ),
    "RPLIDAR A1 express": LidarRecord(
        model="rplidar_a1",
        baud=115200,
        turns_hz=5.5,
        samples_per_s=1 / 254e-6,
        beside_deg=7.0,
        stream=express_stream,
        finder=lambda: PlainFrames(capsule_length, capsule_check),
        reader=lambda: PlainCapsules(32, 2, plain_express),
        answers=ANSWERS,
        begins=OLD_SCANS,
        ends=ENDS,
        emulated=Start(EXPRESS, OLD_SCANS[EXPRESS]),
        form=rplidar_capsules.EXPRESS.form,
        header=b"\xa5\x5a",
        judged=Judged(of_kind(rplidar_capsules.EXPRESS), express_frames),
    ),
    "RPLIDAR A3": LidarRecord(
        model="rplidar_a3",
        baud=256000,
        turns_hz=15.0,
        samples_per_s=16000.0,
        beside_deg=7.7,
        is_coarse=True,
        stream=ultra_stream,
        finder=lambda: PlainFrames(ultra_length, capsule_check),
        reader=lambda: PlainCapsules(96, 2, plain_ultra),
        answers=typical_answers(0x31, 16000),
        begins=scans(ULTRA),
        ends=ENDS,
        emulated=Start(PWM + TYPICAL_ULTRA, ULTRA),
        form=rplidar_capsules.ULTRA.form,
        header=b"\xa5\x5a",
        judged=Judged(of_kind(rplidar_capsules.ULTRA), capsules(rplidar.encode_ultra, 25000, 96)),
    ),
    "RPLIDAR C1": LidarRecord(
        model="rplidar_c1",
        baud=460800,
        turns_hz=10.0,
        samples_per_s=5000.0,
        stream=dense_stream,
        finder=lambda: PlainFrames(capsule_length, capsule_check),
        reader=lambda: PlainCapsules(40, 2, plain_dense),
        answers=typical_answers(0x41, 51200),
        begins=scans(DENSE),
        ends=ENDS,
        emulated=Start(TYPICAL, DENSE),
        judged=Judged(
            of_kind(rplidar_capsules.DENSE),
            capsules(lambda first, head, mm: rplidar.encode_dense(first, head, mm[:40]), 65535, 40),
        ),
    ),
    "RPLIDAR S2": LidarRecord(
        model="rplidar_s2",
        baud=1_000_000,
        turns_hz=10.0,
        samples_per_s=32000.0,
        is_twin=True,
        stream=fast_dense_stream,
        finder=lambda: PlainFrames(capsule_length, capsule_check),
        reader=lambda: PlainCapsules(40, 2, plain_dense),
        answers=typical_answers(0x71, 8000),
        begins=scans(DENSE),
        ends=ENDS,
        emulated=Start(TYPICAL, DENSE),
    ),
    "RPLIDAR S3": LidarRecord(
        model="rplidar_s3",
        baud=1_000_000,
        turns_hz=10.0,
        samples_per_s=32000.0,
        is_twin=True,
        stream=ultra_dense_stream,
        finder=lambda: PlainFrames(ultra_dense_length, capsule_check),
        reader=lambda: PlainCapsules(64, 8, plain_ultra_dense),
        answers=typical_answers(0x81, 8000),
        begins=scans(ULTRA_DENSE),
        ends=ENDS,
        emulated=Start(TYPICAL, ULTRA_DENSE),
        form=rplidar_capsules.ULTRA_DENSE.form,
        header=b"\xa5\x5a",
        judged=Judged(
            of_kind(rplidar_capsules.ULTRA_DENSE),
            capsules(
                lambda first, head, mm: rplidar.encode_ultra_dense(first, head, mm[:64], 7),
                60000,
                64,
            ),
        ),
    ),
}
