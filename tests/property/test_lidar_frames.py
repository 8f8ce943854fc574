"""Every lidar's frames: exactly those that a plain decoder accepts, whatever the chunks."""

from collections import Counter
from itertools import islice, pairwise

import pytest
from bench.base.lidars.catalogue import RECORDS
from bench.base.lidars.ydlidar import x4_frame
from hypothesis import given, settings
from hypothesis import strategies as st
from support.cases import cases

from trolley_base.drivers.lidars.frames import FrameFinder, FrameFormat

FORMATS = {title: one.form for title, one in RECORDS.items() if one.form is not None}
FRAMES = {title: [one.data for one in islice(RECORDS[title].stream(), 40)] for title in FORMATS}


@st.composite
def damaged_streams(draw: st.DrawFn, title: str) -> bytes:
    """Frames, whole, repeated, cut, with flipped bits, among noise and false headers."""
    parts: list[bytes] = []
    for _ in range(draw(st.integers(1, 12))):
        frame = draw(st.sampled_from(FRAMES[title]))
        match draw(st.sampled_from("wwwrcfnh")):
            case "w":
                parts.append(frame)
            case "r":
                parts.append(frame * 2)
            case "c":
                cut = sorted(draw(st.tuples(*[st.integers(0, len(frame))] * 2)))
                parts.append(frame[cut[0] : cut[1]])
            case "f":
                bit = draw(st.integers(0, 8 * len(frame) - 1))
                flipped = bytearray(frame)
                flipped[bit // 8] ^= 1 << bit % 8
                parts.append(bytes(flipped))
            case "n":
                parts.append(draw(st.binary(max_size=60)))
            case _:
                parts.append(RECORDS[title].header * draw(st.integers(1, 30)))
    return b"".join(parts)


def pieces_of(data: bytes, cuts: list[int]) -> list[bytes]:
    edges = [0, *sorted(cut % (len(data) + 1) for cut in cuts), len(data)]
    return [data[a:b] for a, b in pairwise(edges)]


def found_in(form: FrameFormat, pieces: list[bytes]) -> tuple[list[bytes], Counter[str], list[int]]:
    counts: Counter[str] = Counter()
    finder = FrameFinder(form, counts)
    found: list[bytes] = []
    ends: list[int] = []
    arrived = 0
    for piece in pieces:
        arrived += len(piece)
        frames = finder.feed(piece)
        for row, length, behind in zip(frames.data, frames.lengths, frames.behind, strict=True):
            found.append(row[:length].tobytes())
            ends.append(arrived - int(behind))
    return found, counts, ends


@pytest.mark.parametrize("title", FORMATS)
@settings(deadline=None, max_examples=cases(100))
@given(data=st.data())
def test_frames_are_those_of_the_plain_decoder(title: str, data: st.DataObject) -> None:
    stream = data.draw(damaged_streams(title))
    cuts = data.draw(st.lists(st.integers(0, 5000), max_size=12))
    found, counts, ends = found_in(FORMATS[title], pieces_of(stream, cuts))
    plain = RECORDS[title].finder()
    assert found == plain.feed(stream)
    assert [stream[end - len(one) : end] for one, end in zip(found, ends, strict=True)] == found
    assert counts["lidar/bad_checksum"] == plain.bad
    # What the plain decoder has skipped already, the fast one may still hold: a header's length.
    waiting = plain.skipped - counts["lidar/skipped_bytes"]
    assert 0 <= waiting < FORMATS[title].head_bytes


@pytest.mark.parametrize("title", FORMATS)
@settings(deadline=None, max_examples=10)
@given(data=st.data())
def test_single_bytes_give_what_one_piece_gives(title: str, data: st.DataObject) -> None:
    stream = data.draw(damaged_streams(title))[:600]
    by_bytes = found_in(FORMATS[title], [bytes([one]) for one in stream])
    assert by_bytes == found_in(FORMATS[title], [stream])


@pytest.mark.parametrize("title", FORMATS)
def test_a_flood_of_headers_is_not_kept(title: str) -> None:
    finder = FrameFinder(FORMATS[title], Counter())
    for _ in range(50):
        finder.feed(RECORDS[title].header * 100)
        assert finder.held_bytes < FORMATS[title].most_bytes


def test_a_frame_waits_for_a_longer_one_that_may_begin_before_it() -> None:
    false_header = RECORDS["YDLIDAR X4"].header
    frame = x4_frame(True, 0.0, 0.0, [4000])
    finder = FrameFinder(FORMATS["YDLIDAR X4"], Counter())
    assert len(finder.feed(false_header + frame)) == 0
    assert len(finder.feed(bytes(90))) == 1
