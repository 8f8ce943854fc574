"""LDROBOT's: LD06 and LD19, STL-27L, LD14P."""

import math
import struct
from collections.abc import Callable, Iterator

import numpy as np
from bench.base.lidars.record import (
    Example,
    Frame,
    Judged,
    LidarRecord,
    PlainFrames,
    Polar,
    distance_m,
    distances,
)

from trolley_base.drivers.lidars import ld19


def crc8(data: bytes) -> int:
    """Compute LDROBOT's CRC-8 bit by bit."""
    crc = 0
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc << 1 ^ (0x4D if crc & 0x80 else 0)) & 0xFF
    return crc


def ld19_frame(angle_deg: float, step_deg: float, speed_dps: float, samples: list[int]) -> bytes:
    """Make a frame of 12 distances [mm]."""
    last_deg = angle_deg + 11 * step_deg
    body = struct.pack(
        "<BBHH", 0x54, 0x2C, round(speed_dps), round(angle_deg * 100) % 36000
    ) + b"".join(struct.pack("<HB", mm, 200) for mm in samples)
    body += struct.pack("<HH", round(last_deg * 100) % 36000, 0)
    return body + bytes([crc8(body)])


def ld19_stream(
    hz: float = 10.0, per_s: float = 4500.0, seen: Callable[[float], float] = distance_m
) -> Iterator[Frame]:
    """So many samples a second, each of what is seen [m] where the head points [deg]."""
    step = 360.0 * hz / per_s
    index = 0
    while True:
        angles = [(index + i) * step % 360.0 for i in range(12)]
        index += 12
        samples = [round(1000 * seen(angle)) for angle in angles]
        yield Frame((index - 1) / per_s, ld19_frame(angles[0], step, 360.0 * hz, samples))


def stl27l_stream() -> Iterator[Frame]:
    """21600 samples a second."""
    return ld19_stream(10.0, 21600.0)


def ld14p_stream() -> Iterator[Frame]:
    """4000 samples a second, by a sensor that looks from beside its axis."""

    def seen(head_deg: float) -> float:
        found = distance_m(head_deg - 6.5)
        for _ in range(5):
            beside = math.atan((119.23 * found - 18.975571) / (1000 * found + 5.9))
            found = distance_m(head_deg - math.degrees(beside))
        return found

    return ld19_stream(6.0, 4000.0, seen)


def ld19_length(data: bytes) -> int | None:
    """54 2C, 47 bytes."""
    if data[0] != 0x54:
        return 0
    return None if len(data) < 2 else 47 * (data[1] == 0x2C)


def ld19_check(frame: bytes) -> bool:
    """CRC-8."""
    return crc8(frame[:46]) == frame[46]


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


def ld_frames(rng: np.random.Generator) -> list[bytes]:
    """Make three frames."""
    first_deg, step = rng.uniform(0.0, 360.0), rng.uniform(0.1, 1.0)
    return [
        ld19_frame((first_deg + 12 * i * step) % 360.0, step, 3600.0, distances(rng, 65535, 12))
        for i in range(3)
    ]


RECORDS = {
    "LD19": LidarRecord(
        model="ld19",
        baud=230400,
        turns_hz=10.0,
        samples_per_s=4500.0,
        stream=ld19_stream,
        finder=lambda: PlainFrames(ld19_length, ld19_check),
        reader=lambda: ld19_samples,
        examples=(
            Example(
                "54 2C 68 08 AB 7E E0 00 E4 DC 00 E2 D9 00 E5 D5 00 E3 D3 00 E4 D0 00 E9 CD 00 E4"
                "CA 00 E2 C7 00 E9 C5 00 E5 C2 00 E5 C0 00 E5 BE 82 3A 1A 50",
                np.linspace(324.27, 334.70, 12),
                [x / 1000 for x in (224, 220, 217, 213, 211, 208, 205, 202, 199, 197, 194, 192)],
                [228, 226, 229, 227, 228, 233, 228, 226, 233, 229, 229, 229],
                2152 / 360,
            ),
        ),
        form=ld19.FORMAT,
        header=b"\x54\x54\x2c",
        judged=Judged(lambda counts: ld19.LdDecoder(ld19.FACTS, counts), ld_frames),
    ),
    "STL-27L": LidarRecord(
        model="stl27l",
        baud=921600,
        turns_hz=10.0,
        samples_per_s=21600.0,
        is_twin=True,
        stream=stl27l_stream,
        finder=lambda: PlainFrames(ld19_length, ld19_check),
        reader=lambda: ld19_samples,
    ),
    "LD14P": LidarRecord(
        model="ld14p",
        baud=230400,
        turns_hz=6.0,
        samples_per_s=4000.0,
        beside_deg=6.4,
        stream=ld14p_stream,
        finder=lambda: PlainFrames(ld19_length, ld19_check),
        reader=lambda: ld14p_samples,
        judged=Judged(
            lambda counts: ld19.LdDecoder(ld19.FACTS_14P, counts, ld19.triangulation_deg),
            ld_frames,
        ),
    ),
}
