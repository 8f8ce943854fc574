"""Each decoder's samples: where and how far, as a plain decoder reads them from the same frames."""

from collections import Counter
from collections.abc import Callable

import numpy as np
import pytest
from bench.base.lidar_streams import capsule, ld19_frame
from bench.base.plain_lidars import PLAIN, SAMPLES
from hypothesis import given, settings
from hypothesis import strategies as st

from trolley_base.drivers.lidars import ld19, rplidar_capsules
from trolley_base.drivers.lidars.decoding import Decoder
from trolley_base.emulators import rplidar

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
