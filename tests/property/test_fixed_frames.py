"""Frames of fixed length, however the stream is cut, against a search from byte to byte."""

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st
from support.emulated_boards import dialogue_of

from trolley.geometry import Twist2D
from trolley_base.drivers.boards import hoverboard
from trolley_base.drivers.boards.create2 import FRAME, HEAD, WHOLE
from trolley_base.drivers.boards.fixed_frames import FrameFormat, FrameReader

MS = 1_000_000


def create_frame(values: bytes) -> bytes:
    """A frame with these bytes where packets have theirs, its sum put right."""
    numbers = (7, 8, 9, 10, 11, 12, 14, 18, 21, 22, 25, 26, 34, 35, 43, 44, 45)
    wide = {22, 25, 26, 43, 44}
    body, at = b"", 0
    for number in numbers:
        size = 2 if number in wide else 1
        body += bytes((number,)) + values[at : at + size]
        at += size
    whole = b"\x13" + bytes((len(body),)) + body
    return whole + bytes((-sum(whole) % 256,))


def hoverboard_frame(words: tuple[int, ...]) -> bytes:
    """A frame of feedback with these words, its check put right."""
    check = 0xABCD
    for word in words:
        check ^= word
    return b"".join(word.to_bytes(2, "little") for word in (0xABCD, *words, check))


FRAMES = {
    "hoverboard": st.tuples(*[st.integers(0, 0xFFFF)] * 7).map(hoverboard_frame),
    "create2": st.binary(min_size=22, max_size=22).map(create_frame),
}
FORMATS: dict[str, FrameFormat] = {"create2": FRAME, "hoverboard": hoverboard.FRAME}
PIECES = {
    name: st.lists(
        frames
        | st.binary(max_size=20)
        | frames.map(lambda frame: frame[: len(frame) // 2])
        | st.just(FORMATS[name].head),
        max_size=12,
    )
    for name, frames in FRAMES.items()
}


def slow_create_frames(stream: bytes) -> list[bytes]:
    """All frames of a Create's stream, looked for from byte to byte."""
    found: list[bytes] = []
    at = 0
    while at + 42 <= len(stream):
        part = stream[at : at + 42]
        numbers, place = [], 2
        while place < 41:
            numbers.append(part[place])
            place += 3 if part[place] in (22, 25, 26, 43, 44) else 2
        good = part[0] == 19 and part[1] == 39 and sum(part) % 256 == 0
        if good and numbers == [7, 8, 9, 10, 11, 12, 14, 18, 21, 22, 25, 26, 34, 35, 43, 44, 45]:
            found.append(part)
            at += 42
        else:
            at += 1
    return found


def slow_hoverboard_frames(stream: bytes) -> list[bytes]:
    """All frames of a hoverboard's feedback, looked for from byte to byte."""
    found: list[bytes] = []
    at = 0
    while at + 18 <= len(stream):
        part = stream[at : at + 18]
        low = high = 0
        for place in range(0, 18, 2):
            low, high = low ^ part[place], high ^ part[place + 1]
        if part[0] == 0xCD and part[1] == 0xAB and low == high == 0:
            found.append(part)
            at += 18
        else:
            at += 1
    return found


SLOW = {"create2": slow_create_frames, "hoverboard": slow_hoverboard_frames}


def test_a_frame_is_as_long_as_it_says() -> None:
    assert (len(HEAD), WHOLE) == (2, 42)


@given(st.data(), st.sampled_from(sorted(FRAMES)))
def test_frames_are_those_of_a_slow_search(data: st.DataObject, name: str) -> None:
    stream = b"".join(data.draw(PIECES[name]))
    cuts = data.draw(st.lists(st.integers(0, len(stream)), max_size=6))
    counts: dict[str, int] = {}

    def count(kind: str, number: int) -> None:
        counts[kind] = counts.get(kind, 0) + number

    reader = FrameReader(FORMATS[name], count)
    found: list[bytes] = []
    edges = [0, *sorted(cuts), len(stream)]
    for start, end in pairwise(edges):
        frames, _ = reader.feed(stream[start:end])
        found += [frame.data for frame in frames]
    assert found == SLOW[name](stream)
    length = FORMATS[name].length
    skipped = counts.get("skipped_bytes", 0)
    assert 0 <= len(stream) - length * len(found) - skipped < length


@given(st.data(), st.sampled_from(sorted(FRAMES)))
def test_whatever_arrives_is_no_reason_to_drive_a_board_that_is_not_up(
    data: st.DataObject, name: str
) -> None:
    dialogue = dialogue_of(name)
    dialogue.begin(0)
    now_ns = 0
    for piece in data.draw(PIECES[name]):
        now_ns += data.draw(st.integers(0, 400)) * MS
        dialogue.receive(piece, now_ns)
        dialogue.drive(Twist2D(0.2, 0.0, 0.0))
        out = dialogue.outgoing(now_ns)
        if dialogue.status(now_ns).state != "up":
            assert not is_drive(name, out)
        dialogue.take(now_ns)


def is_drive(name: str, out: bytes) -> bool:
    """Whether something moves by it."""
    if name == "hoverboard":
        return out not in (b"", bytes.fromhex("CD AB 00 00 00 00 CD AB"))
    return out[:1] == b"\x91" and out[1:5] != bytes(4)
