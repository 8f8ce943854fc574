"""Frames whose bytes are known, as the makers' documents give them or their rules make them."""

import struct
from collections import Counter
from collections.abc import Callable
from functools import reduce
from operator import xor

import numpy as np
import pytest
from bench.base.lidars.catalogue import RECORDS
from bench.base.lidars.record import Example
from bench.base.lidars.rplidar import capsule
from bench.base.lidars.xv11 import xv11_frame

from trolley_base.drivers.lidars.coin_d4 import CoinDecoder
from trolley_base.drivers.lidars.decoding import Decoded, Decoder
from trolley_base.drivers.lidars.ld19 import triangulation_deg as ld14p_deg
from trolley_base.drivers.lidars.rplidar import request, start_mode
from trolley_base.drivers.lidars.rplidar_capsules import DENSE as DENSE_KIND
from trolley_base.drivers.lidars.rplidar_capsules import ULTRA_DENSE, CapsuleDecoder
from trolley_base.drivers.lidars.xv11 import Xv11Decoder
from trolley_base.drivers.lidars.ydlidar import triangulation_deg


def decoded(decoder: Decoder, data: bytes) -> Decoded:
    result = decoder.decode(data)
    assert result is not None
    return result


EXAMPLES = [
    pytest.param(record.judged.decoder, example, id=title)
    for title, record in RECORDS.items()
    if record.judged is not None
    for example in record.examples
]


@pytest.mark.parametrize(("make", "example"), EXAMPLES)
def test_an_example_says_what_its_maker_says(
    make: Callable[[Counter[str]], Decoder], example: Example
) -> None:
    result = decoded(make(Counter()), bytes.fromhex(example.data))
    assert result.samples.angle_deg == pytest.approx(np.asarray(example.angle_deg))
    assert result.samples.range_m == pytest.approx(np.asarray(example.range_m))
    assert result.samples.intensity.tolist() == np.asarray(example.intensity).tolist()
    if example.turns_hz is not None:
        assert result.turns_hz == pytest.approx(example.turns_hz)


def test_an_ld14p_looks_from_beside_its_axis() -> None:
    # By hand: atan(100.25 / 1005.9), atan(-7.05 / 105.9); far away atan(0.11923).
    assert ld14p_deg(np.array([1.0, 0.1, 0.0])) == pytest.approx([-5.691, 3.810, -6.798], abs=2e-3)


def test_coin_d4_packs_an_intensity_between_two_bytes() -> None:
    # 0x5A is 01 011010: its low six bits are above those of the first byte, its high two below
    # those of the second.
    frame = bytes.fromhex("AA550001 01050105") + bytes([0, 0]) + bytes([0x1A << 2, 0xA0 | 1, 0x0F])
    even = frame[0] ^ frame[2] ^ frame[4] ^ frame[6] ^ frame[10] ^ frame[11]
    odd = frame[1] ^ frame[3] ^ frame[5] ^ frame[7] ^ frame[12]
    result = decoded(CoinDecoder(Counter()), frame[:8] + bytes([even, odd]) + frame[10:])
    assert result.samples.intensity.tolist() == [0x5A]
    assert result.samples.range_m == pytest.approx([1.0])


def test_the_x4_looks_from_beside_its_axis() -> None:
    assert triangulation_deg(np.array([1.0, 8.0, 0.1553])) == pytest.approx(
        [-6.762, -7.837, 0.0], abs=5e-4
    )


def test_a_capsule_tells_its_angles_with_the_next() -> None:
    # 10 deg to 42 deg: a degree a sample, of which the lags are taken away.
    first = capsule(False, 10.0, [(1000 + k, k) for k in range(32)])
    decoder = CapsuleDecoder(Counter())
    assert decoder.decode(first) is None
    samples = decoded(decoder, capsule(False, 42.0, [(0, 0)] * 32)).samples
    assert samples.angle_deg == pytest.approx(np.arange(10.0, 42.0))
    assert samples.shift_deg == pytest.approx(-np.arange(32) / 8)
    assert samples.range_m == pytest.approx((1000 + np.arange(32)) / 1000)


@pytest.mark.parametrize("between", [b"\x00", capsule(False, 20.0, [(1, 0)] * 32)[:-1] + b"\x55"])
def test_a_capsule_before_a_damaged_one_is_dropped(between: bytes) -> None:
    decoder = CapsuleDecoder(Counter())
    assert decoder.decode(capsule(False, 10.0, [(1000, 0)] * 32) + between) is None
    assert decoder.decode(capsule(False, 42.0, [(1000, 0)] * 32)) is None
    assert decoder.decode(capsule(False, 74.0, [(1000, 0)] * 32)) is not None


def test_a_capsule_before_one_that_begins_a_scan_is_dropped() -> None:
    decoder = CapsuleDecoder(Counter())
    assert decoder.decode(capsule(False, 10.0, [(1000, 0)] * 32)) is None
    assert decoder.decode(capsule(True, 42.0, [(1000, 0)] * 32)) is None
    assert decoder.decode(capsule(False, 74.0, [(1000, 0)] * 32)) is not None


DENSE = bytes.fromhex("A659 8016") + np.arange(1000, 1040, dtype="<u2").tobytes()


def test_a_dense_capsule() -> None:
    decoder = CapsuleDecoder(Counter(), 200e-6, DENSE_KIND)
    following = bytes.fromhex("A053 802C") + DENSE[4:]  # from 178 degrees on
    following = checked(following[2:])
    assert checked(DENSE[2:]) == DENSE
    samples = decoded(decoder, DENSE + following).samples
    assert samples.angle_deg == pytest.approx(90.0 + np.arange(40) * 88.0 / 40)
    assert samples.range_m == pytest.approx(np.arange(1.0, 1.0395, 0.001))
    assert not samples.shift_deg.any()
    assert len(samples.intensity) == 0


def test_ultra_dense_samples_of_each_scale() -> None:
    packed = [0x057D0, 0x0A4F9, 0x14716, 0x2847F]
    cabins = b"".join(
        struct.pack("<HHB", one & 0xFFFF, two & 0xFFFF, one >> 16 | two >> 16 << 4)
        for one, two in (packed[:2], packed[2:])
    )
    first = checked(bytes(6) + b"\x80\x16" + cabins + bytes(150))
    after = checked(bytes(6) + b"\x80\x2c" + bytes(160))
    samples = decoded(CapsuleDecoder(Counter(), 31.25e-6, ULTRA_DENSE), first + after).samples
    assert samples.range_m[:6] == pytest.approx([1.0, 3.0, 9.999, 26.002, 0.0, 0.0])
    assert samples.intensity[:6].tolist() == [5, 10, 20, 40, 0, 0]


@pytest.mark.parametrize(
    ("command", "sent"),
    [
        (start_mode(1), "A5 82 05 01 00 00 00 00 23"),
        (start_mode(3), "A5 82 05 03 00 00 00 00 21"),
        (request(0x84, struct.pack("<I", 0x7C)), "A5 84 04 7C 00 00 00 59"),
        (request(0x84, struct.pack("<IH", 0x71, 1)), "A5 84 06 71 00 00 00 01 00 57"),
        (request(0x84, struct.pack("<I", 1)), "A5 84 04 01 00 00 00 24"),
        (request(0xA8, struct.pack("<H", 600)), "A5 A8 02 58 02 55"),
        (request(0xA8, bytes(2)), "A5 A8 02 00 00 0F"),
        (request(0xF0, struct.pack("<H", 660)), "A5 F0 02 94 02 C1"),
    ],
)
def test_what_an_rplidar_is_sent(command: bytes, sent: str) -> None:
    assert command == bytes.fromhex(sent)


def checked(body: bytes) -> bytes:
    """A capsule of what its check is of."""
    check = reduce(xor, body)
    return bytes([0xA0 | check & 15, 0x50 | check >> 4]) + body


def test_an_xv11_distance_marked_invalid_is_none() -> None:
    frame = xv11_frame(3, 300.0, [(0x8035, 0), (0x4000 | 700, 9), (0x8000 | 900, 1), (5000, 2)])
    result = decoded(Xv11Decoder(Counter()), frame)
    assert result.samples.range_m == pytest.approx([0.0, 0.7, 0.0, 5.0])
