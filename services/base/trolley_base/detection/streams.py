"""Telling a lidar by the frames that it sends unasked.

Sources:
    LDROBOT, LD19 development manual; Neato XV-11 (xv_11_laser_driver); ROBOTIS hls_lfcd_lds_driver.
"""

import struct
from collections.abc import Callable

from trolley_base.detection.found import Found

# Each frame carries a checksum of 8 bits or more besides its header: this many are no accident.
ENOUGH_FRAMES = 5

_LD19_BYTES, _XV11_BYTES, _LDS01_BYTES = 47, 22, 42


def hear_fast(data: bytes) -> Found | None:
    """Recognise what sends at 230400 baud: an LD19 or a running LDS-01."""
    if _has_frames(data, b"\x54\x2c", _LD19_BYTES, _is_ld19):
        return Found("lidar", "ld19", "LDROBOT LD06 / LD19", 230400)
    if _has_frames(data, b"\xfa", _LDS01_BYTES, _is_lds01):
        return Found("lidar", "lds01", "LDS-01 (HLS-LFCD2)", 230400)
    return None


def hear_xv11(data: bytes) -> Found | None:
    """Recognise an XV11, which sends at 115200 baud."""
    if not _has_frames(data, b"\xfa", _XV11_BYTES, _is_xv11):
        return None
    return Found("lidar", "xv11", "Neato XV11", 115200)


def _has_frames(data: bytes, header: bytes, length: int, is_good: Callable[[bytes], bool]) -> bool:
    """Whether the data holds enough frames whose checks hold."""
    count, start = 0, data.find(header)
    while start >= 0 and start + length <= len(data) and count < ENOUGH_FRAMES:
        good = is_good(data[start : start + length])
        count += good
        start = data.find(header, start + (length if good else 1))
    return count >= ENOUGH_FRAMES


def _is_ld19(frame: bytes) -> bool:
    """CRC-8 with polynomial 0x4D over all but the last byte."""
    crc = 0
    for byte in frame[:-1]:
        crc ^= byte
        for _ in range(8):
            crc = (crc << 1) ^ 0x4D if crc & 0x80 else crc << 1
        crc &= 0xFF
    return crc == frame[-1]


def _is_xv11(frame: bytes) -> bool:
    """A folding sum over ten words."""
    total = 0
    for (word,) in struct.iter_unpack("<H", frame[:20]):
        total = (total << 1) + word
    folded = ((total & 0x7FFF) + (total >> 15)) & 0x7FFF
    return 0xA0 <= frame[1] <= 0xF9 and frame[20:] == struct.pack("<H", folded)


def _is_lds01(frame: bytes) -> bool:
    """What the sum of the bytes lacks to 0xFF, twice."""
    check = 0xFF - sum(frame[:40]) % 256
    return 0xA0 <= frame[1] <= 0xDB and frame[40:] == bytes((check, check))
