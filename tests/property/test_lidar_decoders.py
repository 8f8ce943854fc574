"""Each decoder's samples: where and how far, as a plain decoder reads them from the same frames."""

from collections import Counter

import numpy as np
import pytest
from bench.base.lidars.catalogue import RECORDS
from hypothesis import given, settings
from hypothesis import strategies as st
from support.cases import cases

TITLES = [title for title, one in RECORDS.items() if one.judged and one.judged.frames]


@pytest.mark.parametrize("title", TITLES)
@settings(deadline=None, max_examples=cases(40))
@given(seed=st.integers(0, 2**32 - 1))
def test_samples_are_those_of_the_plain_decoder(title: str, seed: int) -> None:
    record = RECORDS[title]
    assert record.judged is not None
    assert record.judged.frames is not None
    data = b"".join(record.judged.frames(np.random.default_rng(seed)))
    decoded = record.judged.decoder(Counter()).decode(data)
    assert decoded is not None
    finder, read = record.finder(), record.reader()
    plain = [sample for frame in finder.feed(data) for sample in read(frame)]
    angles, found_mm = np.array(plain).T
    range_m = decoded.samples.range_m
    beam_deg = decoded.samples.angle_deg + decoded.samples.shift_deg
    if record.sends_whole_turns:  # the decoder adds the beams that the sensor does not see
        per_turn = round(record.samples_per_s / record.turns_hz)
        range_m = range_m.reshape(-1, len(range_m) * per_turn // len(found_mm))
        beam_deg = beam_deg.reshape(range_m.shape)[:, :per_turn].ravel()
        assert not range_m[:, per_turn:].any()
        range_m = range_m[:, :per_turn].ravel()
    np.testing.assert_allclose(range_m * 1000.0, found_mm, atol=1e-6)
    # Where nothing was found it does not matter where the beam looked.
    beside = ((beam_deg - angles + 180.0) % 360.0 - 180.0)[found_mm > 0]
    np.testing.assert_allclose(beside, 0.0, atol=1e-6)
