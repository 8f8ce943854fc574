"""The standard scan of an RPLIDAR, which has no checksum: in and out of step by the stated rule."""

from collections import Counter
from itertools import islice, pairwise

from bench.base.lidars.rplidar import PlainSamples, standard_sample, standard_stream
from hypothesis import given, settings
from hypothesis import strategies as st
from support.cases import cases

from trolley_base.drivers.lidars.rplidar_samples import SampleFinder

HONEST = b"".join(frame.data for frame in islice(standard_stream(), 800))


@st.composite
def damaged_streams(draw: st.DrawFn) -> bytes:
    """Runs of samples, shifted, with flipped bits, among noise and samples that stand still."""
    parts: list[bytes] = []
    for _ in range(draw(st.integers(1, 6))):
        start = draw(st.integers(0, 3000))
        run = bytearray(HONEST[start : start + draw(st.integers(0, 600))])
        match draw(st.sampled_from("wwfnsc")):
            case "f" if run:
                bit = draw(st.integers(0, 8 * len(run) - 1))
                run[bit // 8] ^= 1 << bit % 8
            case "n":
                run += draw(st.binary(max_size=60))
            case "s":
                run += standard_sample(draw(st.booleans()), 45.0, 1000.5) * 30
            case "c":
                run += b"".join(standard_sample(False, 0.7 * i, 1000.5) for i in range(60))[3:]
            case _:
                pass
        parts.append(bytes(run))
    return b"".join(parts)


def found_in(pieces: list[bytes], in_step: bool) -> tuple[bytes, Counter[str]]:
    counts: Counter[str] = Counter()
    finder = SampleFinder(counts, in_step=in_step)
    runs = [run for piece in pieces for run in finder.feed(piece)]
    return b"".join(run.data.tobytes() for run in runs), counts


@settings(deadline=None, max_examples=cases(200))
@given(
    stream=damaged_streams(),
    cuts=st.lists(st.integers(0, 3600), max_size=10),
    in_step=st.booleans(),
)
def test_samples_are_those_of_the_plain_decoder(
    stream: bytes, cuts: list[int], in_step: bool
) -> None:
    edges = [0, *sorted(cut % (len(stream) + 1) for cut in cuts), len(stream)]
    pieces = [stream[a:b] for a, b in pairwise(edges)]
    found, counts = found_in(pieces, in_step)
    plain = PlainSamples(in_step=in_step)
    assert found == b"".join(plain.feed(stream))
    assert counts["lidar/bad_checksum"] == plain.bad
    assert counts["lidar/skipped_bytes"] == plain.skipped


@given(start=st.integers(1, 2000))
@settings(deadline=None, max_examples=cases(60))
def test_an_honest_stream_is_entered_at_the_next_sample(start: int) -> None:
    found, _ = found_in([HONEST[start:]], in_step=False)
    assert found == HONEST[start + -start % 5 :]


def test_a_stream_that_turns_no_more_is_left() -> None:
    still = standard_sample(False, 45.0, 1000.0) * 5000
    found, counts = found_in([still], in_step=True)
    assert len(found) == 4000 * 5
    assert counts["lidar/bad_checksum"] == 1
