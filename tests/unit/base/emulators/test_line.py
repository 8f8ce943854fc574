"""Bytes leave at the line's pace; who listens at another speed hears what the bits make."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from trolley_base.drivers.boards.rosserial import STOP_REQUEST, TOPIC_REQUEST
from trolley_base.drivers.lidars import MODELS
from trolley_base.emulators.line import Line, misheard

MS = 1_000_000
CHUNKS = st.lists(st.tuples(st.integers(0, 40), st.binary(min_size=1, max_size=60)), max_size=30)


def push_all(line: Line, chunks: list[tuple[int, bytes]]) -> bytes:
    now_ns, sent = 0, b""
    for wait_ms, data in chunks:
        now_ns += wait_ms * MS
        line.push(now_ns, data)
        sent += data
    return sent


@given(CHUNKS, st.lists(st.integers(1, 50), max_size=60))
def test_no_byte_is_faster_than_the_line(chunks: list[tuple[int, bytes]], waits: list[int]):
    line = Line(9600, buffer_bytes=10_000)
    sent = push_all(line, chunks)
    now_ns, got = 0, b""
    for wait_ms in waits:
        now_ns += wait_ms * MS
        got += line.take(now_ns)
        assert len(got) <= now_ns * 960 / 1e9
    got += line.take(now_ns + 10**13)
    assert got == sent
    assert line.dropped == 0


def test_a_chunk_leaves_when_it_is_due_and_not_before():
    line = Line(100_000)  # 10 bytes per ms
    line.push(5 * MS, b"a" * 20)
    assert line.take(5 * MS) == b""
    assert line.take(6 * MS) == b"a" * 10
    line.push(6 * MS, b"b" * 10)  # behind what waits
    assert line.take(7 * MS) == b"a" * 10
    assert line.take(8 * MS) == b"b" * 10


def test_what_does_not_fit_is_lost():
    line = Line(100_000, buffer_bytes=100)
    for _ in range(5):
        line.push(0, b"x" * 30)
    assert line.dropped == 50
    assert len(line.take(10**12)) == 100


def test_a_full_line_drops_what_is_more_than_it_carries():
    line, carried = Line(57600), 0
    for ms in range(2000):
        line.push(ms * MS, b"x" * 20)  # 20 kB/s
        carried += len(line.take(ms * MS))
    assert 2 * 5600 < carried <= 2 * 5760
    assert line.dropped > 25_000


@given(st.binary(max_size=100))
def test_at_the_same_speed_nothing_is_misheard(data: bytes) -> None:
    assert misheard(data, 57600, 57600) == data


def test_bits_are_sampled_at_the_speed_of_whoever_listens() -> None:
    # "U" makes the line fall and rise with every bit: 0 1010101010, twice as long each.
    assert misheard(b"U", 57600, 115200) == b"\x66\xe6"
    # A break: the line has to rise before another byte can begin.
    assert misheard(b"\0U", 57600, 115200) == b"\0\x66\xe6"


@pytest.mark.parametrize("model", ["rplidar_a1", "ydlidar_x4"])
def test_what_boards_are_asked_is_no_command_to_a_lidar(model: str) -> None:
    for question in (TOPIC_REQUEST, STOP_REQUEST, b"\r", b"b\r", b"e\r"):
        heard = misheard(question, 57600, MODELS[model].facts.baud)
        assert heard
        assert 0xA5 not in heard
