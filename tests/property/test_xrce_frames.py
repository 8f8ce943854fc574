"""micro-ROS' frames, however the stream is cut, against a reader of one octet after the other."""

import random
from collections import Counter
from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st
from support.emulated_boards import dialogue_of

from trolley.geometry import Twist2D
from trolley_base.drivers.boards.xrce_frames import FrameDecoder, encode
from trolley_base.emulators.micro_ros import framed

MS = 1_000_000


def slow_sum(octets: list[int]) -> int:
    """CRC-16/ARC, bit by bit."""
    remainder = 0
    for octet in octets:
        for place in range(8):
            bit = octet >> place & 1 ^ remainder & 1
            remainder = remainder >> 1 ^ (0xA001 if bit else 0)
    return remainder


def slow_frames(stream: bytes) -> list[tuple[int, bytes]]:
    """Source and message of each frame: what is between one 7E and the next, octet by octet."""
    found: list[tuple[int, bytes]] = []
    for between in stream.split(b"\x7e")[1:]:
        octets: list[int] = []
        is_escaped = False
        for octet in between:
            if octet == 0x7D and not is_escaped:
                is_escaped = True
                continue
            octets.append(octet ^ 0x20 if is_escaped else octet)
            is_escaped = False
            length = octets[2] + octets[3] * 256 if len(octets) >= 4 else 4097
            if length <= 4096 and len(octets) == length + 6:
                break
        else:
            continue
        if slow_sum(octets[4:-2]) == octets[-2] + octets[-1] * 256:
            found.append((octets[0], bytes(octets[4:-2])))
    return found


MESSAGES = st.binary(max_size=40) | st.binary(max_size=3).map(lambda some: some * 30)
FRAMES = MESSAGES.map(framed) | MESSAGES.map(lambda message: encode(message, 1))
PIECES = st.lists(
    FRAMES
    | st.binary(max_size=20)
    | FRAMES.map(lambda frame: frame[: len(frame) // 2])
    | FRAMES.map(lambda frame: frame[1:])
    | st.sampled_from((b"\x7e", b"\x7d", b"\x7e\x00\x00\xff\xff")),
    max_size=12,
).map(b"".join)


@given(PIECES, st.lists(st.integers(0, 400), max_size=8))
def test_frames_are_found_however_the_stream_is_cut(stream: bytes, cuts: list[int]) -> None:
    counts: Counter[str] = Counter()

    def count(name: str, number: int) -> None:
        counts[name] += number

    decoder = FrameDecoder(count)
    places = sorted({0, len(stream), *(min(cut, len(stream)) for cut in cuts)})
    found = [frame for start, end in pairwise(places) for frame in decoder.feed(stream[start:end])]
    assert [(frame.source, frame.message) for frame in found] == slow_frames(stream)
    kept = sum(len(encode(frame.message, frame.source)) for frame in found)
    assert kept + counts["skipped_bytes"] + decoder.waiting >= len(stream) - 8 * len(found)
    assert decoder.waiting <= 2 * 4102 + 1


SUBMESSAGES = st.lists(
    st.tuples(st.integers(0, 17), st.sampled_from((0, 1, 3, 7)), st.binary(max_size=60)), max_size=6
)
HEADERS = st.tuples(
    st.sampled_from((0x00, 0x01, 0x80, 0x81)),
    st.sampled_from((0, 1, 0x80, 0x81)),
    st.integers(0, 4) | st.integers(0, 0xFFFF),
)
OPEN = bytes.fromhex("80000000 00011000 58524345 0100 010F BACEA105 81 00 0002")


@given(st.lists(st.tuples(HEADERS, SUBMESSAGES), max_size=12), st.randoms(use_true_random=False))
def test_no_message_stops_the_driver_or_moves_the_robot(
    messages: list[tuple[tuple[int, int, int], list[tuple[int, int, bytes]]]], rng: random.Random
) -> None:
    """Whatever comes, it answers in whole frames, keeps little, and says how it goes."""
    dialogue = dialogue_of("linorobot2")
    dialogue.begin(0)
    dialogue.receive(framed(OPEN), MS)
    now_ns = MS
    for (session, stream, number), parts in messages:
        data = bytes((session, stream, number & 255, number >> 8))
        for kind, flags, payload in parts:
            data += bytes((kind, flags, len(payload), 0)) + payload + bytes(-len(payload) % 4)
        now_ns += rng.randrange(300) * MS
        dialogue.receive(framed(data), now_ns)
        dialogue.drive(Twist2D(0.3, 0.0, 0.1))
        out = dialogue.outgoing(now_ns)
        assert len(slow_frames(out)) == out.count(b"\x7e")
        assert len(out) < 4096
        assert dialogue.take(now_ns).link.state != "up", "nothing has been reported"
        # 0.3 m/s in a Twist: nothing is driven that has not reported.
        assert bytes.fromhex("333333333333D33F") not in out
