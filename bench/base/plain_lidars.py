"""Lidar decoders as one writes them first: byte by byte, in plain Python.

They state the rule of acceptance and nothing else: what the fast decoders are measured by, and
compared with.
"""

import itertools
import math
import struct
from collections.abc import Callable
from functools import partial, reduce
from operator import xor

from bench.base.lidar_streams import crc8

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


def camsense_length(data: bytes) -> int | None:
    """55 AA 03 08, 36 bytes."""
    head = b"\x55\xaa\x03\x08"
    if not head.startswith(data[:4]):
        return 0
    return None if len(data) < 4 else 36


def camsense_check(frame: bytes) -> bool:
    """The sum of an XV11, and two angles that are some."""
    total = 0
    for (word,) in struct.iter_unpack("<H", frame[:34]):
        total = (total << 1) + word & 0xFFFFFFFF
    is_right = ((total & 0x7FFF) + (total >> 15)) & 0x7FFF == frame[34] | frame[35] << 8
    return is_right and frame[7] >= 0xA0 and frame[33] >= 0xA0


def coin_d4_check(frame: bytes) -> bool:
    """Two XORs: of the even bytes before it and two of each sample, and of all others."""
    even = odd = 0
    for at in range(0, 8, 2):
        even, odd = even ^ frame[at], odd ^ frame[at + 1]
    for at in range(10, len(frame), 3):
        even, odd = even ^ frame[at] ^ frame[at + 1], odd ^ frame[at + 2]
    return (even, odd) == (frame[8], frame[9])


def delta2_length(data: bytes) -> int | None:
    """AA, length, 01 61, AD or AE, length of the rest, which fit each other and the kind."""
    known = {0: b"\xaa", 3: b"\x01", 4: b"\x61", 5: b"\xad\xae"}
    if any(data[at] not in known.get(at, bytes(range(256))) for at in range(min(len(data), 8))):
        return 0
    if len(data) < 8:
        return None
    length, rest = data[1] * 256 + data[2], data[6] * 256 + data[7]
    fits = rest in (1, 5) if data[5] == 0xAE else rest in range(8, 5 + 3 * 61 + 1, 3)
    return length + 2 if fits and length == rest + 8 else 0


def delta2_check(frame: bytes) -> bool:
    """The sum of all bytes before it."""
    return sum(frame[:-2]) % 65536 == frame[-2] * 256 + frame[-1]


def hokuyo_length(data: bytes) -> int | None:
    """The command and status 99, a time, 682 steps in 31 full lines and one that is not."""
    head = b"MD0044072501000\n99b\n"
    if not head.startswith(data[:20]):
        return 0
    return None if len(data) < 20 else 20 + 6 + 31 * 66 + 62 + 2 + 1


def hokuyo_check(frame: bytes) -> bool:
    """A sum behind each line, and nothing in the last one."""
    lines = frame[20:].split(b"\n")
    if [len(line) for line in lines] != [5, *[65] * 31, 63, 0, 0]:
        return False
    return all(
        line[-1] == sum(line[:-1]) % 64 + 48 and all(48 <= one < 112 for one in line[:-1])
        for line in lines[:-2]
    )


def lds01_length(data: bytes) -> int | None:
    """FA and A0...DB, 42 bytes."""
    if data[0] != 0xFA:
        return 0
    return None if len(data) < 2 else 42 * (0xA0 <= data[1] <= 0xDB)


def lds01_check(frame: bytes) -> bool:
    """What the sum lacks, twice."""
    return frame[40] == frame[41] == 0xFF - sum(frame[:40]) % 256


def yd_length(data: bytes, sample_bytes: int = 2, most: int = 40) -> int | None:
    """AA 55, kind, number of samples, two angles whose lowest bit is set."""
    if data[0] != 0xAA or (len(data) > 1 and data[1] != 0x55):
        return 0
    if len(data) > 3 and not 1 <= data[3] <= most:
        return 0
    if (len(data) > 4 and not data[4] & 1) or (len(data) > 6 and not data[6] & 1):
        return 0
    return None if len(data) < 7 else 10 + sample_bytes * data[3]


def x4_check(frame: bytes) -> bool:
    """XOR of header, first angle, samples, size with kind, and last angle."""
    header, kind, size, first, last, check = struct.unpack("<HBBHHH", frame[:10])
    samples = struct.unpack(f"<{size}H", frame[10:])
    return reduce(xor, (header, first, *samples, size << 8 | kind, last)) == check


def intensity_check(frame: bytes) -> bool:
    """As before, the intensities words of their own."""
    header, kind, size, first, last, check = struct.unpack("<HBBHHH", frame[:10])
    for one in struct.iter_unpack("<BH", frame[10:]):
        check ^= one[0] ^ one[1]
    return header ^ first ^ (size << 8 | kind) ^ last == check


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
                length = self._length(bytes(self.held))
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
    "RPLIDAR A3": lambda: PlainFrames(ultra_length, capsule_check),
    "RPLIDAR C1": lambda: PlainFrames(capsule_length, capsule_check),
    "RPLIDAR S2": lambda: PlainFrames(capsule_length, capsule_check),
    "RPLIDAR S3": lambda: PlainFrames(ultra_dense_length, capsule_check),
    "YDLIDAR X4": lambda: PlainFrames(yd_length, x4_check),
    "YDLIDAR X2": lambda: PlainFrames(yd_length, x4_check),
    "YDLIDAR G2": lambda: PlainFrames(partial(yd_length, sample_bytes=3), intensity_check),
    "YDLIDAR G4": lambda: PlainFrames(partial(yd_length, most=80), x4_check),
    "YDLIDAR T-mini": lambda: PlainFrames(partial(yd_length, sample_bytes=3), intensity_check),
    "LD19": lambda: PlainFrames(ld19_length, ld19_check),
    "STL-27L": lambda: PlainFrames(ld19_length, ld19_check),
    "LD14P": lambda: PlainFrames(ld19_length, ld19_check),
    "XV11": lambda: PlainFrames(xv11_length, xv11_check),
    "LDS-01": lambda: PlainFrames(lds01_length, lds01_check),
    "Camsense X1": lambda: PlainFrames(camsense_length, camsense_check),
    "Hokuyo URG": lambda: PlainFrames(hokuyo_length, hokuyo_check),
    "COIN-D4": lambda: PlainFrames(partial(yd_length, sample_bytes=3), coin_d4_check),
    "Delta-2A": lambda: PlainFrames(delta2_length, delta2_check),
    "Delta-2G": lambda: PlainFrames(delta2_length, delta2_check),
    "Delta-2B": lambda: PlainFrames(delta2_length, delta2_check),
}
"""Decoders by the titles of `lidar_streams.STREAMS`."""


Polar = list[tuple[float, float]]
"""Angles [deg] and distances [mm]."""


def ld19_samples(frame: bytes) -> Polar:
    """Twelve, evenly between two angles."""
    first, last = struct.unpack_from("<H", frame, 4)[0], struct.unpack_from("<H", frame, 42)[0]
    step = (last - first) % 36000 / 11
    return [
        ((first + i * step) / 100 % 360, frame[6 + 3 * i] | frame[7 + 3 * i] << 8)
        for i in range(12)
    ]


def ld14p_samples(frame: bytes) -> Polar:
    """As an LD19's, each turned back by what its distance says."""
    return [
        (
            (angle - math.degrees(math.atan((0.11923 * mm - 18.975571) / (mm + 5.9)))) % 360
            if mm
            else angle,
            mm,
        )
        for angle, mm in ld19_samples(frame)
    ]


def xv11_samples(frame: bytes) -> Polar:
    """Four, a degree each."""
    words = struct.unpack_from("<8H", frame, 4)
    first = 4 * (frame[1] - 0xA0)
    return [(first + i, 0 if one & 0x8000 else one & 0x3FFF) for i, one in enumerate(words[::2])]


def camsense_samples(frame: bytes) -> Polar:
    """Eight, evenly between two angles."""
    first, last = (struct.unpack_from("<H", frame, at)[0] for at in (6, 32))
    step = (last - first) % 23040 / 7
    distances = [frame[8 + 3 * i] | frame[9 + 3 * i] << 8 for i in range(8)]
    return [
        ((first - 0xA000 + i * step) / 64 % 360, 0 if mm >= 0x8000 else mm)
        for i, mm in enumerate(distances)
    ]


def coin_d4_samples(frame: bytes) -> Polar:
    """Evenly between two angles, 14 bits each."""
    count = frame[3]
    first, last = ((frame[at] + 256 * frame[at + 1]) // 2 for at in (4, 6))
    step = (last - first) % 23040 / max(1, count - 1)
    return [
        ((first + i * step) / 64 % 360, frame[11 + 3 * i] // 4 + 64 * frame[12 + 3 * i])
        for i in range(count)
    ]


def delta2_samples(frame: bytes, packets: int = 16) -> Polar:
    """So many a packet, evenly up to the next packet's angle."""
    if frame[5] == 0xAE:
        return []
    count = (frame[6] * 256 + frame[7] - 5) // 3
    first, found = (frame[11] * 256 + frame[12]) / 100, []
    for i in range(count):
        _, high, low = frame[13 + 3 * i : 16 + 3 * i]
        found.append(((first + i * 360 / packets / count) % 360, (high * 256 + low) / 4))
    return found


def hokuyo_samples(frame: bytes) -> Polar:
    """Three characters a step, of which the 384th looks ahead; nothing in the dark behind."""
    text = b"".join(line[:-1] for line in frame[26:].split(b"\n"))
    found: Polar = []
    for i in range(682):
        high, middle, low = (one - 48 for one in text[3 * i : 3 * i + 3])
        mm = high * 4096 + middle * 64 + low
        found.append(((44 + i - 384) * 360 / 1024 % 360, mm if 20 <= mm <= 5600 else 0))
    return found


def lds01_samples(frame: bytes) -> Polar:
    """Six, a degree each."""
    words = struct.unpack_from("<18H", frame, 4)
    return [(6 * (frame[1] - 0xA0) + i, one) for i, one in enumerate(words[1::3])]


def x4_samples(frame: bytes) -> Polar:
    """Up to forty, each corrected by its distance."""
    size = frame[3]
    first, last = (one >> 1 for one in struct.unpack_from("<HH", frame, 4))
    step = (last - first) % 23040 / 64 / max(size - 1, 1)
    samples: Polar = []
    for i, quarter in enumerate(struct.unpack_from(f"<{size}H", frame, 10)):
        mm = quarter / 4
        beside = math.atan(21.8 * (155.3 - mm) / (155.3 * mm)) if mm else 0.0
        samples.append(((first / 64 + i * step + math.degrees(beside)) % 360, mm))
    return samples


def tmini_samples(frame: bytes) -> Polar:
    """Up to forty, between two angles."""
    size = frame[3]
    first, last = (one >> 1 for one in struct.unpack_from("<HH", frame, 4))
    step = (last - first) % 23040 / 64 / max(size - 1, 1)
    return [
        ((first / 64 + i * step) % 360, quarter // 4)
        for i, (_, quarter) in enumerate(struct.iter_unpack("<BH", frame[10:]))
    ]


def g2_samples(frame: bytes) -> Polar:
    """The same, each corrected by its distance."""
    return [
        (
            (angle + math.degrees(math.atan(21.8 * (155.3 - mm) / (155.3 * mm)))) % 360
            if mm
            else angle,
            mm,
        )
        for angle, mm in tmini_samples(frame)
    ]


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


class PlainDriver:
    """Finds frames and sorts their samples into the degrees of a turn, the nearest first."""

    def __init__(self, title: str) -> None:
        self._finder = PLAIN[title]()
        self._samples = SAMPLES[title]()
        self._degrees = [math.inf] * 360
        self._last_deg = 0.0
        self.turns: list[list[float]] = []

    def feed(self, data: bytes) -> None:
        """Take bytes; whole turns are added to `turns`."""
        for frame in self._finder.feed(data):
            for angle, mm in self._samples(frame):
                if angle < self._last_deg - 180:
                    self.turns.append(self._degrees)
                    self._degrees = [math.inf] * 360
                self._last_deg = angle
                if mm:
                    degree = int(angle)
                    self._degrees[degree] = min(self._degrees[degree], mm)


SAMPLES: dict[str, Callable[[], Callable[[bytes], Polar]]] = {
    "RPLIDAR A1 standard": lambda: standard_samples,
    "RPLIDAR A1 express": lambda: PlainCapsules(32, 2, plain_express),
    "RPLIDAR A3": lambda: PlainCapsules(96, 2, plain_ultra),
    "RPLIDAR C1": lambda: PlainCapsules(40, 2, plain_dense),
    "RPLIDAR S2": lambda: PlainCapsules(40, 2, plain_dense),
    "RPLIDAR S3": lambda: PlainCapsules(64, 8, plain_ultra_dense),
    "YDLIDAR X4": lambda: x4_samples,
    "YDLIDAR X2": lambda: x4_samples,
    "YDLIDAR G2": lambda: g2_samples,
    "YDLIDAR G4": lambda: x4_samples,
    "YDLIDAR T-mini": lambda: tmini_samples,
    "LD19": lambda: ld19_samples,
    "STL-27L": lambda: ld19_samples,
    "LD14P": lambda: ld14p_samples,
    "XV11": lambda: xv11_samples,
    "LDS-01": lambda: lds01_samples,
    "Camsense X1": lambda: camsense_samples,
    "Hokuyo URG": lambda: hokuyo_samples,
    "COIN-D4": lambda: coin_d4_samples,
    "Delta-2A": lambda: delta2_samples,
    "Delta-2G": lambda: partial(delta2_samples, packets=15),
    "Delta-2B": lambda: delta2_samples,
}
"""Readers of frames by the same titles."""
