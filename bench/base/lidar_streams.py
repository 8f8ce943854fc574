"""Honest byte streams of each lidar at its full rate, with the truth that they tell.

Newer formats are written by the emulators, which share no code with the drivers.
"""

import math
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from trolley_base.emulators import coin_d4, delta2, hokuyo, rplidar, ydlidar

BITS_PER_BYTE = 10


@dataclass(frozen=True)
class Frame:
    """Bytes that leave the sensor from `at_s` on."""

    at_s: float
    data: bytes


def distance_m(angle_deg: float) -> float:
    """How far it is in a direction of the sensor: a rectangular room, 6 m by 4 m."""
    angle = math.radians(angle_deg)
    return min(3.0 / max(abs(math.cos(angle)), 1e-9), 2.0 / max(abs(math.sin(angle)), 1e-9))


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


def xv11_frame(index: int, rpm: float, samples: list[tuple[int, int]]) -> bytes:
    """Make a frame of 4 distances [mm, with flags] and strengths."""
    body = struct.pack("<BBH", 0xFA, 0xA0 + index, round(rpm * 64))
    body += b"".join(struct.pack("<HH", *sample) for sample in samples)
    total = 0
    for (word,) in struct.iter_unpack("<H", body):
        total = (total << 1) + word
    return body + struct.pack("<H", ((total & 0x7FFF) + (total >> 15)) & 0x7FFF)


def lds01_frame(index: int, rpm: float, samples: list[tuple[int, int]]) -> bytes:
    """Make a frame of 6 intensities and distances [mm]."""
    body = struct.pack("<BBH", 0xFA, 0xA0 + index, round(rpm * 10))
    body += b"".join(struct.pack("<HHH", *sample, 0) for sample in samples)
    return body + bytes([0xFF - sum(body) % 256]) * 2


def x4_frame(begins: bool, first_deg: float, last_deg: float, samples: list[int]) -> bytes:
    """Make a frame of distances [mm / 4]."""
    first, last = (round(deg * 64) % 23040 << 1 | 1 for deg in (first_deg, last_deg))
    words = [0x55AA, len(samples) << 8 | begins, first, last, 0, *samples]
    for word in (*words[:4], *samples):
        words[4] ^= word
    return struct.pack(f"<{len(words)}H", *words)


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


def degree_stream(
    per_frame: int, make: Callable[[int, float, list[int]], bytes], hz: float = 5.0
) -> Iterator[Frame]:
    """A sample in each degree."""
    index = 0
    while True:
        samples = [round(1000 * distance_m(index % 360 + i)) for i in range(per_frame)]
        frame = make(index % 360 // per_frame, 60.0 * hz, samples)
        index += per_frame
        yield Frame((index - 1) / (360.0 * hz), frame)


def xv11_stream(hz: float = 5.0) -> Iterator[Frame]:
    """90 frames a turn."""
    return degree_stream(4, lambda i, rpm, mm: xv11_frame(i, rpm, [(one, 100) for one in mm]), hz)


def camsense_frame(angle_deg: float, step_deg: float, hz: float, samples: list[int]) -> bytes:
    """Make a frame of 8 distances [mm]."""
    first, last = (
        0xA000 + round(deg % 360.0 * 64) % 23040 for deg in (angle_deg, angle_deg + 7 * step_deg)
    )
    body = struct.pack("<4BHH", 0x55, 0xAA, 3, 8, round(hz * 3840), first)
    body += b"".join(struct.pack("<HB", mm, 50) for mm in samples) + struct.pack("<H", last)
    total = 0
    for (word,) in struct.iter_unpack("<H", body):
        total = (total << 1) + word & 0xFFFF_FFFF
    return body + struct.pack("<H", ((total & 0x7FFF) + (total >> 15)) & 0x7FFF)


def camsense_stream() -> Iterator[Frame]:
    """2080 samples a second, 400 a turn."""
    hz, index = 5.2, 0
    while True:
        angles = [(index + i) * 0.9 % 360.0 for i in range(8)]
        index += 8
        samples = [round(1000 * distance_m(angle)) for angle in angles]
        yield Frame((index - 1) / 2080.0, camsense_frame(angles[0], 0.9, hz, samples))


def coin_d4_stream() -> Iterator[Frame]:
    """5000 samples a second, 500 a turn, 20 in the last packet of each."""
    index, heads = 0, [round(i * 0.72 * 64) for i in range(500)]
    while True:
        first = index % 500
        own = heads[first : first + 40]
        points = (coin_d4.point(round(1000 * distance_m(one / 64)), 150) for one in own)
        index += len(own)
        frame = coin_d4.encode(None if first else 100, (own[0], own[-1]), b"".join(points))
        yield Frame((index - 1) / 5000.0, frame)


def delta2_stream(turn: tuple[int, int]) -> Iterator[Frame]:
    """Six turns a second of so many packets with so many samples."""
    packets, per_packet = turn
    step, index = 360.0 / (packets * per_packet), 0
    while True:
        first = index % (packets * per_packet)
        samples = [round(4000 * distance_m((first + i) * step)) for i in range(per_packet)]
        index += per_packet
        frame = delta2.encode(6.0, first * step, [(50, quarters) for quarters in samples])
        yield Frame((index - 1) * step / 360.0 / 6.0, frame)


def hokuyo_stream() -> Iterator[Frame]:
    """Ten scans a second: 682 of 1024 steps in sight, the 384th of them ahead."""
    seen = range(hokuyo.FIRST, hokuyo.LAST + 1)
    values = [round(1000 * distance_m((one - hokuyo.FRONT) * 360.0 / 1024.0)) for one in seen]
    turn = 0
    while True:
        at_s = 0.1 * (turn + (hokuyo.LAST - hokuyo.FRONT) / 1024.0)
        yield Frame(at_s, hokuyo.encode("MD0044072501000", "99", round(1000 * at_s), values))
        turn += 1


def lds01_stream(hz: float = 5.0) -> Iterator[Frame]:
    """60 frames a turn."""
    return degree_stream(6, lambda i, rpm, mm: lds01_frame(i, rpm, [(200, one) for one in mm]), hz)


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


STREAMS: dict[str, tuple[str, int, Callable[[], Iterator[Frame]]]] = {
    "RPLIDAR A1 standard": ("rplidar_a1", 115200, standard_stream),
    "RPLIDAR A1 express": ("rplidar_a1", 115200, express_stream),
    "RPLIDAR A3": ("rplidar_a3", 256000, ultra_stream),
    "RPLIDAR C1": ("rplidar_c1", 460800, dense_stream),
    "RPLIDAR S2": ("rplidar_s2", 1_000_000, fast_dense_stream),
    "RPLIDAR S3": ("rplidar_s3", 1_000_000, ultra_dense_stream),
    "YDLIDAR X4": ("ydlidar_x4", 128000, x4_stream),
    "YDLIDAR X2": ("ydlidar_x2", 115200, x2_stream),
    "YDLIDAR G2": ("ydlidar_g2", 230400, g2_stream),
    "YDLIDAR G4": ("ydlidar_g4", 230400, g4_stream),
    "YDLIDAR T-mini": ("ydlidar_tmini", 230400, tmini_stream),
    "LD19": ("ld19", 230400, ld19_stream),
    "STL-27L": ("stl27l", 921600, stl27l_stream),
    "LD14P": ("ld14p", 230400, ld14p_stream),
    "XV11": ("xv11", 115200, xv11_stream),
    "LDS-01": ("lds01", 230400, lds01_stream),
    "Camsense X1": ("camsense_x1", 115200, camsense_stream),
    "Hokuyo URG": ("hokuyo_urg", 4_000_000, hokuyo_stream),
    "COIN-D4": ("coin_d4", 230400, coin_d4_stream),
    "Delta-2A": ("delta2a", 115200, lambda: delta2_stream(delta2.A_TURN)),
    "Delta-2G": ("delta2a", 115200, lambda: delta2_stream(delta2.G_TURN)),
    "Delta-2B": ("delta2b", 230400, lambda: delta2_stream(delta2.B_TURN)),
}
"""Model, baud and stream by title."""
TURNS_HZ = {
    "RPLIDAR A1 standard": 5.5,
    "RPLIDAR A1 express": 5.5,
    "RPLIDAR A3": 15.0,
    "RPLIDAR C1": 10.0,
    "RPLIDAR S2": 10.0,
    "RPLIDAR S3": 10.0,
    "YDLIDAR X4": 7.0,
    "YDLIDAR X2": 6.0,
    "YDLIDAR G2": 7.0,
    "YDLIDAR G4": 7.0,
    "YDLIDAR T-mini": 9.3,
    "LD19": 10.0,
    "STL-27L": 10.0,
    "LD14P": 6.0,
    "XV11": 5.0,
    "LDS-01": 5.0,
    "Camsense X1": 5.2,
    "Hokuyo URG": 10.0,
    "COIN-D4": 10.0,
    "Delta-2A": 6.0,
    "Delta-2G": 6.0,
    "Delta-2B": 6.0,
}
"""How fast the heads turn in these."""


def chunks(
    frames: Iterator[Frame], baud: int, seconds: float, chunk_s: float
) -> list[tuple[float, bytes]]:
    """Cut a stream into what has arrived at each reading: (time of reading [s], bytes)."""
    data, times = bytearray(), []
    line_s = 0.0
    for frame in frames:
        if frame.at_s >= seconds:
            break
        line_s = max(line_s, frame.at_s)
        for _ in frame.data:
            line_s += BITS_PER_BYTE / baud
            times.append(line_s)
        data += frame.data
    edges = np.searchsorted(times, np.arange(1, int(seconds / chunk_s) + 1) * chunk_s, "right")
    found, start = [], 0
    for number, edge in enumerate(edges.tolist()):
        if edge > start:
            found.append(((number + 1) * chunk_s, bytes(data[start:edge])))
        start = edge
    return found
