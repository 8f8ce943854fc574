"""The LDS-01 of a TurtleBot3."""

import struct
from collections.abc import Iterator

import numpy as np
from bench.base.lidars.record import (
    Example,
    Frame,
    Judged,
    LidarRecord,
    PlainFrames,
    Polar,
    degree_stream,
)

from trolley_base.drivers.lidars import lds01


def lds01_frame(index: int, rpm: float, samples: list[tuple[int, int]]) -> bytes:
    """Make a frame of 6 intensities and distances [mm]."""
    body = struct.pack("<BBH", 0xFA, 0xA0 + index, round(rpm * 10))
    body += b"".join(struct.pack("<HHH", *sample, 0) for sample in samples)
    return body + bytes([0xFF - sum(body) % 256]) * 2


def lds01_stream(hz: float = 5.0) -> Iterator[Frame]:
    """60 frames a turn."""
    return degree_stream(6, lambda i, rpm, mm: lds01_frame(i, rpm, [(200, one) for one in mm]), hz)


def lds01_length(data: bytes) -> int | None:
    """FA and A0...DB, 42 bytes."""
    if data[0] != 0xFA:
        return 0
    return None if len(data) < 2 else 42 * (0xA0 <= data[1] <= 0xDB)


def lds01_check(frame: bytes) -> bool:
    """What the sum lacks, twice."""
    return frame[40] == frame[41] == 0xFF - sum(frame[:40]) % 256


def lds01_samples(frame: bytes) -> Polar:
    """Six, a degree each."""
    words = struct.unpack_from("<18H", frame, 4)
    return [(6 * (frame[1] - 0xA0) + i, one) for i, one in enumerate(words[1::3])]


RECORDS = {
    "LDS-01": LidarRecord(
        model="lds01",
        baud=230400,
        turns_hz=5.0,
        samples_per_s=1800.0,
        most_unseen=0.4,
        stuck_deg=6.0,
        stream=lds01_stream,
        finder=lambda: PlainFrames(lds01_length, lds01_check),
        reader=lambda: lds01_samples,
        examples=(
            Example(
                "FA A0 B8 0B C8 00 E8 03 00 00 C8 00 E9 03 00 00 C8 00 EA 03 00 00 C8 00 EB 03"
                "00 00 C8 00 EC 03 00 00 C8 00 ED 03 00 00 61 61",
                (0.0, 1.0, 2.0, 3.0, 4.0, 5.0),
                np.arange(1.0, 1.0055, 0.001),
                [200] * 6,
                5.0,
            ),
        ),
        form=lds01.FORMAT,
        header=b"\xfa\xdb",
        judged=Judged(lds01.Lds01Decoder),
    ),
}
