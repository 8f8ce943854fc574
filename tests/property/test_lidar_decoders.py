"""Each decoder's samples: where and how far, as a plain decoder reads them from the same frames."""

from collections import Counter
from collections.abc import Callable

import numpy as np
import pytest
from bench.base.lidar_streams import capsule, ld19_frame
from bench.base.plain_lidars import PLAIN, SAMPLES
from hypothesis import given, settings
from hypothesis import strategies as st

from trolley_base.drivers.lidars import (
    coin_d4,
    delta2,
    hokuyo,
    ld19,
    rplidar_capsules,
    ydlidar,
)
from trolley_base.drivers.lidars.decoding import Decoder
from trolley_base.emulators import coin_d4 as coin_emulator
from trolley_base.emulators import delta2 as delta2_emulator
from trolley_base.emulators import hokuyo as hokuyo_emulator
from trolley_base.emulators import rplidar
from trolley_base.emulators import ydlidar as ydlidar_emulator

Make = Callable[[np.random.Generator], list[bytes]]
"""Frames that follow each other, with random distances."""


def distances(rng: np.random.Generator, most: int, count: int) -> list[int]:
    """Whole numbers of which every fifth or so is 0: nothing came back."""
    found = rng.integers(1, most, count)
    return np.where(rng.random(count) < 0.2, 0, found).tolist()


def ld_frames(rng: np.random.Generator) -> list[bytes]:
    first_deg, step = rng.uniform(0.0, 360.0), rng.uniform(0.1, 1.0)
    return [
        ld19_frame((first_deg + 12 * i * step) % 360.0, step, 3600.0, distances(rng, 65535, 12))
        for i in range(3)
    ]


def capsules(make: Callable[[bool, int, list[int]], bytes], most: int, count: int) -> Make:
    def frames(rng: np.random.Generator) -> list[bytes]:
        head_64, width_64 = int(rng.integers(23040)), int(rng.integers(64, 1280))
        # Of the ultra scan a neighbour's distance tells the next one's.
        near = rng.integers(1, most, 5 * (count + 1) // 4 + 4)
        around = np.repeat(near, 4)[: 4 * (count + 1)] + rng.integers(-300, 300, 4 * (count + 1))
        ranges = np.clip(around, 0, most - 1).tolist()
        return [
            make(False, (head_64 + i * width_64) % 23040, ranges[i * count : (i + 1) * count + 1])
            for i in range(3)
        ]

    return frames


def express_frames(rng: np.random.Generator) -> list[bytes]:
    first_deg = rng.uniform(0.0, 300.0)
    return [
        capsule(
            False,
            first_deg + 15 * i,
            list(zip(distances(rng, 16384, 32), rng.integers(0, 64, 32).tolist(), strict=True)),
        )
        for i in range(3)
    ]


def of_kind(kind: rplidar_capsules.Capsule) -> Callable[[Counter[str]], Decoder]:
    return lambda counts: rplidar_capsules.CapsuleDecoder(counts, 62.5e-6, kind)


def yd_frames(make: Callable[[int, tuple[int, int], list[int]], bytes], most: int) -> Make:
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
    return ydlidar_emulator.encode(7.0 if begins else None, heads, quarters)


def intense_yd(begins: int, heads: tuple[int, int], quarters: list[int]) -> bytes:
    rows = [(one % 251, one) for one in quarters]
    return ydlidar_emulator.encode_with_intensity(7.0 if begins else None, heads, rows)


def of_ydlidar(model: str) -> Callable[[Counter[str]], Decoder]:
    return lambda counts: ydlidar.YdDecoder(ydlidar.KINDS[model], counts)


def delta2_frames(packets: int) -> Make:
    def frames(rng: np.random.Generator) -> list[bytes]:
        data, index = [], int(rng.integers(packets))
        for i in range(4):
            count = int(rng.integers(1, 62))
            # The second packet tells how many make a turn; the first holds nothing here.
            quarters = [0] * count if i == 0 else distances(rng, 65536, count)
            angle = (index + i) % packets * 360.0 / packets
            data.append(delta2_emulator.encode(6.0, angle, [(one % 251, one) for one in quarters]))
        return data

    return frames


def plain_coin(begins: int, heads: tuple[int, int], distances_mm: list[int]) -> bytes:
    points = b"".join(coin_emulator.point(one % 16384, one % 251) for one in distances_mm)
    return coin_emulator.encode(100 if begins else None, heads, points)


CASES: dict[str, tuple[Make, Callable[[Counter[str]], Decoder]]] = {
    "RPLIDAR A1 express": (express_frames, of_kind(rplidar_capsules.EXPRESS)),
    "RPLIDAR A3": (
        capsules(rplidar.encode_ultra, 25000, 96),
        of_kind(rplidar_capsules.ULTRA),
    ),
    "RPLIDAR C1": (
        capsules(lambda first, head, mm: rplidar.encode_dense(first, head, mm[:40]), 65535, 40),
        of_kind(rplidar_capsules.DENSE),
    ),
    "RPLIDAR S3": (
        capsules(
            lambda first, head, mm: rplidar.encode_ultra_dense(first, head, mm[:64], 7), 60000, 64
        ),
        of_kind(rplidar_capsules.ULTRA_DENSE),
    ),
    "YDLIDAR X4": (yd_frames(plain_yd, 40), of_ydlidar("ydlidar_x4")),
    "YDLIDAR G4": (yd_frames(plain_yd, 80), of_ydlidar("ydlidar_g4")),
    "YDLIDAR G2": (yd_frames(intense_yd, 40), of_ydlidar("ydlidar_g2")),
    "YDLIDAR T-mini": (yd_frames(intense_yd, 40), of_ydlidar("ydlidar_tmini")),
    "COIN-D4": (yd_frames(plain_coin, 40), coin_d4.CoinDecoder),
    "Delta-2A": (
        delta2_frames(16),
        lambda counts: delta2.Delta2Decoder(delta2.FACTS_2A, counts),
    ),
    "Delta-2G": (
        delta2_frames(15),
        lambda counts: delta2.Delta2Decoder(delta2.FACTS_2A, counts),
    ),
    "LD19": (ld_frames, lambda counts: ld19.LdDecoder(ld19.FACTS, counts)),
    "LD14P": (
        ld_frames,
        lambda counts: ld19.LdDecoder(ld19.FACTS_14P, counts, ld19.triangulation_deg),
    ),
}


@pytest.mark.parametrize("title", CASES)
@settings(deadline=None, max_examples=40)
@given(seed=st.integers(0, 2**32 - 1))
def test_samples_are_those_of_the_plain_decoder(title: str, seed: int) -> None:
    make, decoder = CASES[title]
    data = b"".join(make(np.random.default_rng(seed)))
    decoded = decoder(Counter()).decode(data)
    assert decoded is not None
    read = SAMPLES[title]()
    plain = [sample for frame in PLAIN[title]().feed(data) for sample in read(frame)]
    angles, found_mm = np.array(plain).T
    np.testing.assert_allclose(decoded.samples.range_m * 1000.0, found_mm, atol=1e-6)
    beam_deg = decoded.samples.angle_deg + decoded.samples.shift_deg
    # Where nothing was found it does not matter where the beam looked.
    beside = ((beam_deg - angles + 180.0) % 360.0 - 180.0)[found_mm > 0]
    np.testing.assert_allclose(beside, 0.0, atol=1e-6)


URG = hokuyo.Parameters(20, 5600, 1024, 44, 725, 384, 600)


@settings(deadline=None, max_examples=20)
@given(seed=st.integers(0, 2**32 - 1))
def test_scans_of_a_hokuyo_are_those_of_the_plain_decoder(seed: int) -> None:
    rng = np.random.default_rng(seed)
    data = b"".join(
        hokuyo_emulator.encode("MD0044072501000", "99", 100 * i, distances(rng, 6000, 682))
        for i in range(3)
    )
    decoded = hokuyo.ScipDecoder(URG, Counter()).decode(data)
    assert decoded is not None
    plain = PLAIN["Hokuyo URG"]()
    angles, found_mm = np.array(
        [one for f in plain.feed(data) for one in SAMPLES["Hokuyo URG"]()(f)]
    ).T
    range_m = decoded.samples.range_m.reshape(3, 1024)
    np.testing.assert_allclose(range_m[:, :682].ravel() * 1000.0, found_mm, atol=1e-6)
    assert not range_m[:, 682:].any()
    beam_deg = (decoded.samples.angle_deg + decoded.samples.shift_deg).reshape(3, 1024)
    beside = (beam_deg[:, :682].ravel() - angles + 180.0) % 360.0 - 180.0
    np.testing.assert_allclose(beside, 0.0, atol=1e-6)
