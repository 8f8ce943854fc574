"""The board's side of rosserial against published vectors, and its receiver's habits."""

import struct

from hypothesis import given
from hypothesis import strategies as st

from trolley_base.emulators.rosserial import Message, Receiver, encode, topic_info

MS = 1_000_000
TWIST = bytes.fromhex("fffe3000cf65009a9999999999c93f" + "00" * 38 + "e03fdc")
PID = bytes.fromhex("fffe0c00f364009a99193f0000003f9a99993ec7")


def test_frames_match_the_vectors():
    assert encode(0, b"") == bytes.fromhex("fffe0000ff0000ff")
    assert encode(10, bytes(8)) == bytes.fromhex("fffe0800f70a000000000000000000f5")
    assert encode(11, b"") == bytes.fromhex("fffe0000ff0b00f4")
    assert encode(125, struct.pack("<3f", 0.2, 0.0, 0.5)) == bytes.fromhex(
        "fffe0c00f37d00cdcc4c3e000000000000003f20"
    )
    assert encode(101, struct.pack("<6d", 0.2, 0, 0, 0, 0, 0.5)) == TWIST
    info = topic_info(125, "raw_vel", "lino_msgs/Velocities", "0ee8ad4cb7809be2d5a0a76352fea86a")
    assert len(info) == 77
    frame = encode(0, info)
    assert frame.startswith(bytes.fromhex("fffe4d00b200007d00070000007261775f76656c14000000"))
    assert frame.endswith(bytes.fromhex("00020000f6"))


@given(
    st.lists(st.tuples(st.integers(0, 65535), st.binary(max_size=512)), max_size=5),
    st.lists(st.integers(1, 200), max_size=30),
)
def test_whole_frames_are_received_whatever_the_chunks(
    sent: list[tuple[int, bytes]], cuts: list[int]
):
    data = b"".join(encode(*frame) for frame in sent)
    receiver, got = Receiver(), []
    for cut in [*cuts, len(data)]:
        got += list(receiver.take(data[:cut], 0))
        data = data[cut:]
    assert got == [Message(*frame) for frame in sent]


def test_a_frame_that_is_not_whole_after_20_ms_is_lost():
    receiver = Receiver()
    assert list(receiver.take(TWIST[:30], 0)) == []
    assert list(receiver.take(TWIST[30:], 21 * MS)) == []
    assert receiver.late == 1
    receiver.clear()
    assert list(receiver.take(TWIST[:30], 100 * MS)) == []
    assert len(list(receiver.take(TWIST[30:], 119 * MS))) == 1


def test_wrong_checksums_and_too_long_frames_are_refused():
    receiver = Receiver()
    assert list(receiver.take(TWIST[:4] + b"\x00" + TWIST[5:], 0)) == []
    assert list(receiver.take(TWIST[:-1] + b"\x00", 30 * MS)) == []
    assert receiver.refused == 2
    assert list(receiver.take(encode(101, bytes(513)), 60 * MS)) == []
    assert receiver.too_long == 1
    assert len(list(receiver.take(PID, 90 * MS))) == 1
