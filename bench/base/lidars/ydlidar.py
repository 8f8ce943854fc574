"""YDLIDAR's."""

import math
import struct
from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial, reduce
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

from trolley_base.drivers.lidars import ydlidar as driver
from trolley_base.drivers.lidars.decoding import Decoder
from trolley_base.emulators import ydlidar


def x4_frame(begins: bool, first_deg: float, last_deg: float, samples: list[int]) -> bytes:
    """Make a frame of distances [mm / 4]."""
    first, last = (round(deg * 64) % 23040 << 1 | 1 for deg in (first_deg, last_deg))
    words = [0x55AA, len(samples) << 8 | begins, first, last, 0, *samples]
    for word in (*words[:4], *samples):
        words[4] ^= word
    return struct.pack(f"<{len(words)}H", *words)


def x4_stream(hz: float = 7.0, per_s: float = 5000.0, most: int = 40) -> Iterator[Frame]:
    """So many samples a second; a turn begins with a frame of one."""
    return yd_stream(hz, per_s, most, looks_beside=True, make=x4_frame)


def yd_stream(
    hz: float,
    per_s: float,
    most: int,
    *,
    looks_beside: bool,
    make: Callable[[bool, float, float, list[int]], bytes],
) -> Iterator[Frame]:
    """Frames of at most so many samples, [mm / 4]."""
    step = 360.0 * hz / per_s
    index = 0
    while True:
        first = index * step % 360.0
        begins = first < step
        count = 1 if begins else min(most, math.ceil((360.0 - first) / step - 1e-9))
        samples = []
        for i in range(count):
            head = first + i * step
            # The beam that finds something at this distance looked beside the head.
            seen = distance_m(head - 7.0 * looks_beside)
            for _ in range(5 * looks_beside):
                offset = 21.8 * (155.3 - 1000 * seen) / (155.3 * 1000 * seen)
                seen = distance_m(head + math.degrees(math.atan(offset)))
            samples.append(round(4000 * seen))
        index += count
        yield Frame((index - 1) / per_s, make(begins, first, first + (count - 1) * step, samples))


def with_intensity(begins: bool, first_deg: float, last_deg: float, samples: list[int]) -> bytes:
    """Make a YDLIDAR's frame with an intensity of 200, and something in the bits beside."""
    first, last = (round(deg * 64) % 23040 for deg in (first_deg, last_deg))
    rows = [(200, one & ~3 | number % 4) for number, one in enumerate(samples)]
    return ydlidar.encode_with_intensity(0.0 if begins else None, (first, last), rows)


def tmini_stream() -> Iterator[Frame]:
    """4000 samples a second, by a sensor that looks where its head points."""
    return yd_stream(9.3, 4000.0, 40, looks_beside=False, make=with_intensity)


def g2_stream() -> Iterator[Frame]:
    """5000 samples a second with intensity."""
    return yd_stream(7.0, 5000.0, 40, looks_beside=True, make=with_intensity)


def g4_stream() -> Iterator[Frame]:
    """9000 samples a second."""
    return x4_stream(7.0, 9000.0, 80)


def x2_stream() -> Iterator[Frame]:
    """3000 samples a second."""
    return x4_stream(6.0, 3000.0)


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


def yd_frames(make: Callable[[int, tuple[int, int], list[int]], bytes], most: int) -> Make:
    """Frames of at most so many samples [mm / 4]."""

    def frames(rng: np.random.Generator) -> list[bytes]:
        at_64, data = int(rng.integers(23040)), []
        for _ in range(3):
            count, width = int(rng.integers(1, most + 1)), int(rng.integers(1, 1000))
            width *= count > 1
            heads = at_64 % 23040, (at_64 + width) % 23040
            data.append(make(int(rng.integers(2)), heads, distances(rng, 65535, count)))
            at_64 += width + int(rng.integers(0, 20))
        return data

    return frames


def plain_yd(begins: int, heads: tuple[int, int], quarters: list[int]) -> bytes:
    """Make a frame without intensities."""
    return ydlidar.encode(7.0 if begins else None, heads, quarters)


def intense_yd(begins: int, heads: tuple[int, int], quarters: list[int]) -> bytes:
    """Make a frame with intensities."""
    rows = [(one % 251, one) for one in quarters]
    return ydlidar.encode_with_intensity(7.0 if begins else None, heads, rows)


def decoder_of(model: str) -> Callable[[Counter[str]], Decoder]:
    """Return what makes the decoder of a model."""
    return lambda counts: driver.YdDecoder(driver.KINDS[model], counts)


SCANS = bytes.fromhex("A55A05000040 81")
"""What begins a stream."""
ENDS = frozenset({b"\xa5\x00", b"\xa5\x65"})


def answers_of(number: int) -> dict[bytes, bytes]:
    """What a model says of itself, of its health, and of its rate; `number` is its own."""
    return {
        b"\xa5\x90": bytes.fromhex("A55A14000000 04") + bytes([number]) + bytes(19),
        b"\xa5\x92": bytes.fromhex("A55A03000000 06 000000"),
        b"\xa5\xd1": bytes.fromhex("A55A01000000 04 02"),
    }


RECORDS = {
    "YDLIDAR X4": LidarRecord(
        model="ydlidar_x4",
        baud=128000,
        turns_hz=7.0,
        samples_per_s=5000.0,
        beside_deg=7.5,
        stream=x4_stream,
        finder=lambda: PlainFrames(yd_length, x4_check),
        reader=lambda: x4_samples,
        examples=(Example("AA 55 01 01 53 AE 53 AE AB 54 00 00", [(0xAE53 >> 1) / 64], [0.0], []),),
        answers=answers_of(6),
        begins={b"\xa5\x60": SCANS},
        ends=ENDS,
        emulated=Start(b"\xa5\x60", SCANS),
        form=driver.FORMAT,
        header=b"\xaa\x55\x00\x28\x01\x00\x01",
        judged=Judged(decoder_of("ydlidar_x4"), yd_frames(plain_yd, 40)),
    ),
    "YDLIDAR X2": LidarRecord(
        model="ydlidar_x2",
        baud=115200,
        turns_hz=6.0,
        samples_per_s=3000.0,
        beside_deg=7.5,
        is_twin=True,
        stream=x2_stream,
        finder=lambda: PlainFrames(yd_length, x4_check),
        reader=lambda: x4_samples,
    ),
    "YDLIDAR G2": LidarRecord(
        model="ydlidar_g2",
        baud=230400,
        turns_hz=7.0,
        samples_per_s=5000.0,
        beside_deg=7.5,
        is_twin=True,
        stream=g2_stream,
        finder=lambda: PlainFrames(partial(yd_length, sample_bytes=3), intensity_check),
        reader=lambda: g2_samples,
        answers=answers_of(15),
        begins={b"\xa5\x60": SCANS},
        ends=ENDS,
        emulated=Start(b"\xa5\x60", SCANS),
        judged=Judged(decoder_of("ydlidar_g2"), yd_frames(intense_yd, 40)),
    ),
    "YDLIDAR G4": LidarRecord(
        model="ydlidar_g4",
        baud=230400,
        turns_hz=7.0,
        samples_per_s=9000.0,
        beside_deg=7.5,
        stream=g4_stream,
        finder=lambda: PlainFrames(partial(yd_length, most=80), x4_check),
        reader=lambda: x4_samples,
        answers=answers_of(5),
        begins={b"\xa5\x60": SCANS},
        ends=ENDS,
        emulated=Start(b"\xa5\x60", SCANS),
        form=driver.FORMAT_G4,
        header=b"\xaa\x55\x00\x50\x01\x00\x01",
        judged=Judged(decoder_of("ydlidar_g4"), yd_frames(plain_yd, 80)),
    ),
    "YDLIDAR T-mini": LidarRecord(
        model="ydlidar_tmini",
        baud=230400,
        turns_hz=9.3,
        samples_per_s=4000.0,
        stream=tmini_stream,
        finder=lambda: PlainFrames(partial(yd_length, sample_bytes=3), intensity_check),
        reader=lambda: tmini_samples,
        examples=(
            Example(
                "AA 55 00 02 01 05 81 05 2F 57 64 A0 0F 65 A4 0F",
                (10.0, 11.0),
                (1.0, 1.001),
                (100.0, 101.0),
            ),
        ),
        answers=answers_of(151),
        begins={b"\xa5\x60": SCANS},
        ends=ENDS,
        emulated=Start(b"\xa5\x60", SCANS),
        form=driver.FORMAT_WITH_INTENSITY,
        header=b"\xaa\x55\x00\x28\x01\x00\x01",
        judged=Judged(decoder_of("ydlidar_tmini"), yd_frames(intense_yd, 40)),
    ),
}
