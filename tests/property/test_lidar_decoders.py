"""Each decoder's samples: where and how far, as a plain decoder reads them from the same frames."""

from collections import Counter
from collections.abc import Callable

import numpy as np
import pytest
from bench.base.lidar_streams import ld19_frame
from bench.base.plain_lidars import PLAIN, SAMPLES
from hypothesis import given, settings
from hypothesis import strategies as st

from trolley_base.drivers.lidars import ld19
from trolley_base.drivers.lidars.decoding import Decoder

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


CASES: dict[str, tuple[Make, Callable[[Counter[str]], Decoder]]] = {
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
