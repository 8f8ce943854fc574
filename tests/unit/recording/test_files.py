"""What is written can be read, bit for bit, as far as the file is whole."""

import contextlib
import errno
import json
import os
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from support.cases import cases
from support.samples import make_clock, make_estimate, make_scan
from support.strategies import instances_of

from trolley import topics
from trolley.recording.layout import recorded_topic
from trolley.recording.reader import BadRecording, RecordingFile
from trolley.recording.recorder import Recorder
from trolley.recording.writer import RecordingWriter
from trolley.runtime import codec
from trolley.runtime.bus import Sample

from .conftest import SECOND_NS, START_NS, Timed, WriteRecording, drive, sample_of

RECORDED = [topic for topic in topics.TOPICS if recorded_topic(topic.key("one", "a", "b"))]
CHUNK_HEAD = 9 + 8 + 8 + 8 + 4 + 4 + len("zstd") + 8
"""Bytes of a chunk before what is packed in it."""
SHARED = settings(
    max_examples=cases(40),
    suppress_health_check=[HealthCheck.function_scoped_fixture],
    deadline=None,
)


def wire(samples: list[Timed]) -> list[tuple[str, bytes, str]]:
    """What of the samples must come back."""
    return [
        (one.key.removeprefix("trolley/one/"), one.payload, "" if one.is_delete else one.encoding)
        for _, one in samples
    ]


def read(path: Path) -> list[tuple[str, bytes, str]]:
    return [(entry.name, entry.payload, entry.encoding) for entry in RecordingFile(path).entries()]


@st.composite
def messages(draw: st.DrawFn) -> Sample:
    topic = draw(st.sampled_from(RECORDED))
    message = draw(instances_of(topic.message))
    fmt: codec.Format = draw(st.sampled_from(["msgpack", "json"]))
    parts = draw(st.sampled_from([("one", "two"), ("a", "b"), ("kitchen sink", "ä")]))
    return sample_of(topic, message, *parts[: topic.num_parts], fmt=fmt)


@SHARED
@given(samples=st.lists(messages(), min_size=1, max_size=12))
def test_every_message_comes_back_bit_for_bit(
    samples: list[Sample], tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("recording") / "drive.mcap"
    with RecordingWriter(path, "one", {}) as writer:
        recorder = Recorder(writer, "one")
        for index, sample in enumerate(samples):
            recorder.take(sample, index * SECOND_NS, START_NS)
        writer.finish()
    assert recorder.counts == {}
    assert read(path) == wire([(0.0, sample) for sample in samples])
    # Foxglove's own reader is as strict: it finds every message by the index.
    with path.open("rb") as file:
        found = list(make_reader(file, validate_crcs=True).iter_messages())
    assert len(found) >= len(samples)


def test_a_file_says_whose_it_is_and_how_long(write_recording: WriteRecording) -> None:
    recording = RecordingFile(write_recording(drive(3.0)))
    assert recording.robot == "one"
    span = recording.span_ns
    assert span is not None
    assert span[1] - span[0] == pytest.approx(2.9 * SECOND_NS)
    assert list(recording.entries())
    assert recording.damage.sentences() == []


def test_it_is_readable_up_to_any_cut(write_recording: WriteRecording, tmp_path: Path) -> None:
    whole = write_recording(drive(3.0))
    content = whole.read_bytes()
    expected = read(whole)
    ends = [end for _, end in chunk_spans(whole)]
    assert len(ends) == 3
    cut = tmp_path / "cut.mcap"
    lengths = set(range(0, len(content), 89))
    for end in ends:  # every byte around the borders
        lengths |= set(range(end - 40, min(end + 40, len(content))))
    for length in sorted(lengths):
        cut.write_bytes(content[:length])
        good = sum(1 for end in ends if end <= length)
        if good == 0:
            with pytest.raises(BadRecording, match="before its first message"):
                RecordingFile(cut)
            continue
        recording = RecordingFile(cut)
        found = [(one.name, one.payload, one.encoding) for one in recording.entries()]
        # A chunk of 21 messages first, then 20 each.
        assert found == expected[: 1 + 20 * good]
        assert recording.robot == "one"


def test_a_cut_is_told_in_bytes(write_recording: WriteRecording, tmp_path: Path) -> None:
    whole = write_recording(drive(3.0))
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole.read_bytes()[: chunk_spans(whole)[1][1] - 5])
    recording = RecordingFile(cut)
    assert len(list(recording.entries())) == 21
    assert recording.span_ns is None
    (sentence,) = recording.damage.sentences()
    assert f"last {recording.damage.unread_bytes} bytes" in sentence


def test_zeros_at_the_end_are_no_messages(write_recording: WriteRecording, tmp_path: Path) -> None:
    """As some file systems leave them after a power cut."""
    whole = write_recording(drive(2.0), finish=False)
    expected = read(whole)
    padded = tmp_path / "padded.mcap"
    padded.write_bytes(whole.read_bytes() + bytes(5000))
    recording = RecordingFile(padded)
    assert [(one.name, one.payload, one.encoding) for one in recording.entries()] == expected
    assert recording.damage.unread_bytes > 0


def test_damage_in_the_middle_costs_one_chunk(
    write_recording: WriteRecording, tmp_path: Path
) -> None:
    whole = write_recording(drive(3.0))
    content = bytearray(whole.read_bytes())
    _, (begin, end), _ = chunk_spans(whole)
    damaged = tmp_path / "damaged.mcap"
    for at in range(begin + CHUNK_HEAD, end, 41):
        broken = bytearray(content)
        broken[at] ^= 0xFF
        damaged.write_bytes(broken)
        recording = RecordingFile(damaged)
        found = list(recording.entries())
        assert len(found) == 41, at
        assert recording.damage.sentences() == ["The file is damaged: about 1 second is missing."]


@settings(
    max_examples=cases(200),
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(data=st.data())
def test_no_damage_ends_in_anything_but_words(
    data: st.DataObject, tmp_path_factory: pytest.TempPathFactory, damaged_content: bytes
) -> None:
    path = tmp_path_factory.mktemp("damaged") / "x.mcap"
    content = bytearray(damaged_content)
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(content) - 1))
        content[at : at + 8] = data.draw(st.binary(min_size=1, max_size=8))
    path.write_bytes(content)
    with contextlib.suppress(BadRecording):
        for entry in RecordingFile(path).entries():
            assert entry.topic in RECORDED


@pytest.fixture(scope="module")
def damaged_content(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("whole") / "one.mcap"
    with RecordingWriter(path, "one", {}) as writer:
        for step in range(20):
            clock = make_clock(START_NS + step)
            sample = sample_of(topics.CLOCK, clock)
            writer.add(step, sample.key, topics.CLOCK, sample.payload, sample.encoding, step)
            if step % 5 == 0:
                writer.flush()
        writer.finish()
    return path.read_bytes()


def test_what_claims_to_be_huge_is_not_unpacked(tmp_path: Path) -> None:
    """A few bytes that unpack to gigabytes."""
    path = tmp_path / "bomb.mcap"
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=1 << 30, compression=CompressionType.ZSTD)
        writer.start()
        clock = sample_of(topics.CLOCK, make_clock(1))
        schema = writer.register_schema("trolley.Clock", "jsonschema", b"{}")
        channel = writer.register_channel(clock.key, "msgpack", schema, {"encoding": ""})
        writer.add_message(channel, 1, clock.payload, 1)
        writer.flush()
        for _ in range(3):
            writer.add_message(channel, 2, bytes(50 << 20), 2)
        writer.finish()
    assert path.stat().st_size < 1 << 20
    recording = RecordingFile(path)
    assert [entry.payload for entry in recording.entries()] == [clock.payload]
    assert recording.damage.bad_chunks == 1


@pytest.mark.parametrize("compression", list(CompressionType))
def test_a_file_that_another_tool_packed_anew_is_read(
    tmp_path: Path, compression: CompressionType
) -> None:
    path = tmp_path / "packed.mcap"
    sample = sample_of(topics.SCAN, make_scan(5))
    with path.open("wb") as file:
        writer = Writer(file, compression=compression)
        writer.start()
        schema = writer.register_schema("trolley.Scan", "jsonschema", b"{}")
        channel = writer.register_channel(
            sample.key, "msgpack", schema, {"encoding": "application/msgpack"}
        )
        writer.add_message(channel, 1, sample.payload, 1)
        writer.finish()
    assert read(path) == [("scan", sample.payload, "application/msgpack")]


def test_of_a_file_of_two_robots_one_is_read(tmp_path: Path) -> None:
    """As `mcap merge` makes them."""
    path = tmp_path / "both.mcap"
    with RecordingWriter(path, "one", {}) as writer:
        for robot in ("one", "two", "one"):
            payload = sample_of(topics.POSE, make_estimate(5)).payload
            writer.add(5, topics.POSE.key(robot), topics.POSE, payload, "application/msgpack", 5)
        writer.finish()
    recording = RecordingFile(path)
    assert recording.robot == "one"
    assert len(list(recording.entries())) == 2
    assert recording.damage.sentences() == ["The file is of several robots; left out: two."]


def test_files_of_others_are_refused_in_words(tmp_path: Path) -> None:
    path = tmp_path / "other.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/camera", "json", 0)
        writer.add_message(channel, 1, b"{}", 1)
        writer.finish()
    with pytest.raises(BadRecording, match=r"another program.*/camera.*Trolley"):
        RecordingFile(path)
    path.write_bytes(b"PK\x03\x04 something else")
    with pytest.raises(BadRecording, match="not an MCAP file"):
        RecordingFile(path)
    path.write_bytes(b"")
    with pytest.raises(BadRecording, match="ends before its first message"):
        RecordingFile(path)
    with pytest.raises(BadRecording, match="cannot be read"):
        RecordingFile(tmp_path / "none.mcap")


def test_an_existing_file_is_never_overwritten(write_recording: WriteRecording) -> None:
    path = write_recording(drive(1.0))
    before = path.read_bytes()
    with pytest.raises(FileExistsError):
        RecordingWriter(path, "one", {})
    assert path.read_bytes() == before


def test_on_a_full_disk_what_was_written_stays_readable(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "full.mcap"
    room = 20_000
    write = os.write

    def write_some(handle: int, data: Any) -> int:
        nonlocal room
        if room <= 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        written = write(handle, bytes(data)[:room])
        room -= written
        return written

    flushed = 0

    def fill(writer: RecordingWriter) -> None:
        nonlocal flushed
        recorder = Recorder(writer, "one")
        for at_s, sample in drive(60.0):
            recorder.take(sample, round(at_s * SECOND_NS), START_NS)
            if sample.key.endswith("pose"):
                writer.flush()
                flushed = writer.num_messages

    with RecordingWriter(path, "one", {}) as writer:
        monkeypatch.setattr("trolley.recording.writer.os.write", write_some)
        with pytest.raises(OSError, match="No space left"):
            fill(writer)
        writer.abandon()
    assert flushed > 3
    recording = RecordingFile(path)
    assert len(list(recording.entries())) == flushed
    assert recording.damage.unread_bytes == 0


def test_what_would_take_the_room_that_the_robot_needs_is_not_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A chunk that was already written stayed, however far it reached into that room."""
    path = tmp_path / "full.mcap"
    disk = os.statvfs(tmp_path)
    low = os.statvfs_result((*disk[:4], 1, *disk[5:]))
    with RecordingWriter(path, "one", {}) as writer:
        recorder = Recorder(writer, "one")
        before = writer.size
        for at_s, sample in drive(1.0):
            recorder.take(sample, round(at_s * SECOND_NS), START_NS)
        monkeypatch.setattr("trolley.recording.writer.os.fstatvfs", lambda _: low)
        with pytest.raises(OSError, match="No space left"):
            writer.flush()
        assert path.stat().st_size > before
        writer.abandon()
    assert path.stat().st_size == before


def test_foxglove_finds_its_schemas(write_recording: WriteRecording) -> None:
    path = write_recording([*drive(1.0), (1.0, sample_of(topics.SCAN, make_scan(START_NS)))])
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    schemas = {one.topic: summary.schemas[one.schema_id] for one in summary.channels.values()}
    assert schemas["/one/scan"].name == "foxglove.LaserScan"
    assert schemas["/one/scan"].encoding == "protobuf"
    assert schemas["/one/pose"].name == "foxglove.PoseInFrame"
    assert json.loads(schemas["/one/clock"].data)["type"] == "object"
    assert schemas["trolley/one/scan"].name == "trolley.Scan"
    assert msgspec.json.decode(schemas["trolley/one/scan"].data)


def chunk_spans(path: Path) -> list[tuple[int, int]]:
    """Where the chunks of a file begin and end."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    return [
        (one.chunk_start_offset, one.chunk_start_offset + one.chunk_length)
        for one in summary.chunk_indexes
    ]
