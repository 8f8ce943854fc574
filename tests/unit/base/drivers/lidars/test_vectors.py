"""Frames whose bytes are known, as the makers' documents give them or their rules make them."""

import struct
from collections import Counter
from functools import reduce
from operator import xor

import numpy as np
import pytest
from bench.base.lidar_streams import capsule

from trolley_base.drivers.lidars import delta2
from trolley_base.drivers.lidars.camsense import CamsenseDecoder
from trolley_base.drivers.lidars.coin_d4 import CoinDecoder
from trolley_base.drivers.lidars.decoding import Decoded, Decoder
from trolley_base.drivers.lidars.ld19 import FACTS, LdDecoder
from trolley_base.drivers.lidars.ld19 import triangulation_deg as ld14p_deg
from trolley_base.drivers.lidars.lds01 import Lds01Decoder
from trolley_base.drivers.lidars.rplidar import request, start_mode
from trolley_base.drivers.lidars.rplidar_capsules import DENSE as DENSE_KIND
from trolley_base.drivers.lidars.rplidar_capsules import ULTRA_DENSE, CapsuleDecoder
from trolley_base.drivers.lidars.rplidar_samples import StandardDecoder
from trolley_base.drivers.lidars.xv11 import Xv11Decoder
from trolley_base.drivers.lidars.ydlidar import KINDS, YdDecoder, triangulation_deg


def decoded(decoder: Decoder, data: bytes) -> Decoded:
    result = decoder.decode(data)
    assert result is not None
    return result


def test_ld19() -> None:
    frame = bytes.fromhex(
        "54 2C 68 08 AB 7E E0 00 E4 DC 00 E2 D9 00 E5 D5 00 E3 D3 00 E4 D0 00 E9 CD 00 E4"
        "CA 00 E2 C7 00 E9 C5 00 E5 C2 00 E5 C0 00 E5 BE 82 3A 1A 50"
    )
    result = decoded(LdDecoder(FACTS, Counter()), frame)
    assert result.samples.angle_deg[[0, -1]] == pytest.approx([324.27, 334.70])
    assert np.diff(result.samples.angle_deg) == pytest.approx(10.43 / 11)
    assert result.samples.range_m[[0, -1]] == pytest.approx([0.224, 0.192])
    assert result.samples.intensity[[0, -1]].tolist() == [228, 229]
    assert result.turns_hz == pytest.approx(2152 / 360)


def test_an_ld14p_looks_from_beside_its_axis() -> None:
    # By hand: atan(100.25 / 1005.9), atan(-7.05 / 105.9); far away atan(0.11923).
    assert ld14p_deg(np.array([1.0, 0.1, 0.0])) == pytest.approx([-5.691, 3.810, -6.798], abs=2e-3)


def test_xv11() -> None:
    frame = bytes.fromhex("FA A0 00 4B E8 03 64 00 E9 03 64 00 EA 03 64 00 EB 03 64 00 99 30")
    result = decoded(Xv11Decoder(Counter()), frame)
    assert result.samples.angle_deg.tolist() == [0, 1, 2, 3]
    assert result.samples.range_m == pytest.approx([1.0, 1.001, 1.002, 1.003])
    assert result.samples.intensity.tolist() == [100] * 4
    assert result.turns_hz == pytest.approx(5.0)


def test_camsense_x1() -> None:
    frame = bytes.fromhex(
        "55 AA 03 08 00 4E 80 B6 E8 03 32 E9 03 32 EA 03 32 EB 03 32 EC 03 32 ED 03 32 EE 03 32"
        "EF 03 32 00 B8 80 21"
    )
    result = decoded(CamsenseDecoder(Counter()), frame)
    assert result.samples.angle_deg[[0, -1]] == pytest.approx([90.0, 96.0])
    assert result.samples.range_m == pytest.approx(np.arange(1.0, 1.0075, 0.001))
    assert result.samples.intensity.tolist() == [50] * 8
    assert result.turns_hz == pytest.approx(5.2)


def test_coin_d4() -> None:
    frame = bytes.fromhex("AA55C902 01050106 0B54 00A00F 00C80F")
    result = decoded(CoinDecoder(Counter()), frame)
    assert result.samples.angle_deg == pytest.approx([10.0, 12.0])
    assert result.samples.range_m == pytest.approx([1.0, 1.01])
    assert result.turns_hz == pytest.approx(10.0)


def test_coin_d4_packs_an_intensity_between_two_bytes() -> None:
    # 0x5A is 01 011010: its low six bits are above those of the first byte, its high two below
    # those of the second.
    frame = bytes.fromhex("AA550001 01050105") + bytes([0, 0]) + bytes([0x1A << 2, 0xA0 | 1, 0x0F])
    even = frame[0] ^ frame[2] ^ frame[4] ^ frame[6] ^ frame[10] ^ frame[11]
    odd = frame[1] ^ frame[3] ^ frame[5] ^ frame[7] ^ frame[12]
    result = decoded(CoinDecoder(Counter()), frame[:8] + bytes([even, odd]) + frame[10:])
    assert result.samples.intensity.tolist() == [0x5A]
    assert result.samples.range_m == pytest.approx([1.0])


def test_delta2() -> None:
    frame = bytes.fromhex("AA001601 61AD000E 7800000960 320FA0 320FA4 320FA8 056D")
    result = decoded(delta2.Delta2Decoder(delta2.FACTS_2A, Counter()), frame)
    assert result.samples.angle_deg == pytest.approx([24.0, 31.5, 39.0])
    assert result.samples.range_m == pytest.approx([1.0, 1.001, 1.002])
    assert result.samples.intensity.tolist() == [50] * 3
    assert result.turns_hz == pytest.approx(6.0)


def test_lds01() -> None:
    frame = bytes.fromhex(
        "FA A0 B8 0B C8 00 E8 03 00 00 C8 00 E9 03 00 00 C8 00 EA 03 00 00 C8 00 EB 03 00 00"
        "C8 00 EC 03 00 00 C8 00 ED 03 00 00 61 61"
    )
    result = decoded(Lds01Decoder(Counter()), frame)
    assert result.samples.angle_deg.tolist() == [0, 1, 2, 3, 4, 5]
    assert result.samples.range_m == pytest.approx(np.arange(1.0, 1.0055, 0.001))
    assert result.samples.intensity.tolist() == [200] * 6
    assert result.turns_hz == pytest.approx(5.0)


def test_ydlidar_x4() -> None:
    result = decoded(
        YdDecoder(KINDS["ydlidar_x4"], Counter()),
        bytes.fromhex("AA 55 01 01 53 AE 53 AE AB 54 00 00"),
    )
    assert result.samples.angle_deg.tolist() == [(0xAE53 >> 1) / 64]
    assert result.samples.range_m.tolist() == [0]


def test_ydlidar_with_intensity() -> None:
    frame = bytes.fromhex("AA 55 00 02 01 05 81 05 2F 57 64 A0 0F 65 A4 0F")
    samples = decoded(YdDecoder(KINDS["ydlidar_tmini"], Counter()), frame).samples
    assert samples.angle_deg.tolist() == [10.0, 11.0]
    assert samples.range_m.tolist() == [1.0, 1.001]
    assert samples.intensity.tolist() == [100.0, 101.0]
    assert samples.shift_deg.tolist() == [0.0, 0.0]


def test_the_x4_looks_from_beside_its_axis() -> None:
    assert triangulation_deg(np.array([1.0, 8.0, 0.1553])) == pytest.approx(
        [-6.762, -7.837, 0.0], abs=5e-4
    )


def test_rplidar_standard_sample() -> None:
    result = decoded(StandardDecoder(Counter()), bytes.fromhex("3D 81 16 A0 0F"))
    samples = result.samples
    assert samples.angle_deg.tolist() == [45.0]
    assert samples.range_m.tolist() == [1.0]
    assert samples.intensity.tolist() == [15]


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
    from bench.base.lidar_streams import xv11_frame

    frame = xv11_frame(3, 300.0, [(0x8035, 0), (0x4000 | 700, 9), (0x8000 | 900, 1), (5000, 2)])
    result = decoded(Xv11Decoder(Counter()), frame)
    assert result.samples.range_m == pytest.approx([0.0, 0.7, 0.0, 5.0])
