"""Camsense X1."""

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
    distance_m,
)
from bench.base.lidars.xv11 import folded_sum

from trolley_base.drivers.lidars import camsense


def camsense_frame(angle_deg: float, step_deg: float, hz: float, samples: list[int]) -> bytes:
    """Make a frame of 8 distances [mm]."""
    first, last = (
        0xA000 + round(deg % 360.0 * 64) % 23040 for deg in (angle_deg, angle_deg + 7 * step_deg)
    )
    body = struct.pack("<4BHH", 0x55, 0xAA, 3, 8, round(hz * 3840), first)
    body += b"".join(struct.pack("<HB", mm, 50) for mm in samples) + struct.pack("<H", last)
    return body + struct.pack("<H", folded_sum(body))


def camsense_stream() -> Iterator[Frame]:
    """2080 samples a second, 400 a turn."""
    hz, index = 5.2, 0
    while True:
        angles = [(index + i) * 0.9 % 360.0 for i in range(8)]
        index += 8
        samples = [round(1000 * distance_m(angle)) for angle in angles]
        yield Frame((index - 1) / 2080.0, camsense_frame(angles[0], 0.9, hz, samples))


def camsense_length(data: bytes) -> int | None:
    """55 AA 03 08, 36 bytes."""
    head = b"\x55\xaa\x03\x08"
    if not head.startswith(data[:4]):
        return 0
    return None if len(data) < 4 else 36


def camsense_check(frame: bytes) -> bool:
    """The sum of an XV11, and two angles that are some."""
    is_right = folded_sum(frame[:34]) == frame[34] | frame[35] << 8
    return is_right and frame[7] >= 0xA0 and frame[33] >= 0xA0


def camsense_samples(frame: bytes) -> Polar:
    """Eight, evenly between two angles."""
    first, last = (struct.unpack_from("<H", frame, at)[0] for at in (6, 32))
    step = (last - first) % 23040 / 7
    distances = [frame[8 + 3 * i] | frame[9 + 3 * i] << 8 for i in range(8)]
    return [
        ((first - 0xA000 + i * step) / 64 % 360, 0 if mm >= 0x8000 else mm)
        for i, mm in enumerate(distances)
    ]


RECORDS = {
    "Camsense X1": LidarRecord(
        model="camsense_x1",
        baud=115200,
        turns_hz=5.2,
        samples_per_s=2080.0,
        ramp_bytes=6 * 36,
        stream=camsense_stream,
        finder=lambda: PlainFrames(camsense_length, camsense_check),
        reader=lambda: camsense_samples,
        examples=(
            Example(
                "55 AA 03 08 00 4E 80 B6 E8 03 32 E9 03 32 EA 03 32 EB 03 32 EC 03 32 ED 03 32"
                "EE 03 32 EF 03 32 00 B8 80 21",
                np.linspace(90.0, 96.0, 8),
                np.arange(1.0, 1.0075, 0.001),
                [50] * 8,
                5.2,
            ),
        ),
        form=camsense.FORMAT,
        header=b"\x55\xaa\x03\x08",
        judged=Judged(camsense.CamsenseDecoder),
    ),
}
