"""The lidar of Neato's vacuum cleaners, and its like of Xiaomi's."""

import struct
from collections.abc import Iterator
from dataclasses import replace

from bench.base.lidars.record import (
    Example,
    Frame,
    Judged,
    LidarRecord,
    PlainFrames,
    Polar,
    degree_stream,
)

from trolley_base.drivers.lidars import xv11


def folded_sum(data: bytes) -> int:
    """Return the checksum of 16-bit words."""
    total = 0
    for (word,) in struct.iter_unpack("<H", data):
        total = (total << 1) + word & 0xFFFF_FFFF
    return ((total & 0x7FFF) + (total >> 15)) & 0x7FFF


def xv11_frame(index: int, rpm: float, samples: list[tuple[int, int]]) -> bytes:
    """Make a frame of 4 distances [mm, with flags] and strengths."""
    body = struct.pack("<BBH", 0xFA, 0xA0 + index, round(rpm * 64))
    body += b"".join(struct.pack("<HH", *sample) for sample in samples)
    return body + struct.pack("<H", folded_sum(body))


def xv11_stream(hz: float = 5.0) -> Iterator[Frame]:
    """90 frames a turn."""
    return degree_stream(4, lambda i, rpm, mm: xv11_frame(i, rpm, [(one, 100) for one in mm]), hz)


def xv11_length(data: bytes) -> int | None:
    """FA and A0...F9, 22 bytes."""
    if data[0] != 0xFA:
        return 0
    return None if len(data) < 2 else 22 * (0xA0 <= data[1] <= 0xF9)


def xv11_check(frame: bytes) -> bool:
    """A sum that folds."""
    return folded_sum(frame[:20]) == frame[20] | frame[21] << 8


def xv11_samples(frame: bytes) -> Polar:
    """Four, a degree each."""
    words = struct.unpack_from("<8H", frame, 4)
    first = 4 * (frame[1] - 0xA0)
    return [(first + i, 0 if one & 0x8000 else one & 0x3FFF) for i, one in enumerate(words[::2])]


XV11 = LidarRecord(
    model="xv11",
    baud=115200,
    turns_hz=5.0,
    samples_per_s=1800.0,
    is_counter_clockwise=True,
    most_unseen=0.4,
    stuck_deg=6.0,
    stream=xv11_stream,
    finder=lambda: PlainFrames(xv11_length, xv11_check),
    reader=lambda: xv11_samples,
    examples=(
        Example(
            "FA A0 00 4B E8 03 64 00 E9 03 64 00 EA 03 64 00 EB 03 64 00 99 30",
            (0.0, 1.0, 2.0, 3.0),
            (1.0, 1.001, 1.002, 1.003),
            [100] * 4,
            5.0,
        ),
    ),
    form=xv11.FORMAT,
    header=b"\xfa\xa0",
    judged=Judged(xv11.Xv11Decoder),
)
RECORDS = {
    "XV11": XV11,
    # Turns the other way round.
    "LDS02RR": replace(
        XV11,
        model="lds02rr",
        is_counter_clockwise=False,
        is_twin=True,
        examples=(),
        form=None,
        judged=None,
    ),
}
