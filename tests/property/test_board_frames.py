"""rosserial frames: whatever the bytes and however they are cut, the slow twin finds the same."""

from hypothesis import given
from hypothesis import strategies as st
from support.fake_boards import frame, slow_frames

from trolley_base.drivers.boards.rosserial import (
    MOST_PAYLOAD,
    FrameDecoder,
    encode,
    parse_log,
    parse_topic_info,
)

FRAMES = st.builds(frame, st.integers(0, 0xFFFF), st.binary(max_size=60))
HEADERS = st.integers(0, 600).map(
    lambda size: (
        b"\xff\xfe" + size.to_bytes(2, "little") + bytes([255 - sum(divmod(size, 256)) % 256])
    )
)


@st.composite
def spoiled(draw: st.DrawFn) -> bytes:
    """A frame that was cut, repeated in part, or has a flipped bit."""
    data = bytearray(draw(FRAMES))
    at = draw(st.integers(0, len(data) - 1))
    match draw(st.sampled_from(["cut", "repeat", "flip", "drop"])):
        case "cut":
            del data[at:]
        case "repeat":
            data[at:at] = data[: at + 1]
        case "flip":
            data[at] ^= 1 << draw(st.integers(0, 7))
        case _:
            del data[at]
    return bytes(data)


NOISE = st.binary(max_size=20) | st.lists(st.sampled_from([0xFF, 0xFE, 0, 1, 2])).map(bytes)
STREAMS = st.lists(FRAMES | spoiled() | NOISE | HEADERS, max_size=12).map(b"".join)


def ignore(name: str, number: int) -> None:
    """Count nothing."""


@given(STREAMS, st.data())
def test_the_decoder_agrees_with_its_slow_twin(stream: bytes, data: st.DataObject) -> None:
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=20)))
    decoder = FrameDecoder(ignore)
    found: list[tuple[int, bytes]] = []
    for start, end in zip([0, *cuts], [*cuts, len(stream)], strict=True):
        for topic_id, payload, following in decoder.feed(stream[start:end]):
            found.append((topic_id, payload))
            assert following >= len(payload) + 8
        assert decoder.waiting < MOST_PAYLOAD + 8
    assert found == slow_frames(stream)


@given(STREAMS)
def test_byte_by_byte_is_the_same(stream: bytes) -> None:
    whole = [item[:2] for item in FrameDecoder(ignore).feed(stream)]
    decoder = FrameDecoder(ignore)
    single = [item[:2] for i in range(len(stream)) for item in decoder.feed(stream[i : i + 1])]
    assert single == whole


@given(st.integers(0, 0xFFFF), st.binary(max_size=MOST_PAYLOAD))
def test_encoded_frames_come_back(topic_id: int, payload: bytes) -> None:
    data = encode(topic_id, payload)
    assert slow_frames(data) == [(topic_id, payload)]
    assert FrameDecoder(ignore).feed(data) == [(topic_id, payload, len(data))]


@given(st.binary(max_size=200))
def test_nothing_raises_on_payloads(payload: bytes) -> None:
    parse_log(payload)
    parse_topic_info(payload)
