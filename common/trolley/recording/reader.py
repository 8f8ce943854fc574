"""Reads a recording from beginning to end, or as far as it is intact."""

import dataclasses
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, NamedTuple, cast

import lz4.frame
import zstandard
from mcap.exceptions import EndOfFile, McapError
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, DataEnd, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.summary import Summary
from mcap.writer import MCAP0_MAGIC

from trolley.files import open_file
from trolley.recording.layout import (
    MAX_RECORD_BYTES,
    WIRE,
    recorded_topic,
    split_key,
)
from trolley.runtime.bus import matches
from trolley.topics import Topic

NAMED = 6
"""How many channels of a foreign file are named."""
_BROKEN = (
    McapError,
    OSError,
    struct.error,
    ValueError,
    OverflowError,
    RuntimeError,
    zstandard.ZstdError,
)
"""What reading damaged bytes may raise."""


class BadRecording(Exception):
    """A file cannot be used as a recording; the text says why and what to do."""


class ForeignRecording(BadRecording):
    """Another program wrote the MCAP file, such as `ros2 bag`."""


@dataclasses.dataclass(frozen=True, slots=True)
class Entry:
    """A message as it was on the wire."""

    at_ns: int
    """Robot time of its arrival."""
    name: str
    """Key below the robot's."""
    topic: Topic[Any]
    payload: bytes
    encoding: str

    @property
    def is_delete(self) -> bool:
        """Whether the key was deleted."""
        return not self.payload


@dataclasses.dataclass
class Damage:
    """What was not read of a file."""

    unread_bytes: int = 0
    """At the end."""
    bad_chunks: int = 0
    """In the middle; each holds about a second."""
    lost_messages: int = 0
    """In intact chunks, of channels that were described in damaged ones."""
    other_robots: set[str] = dataclasses.field(default_factory=set[str])
    """Whose messages are in the file, too, as in one that was merged."""

    def sentences(self) -> list[str]:
        """Sentences about it; none about a file that is intact."""
        found: list[str] = []
        if self.bad_chunks:
            seconds = "second is" if self.bad_chunks == 1 else "seconds are"
            found.append(f"The file is damaged: about {self.bad_chunks} {seconds} missing.")
        if self.lost_messages:
            found.append(
                f"The file is damaged: {self.lost_messages} messages can no longer be identified."
            )
        if self.unread_bytes:
            found.append(
                f"The file was cut or is damaged: its last {self.unread_bytes} bytes "
                "cannot be read."
            )
        if self.other_robots:
            others = ", ".join(sorted(self.other_robots))
            found.append(f"The file is of several robots; left out: {others}.")
        return found


class RecordingFile:
    """A file that `trolley record` wrote.

    Raises:
        BadRecording: It is not a recording, cannot be read, or ends before its first message.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.damage = Damage()
        """Of the last `entries` that was read to its end."""
        self._summary = self._read_summary()
        self.robot = self._find_robot()
        """Whose streams it holds."""

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """Robot time of the first and of the last message; None where the file has no index."""
        statistics = None if self._summary is None else self._summary.statistics
        if statistics is None:
            return None
        return statistics.message_start_time, statistics.message_end_time

    def entries(self) -> Iterator[Entry]:
        """The messages of the wire, in the order of their arrival."""
        known = {} if self._summary is None else self._summary.channels
        rows = {number: _row(channel) for number, channel in known.items()}
        damage = self.damage = Damage()
        for record in _read_records(self.path, damage):
            if isinstance(record, Channel):
                rows[record.id] = _row(record)
            elif isinstance(record, Message):
                row = rows.get(record.channel_id)
                if row is not None and not matches(row.robot, self.robot):
                    damage.other_robots.add(row.robot)
                elif row is not None:
                    yield Entry(record.log_time, row.name, row.topic, record.data, row.encoding)
                elif record.channel_id not in rows:
                    damage.lost_messages += 1

    def _read_summary(self) -> Summary | None:
        """The index at the end of the file, None where it was cut."""
        with self._open() as file:
            head = file.read(len(MCAP0_MAGIC))
            if head != MCAP0_MAGIC[: len(head)]:
                raise BadRecording(
                    f"{self.path}: is not an MCAP file; `trolley record` writes those"
                )
            file.seek(0)
            stream = cast("IO[bytes]", _WholeReads(file))
            try:
                return SeekingReader(stream, record_size_limit=MAX_RECORD_BYTES).get_summary()
            except _BROKEN:  # shorter than an index, or damaged
                return None

    def _find_robot(self) -> str:
        others: set[str] = set()
        channels: Iterator[McapRecord] = iter(())
        if self._summary is not None and self._summary.channels:
            channels = iter(self._summary.channels.values())
        else:
            channels = _read_records(self.path, Damage())
        for record in channels:
            if isinstance(record, Channel):
                row = _row(record)
                if row is not None:
                    return row.robot
                others.add(record.topic)
        if not others:
            raise BadRecording(f"{self.path}: ends before its first message; nothing can be played")
        named = ", ".join(sorted(others)[:NAMED]) + (" …" if len(others) > NAMED else "")
        raise ForeignRecording(
            f"{self.path}: another program wrote this MCAP file. It holds {named}, but none of "
            f"Trolley's own messages; only what `trolley record` wrote can be played"
        )

    def _open(self) -> IO[bytes]:
        try:
            return open_file(self.path)
        except OSError as error:
            raise BadRecording(f"{self.path}: cannot be read: {error.strerror or error}") from error


class _Row(NamedTuple):
    """What a channel of the wire holds."""

    robot: str
    """May hold wildcards in the key of a deletion."""
    name: str
    topic: Topic[Any]
    encoding: str


def _row(channel: Channel) -> _Row | None:
    """What a channel of the wire holds, None for any other channel."""
    found = split_key(channel.topic)
    topic = None if found is None else recorded_topic(channel.topic)
    if found is None or topic is None or WIRE not in channel.metadata:
        return None
    return _Row(*found, topic, channel.metadata[WIRE])


def read_any(path: Path, damage: Damage) -> Iterator[tuple[Message, Channel, Schema | None]]:
    """The messages of anybody's MCAP file in their order, as far as they are good."""
    channels: dict[int, Channel] = {}
    schemas: dict[int, Schema] = {}
    for record in _read_records(path, damage):
        match record:
            case Schema():
                schemas[record.id] = record
            case Channel():
                channels[record.id] = record
            case Message() if record.channel_id in channels:
                channel = channels[record.channel_id]
                yield record, channel, schemas.get(channel.schema_id)
            case Message():
                damage.lost_messages += 1
            case _:
                pass


def _read_records(path: Path, damage: Damage) -> Iterator[McapRecord]:
    """The records of an MCAP file and of its chunks up to its index, as far as they are good."""
    with open_file(path) as file:
        stream = _WholeReads(file)
        good = 0
        try:
            reader = StreamReader(
                cast("IO[bytes]", stream), emit_chunks=True, record_size_limit=MAX_RECORD_BYTES
            )
            for record in reader.records:
                good = stream.count
                if isinstance(record, DataEnd):  # what follows is the index
                    return
                if isinstance(record, Chunk):
                    yield from _open_chunk(record, damage)
                else:
                    yield record
        except _BROKEN:
            damage.unread_bytes = path.stat().st_size - good


def _open_chunk(chunk: Chunk, damage: Damage) -> Iterator[McapRecord]:
    try:
        plain = _decompressed(chunk)
        whole = dataclasses.replace(chunk, compression="", data=plain)
        records = breakup_chunk(whole, validate_crc=True)
    except _BROKEN:
        damage.bad_chunks += 1
        return
    yield from records


def _decompressed(chunk: Chunk) -> bytes:
    """What is in a chunk; never more than is allowed, whatever its bytes claim.

    Raises:
        ValueError: It is too large, shorter than it says, or compressed in an unknown way.
    """
    size = chunk.uncompressed_size
    if size > MAX_RECORD_BYTES:
        raise ValueError("too large")
    match chunk.compression:
        case "":
            data = chunk.data
        case "zstd":
            with zstandard.ZstdDecompressor().stream_reader(chunk.data) as stream:
                data = stream.read(size)
        case "lz4":
            lz4_frame: Any = lz4.frame.LZ4FrameDecompressor()  # it has no types
            data = bytes(lz4_frame.decompress(chunk.data, max_length=size))
        case other:
            raise ValueError(f"unknown compression {other!r}")
    if len(data) != size:
        raise ValueError("shorter than it says")
    return data


class _WholeReads:
    """A file of which a read gives everything asked for, or the end of the file."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self.count = 0
        self.seek, self.tell, self.seekable = file.seek, file.tell, file.seekable

    def read(self, length: int) -> bytes:
        if length > MAX_RECORD_BYTES:
            raise EndOfFile
        data = self._file.read(length)
        if len(data) < length:
            raise EndOfFile
        self.count += length
        return data
