"""Writes a recording so that what is older than the last flush survives a crash and a power cut."""

import errno
import json
import os
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self, cast

import msgspec
from mcap.writer import CompressionType, Writer

from trolley.foxglove.views import CHANNELS
from trolley.recording.layout import ABOUT, SCHEMA_PREFIX, WIRE
from trolley.runtime.codec import detect_format
from trolley.topics import Topic

CHUNK_BYTES = 1 << 20
LEFT_SHARE, LEFT_BYTES = 0.01, 500_000_000
"""What is left of a disk for what the robot saves: this share of it, this much at most."""


class RecordingWriter:
    """An MCAP file that is being written; a context manager.

    `finish` writes the index at the end of the file. Without it, after a crash, the file is good up
    to the last `flush`.

    Args:
        path: A file that does not exist yet.
        about: What else to say about the recording, for people.

    Raises:
        OSError: The file exists, or cannot be written; so do the methods where the disk is full.
    """

    def __init__(self, path: Path, robot: str, about: Mapping[str, str]) -> None:
        self.robot = robot
        self.num_messages = 0
        """Messages of the wire in the file."""
        self._file = _File(path)
        self._schemas: dict[str, int] = {}
        self._wire: dict[tuple[str, str], int] = {}
        self._views: dict[str, int] = {}
        self._mcap = Writer(
            cast("IO[Any]", self._file),
            chunk_size=CHUNK_BYTES,
            compression=CompressionType.ZSTD,
        )
        try:
            self._mcap.start(library="trolley")
            self._mcap.add_metadata(ABOUT, {"robot": robot, **about})
            self.flush()
        except OSError:
            self._file.close()
            path.unlink()
            raise

    @property
    def size(self) -> int:
        """Bytes in the file."""
        return self._file.size

    def add(
        self, at_ns: int, key: str, topic: Topic[Any], payload: bytes, encoding: str, stamp_ns: int
    ) -> None:
        """Add a message of the wire; an empty payload says that the key was deleted."""
        channel = self._wire.get((key, encoding))
        if channel is None:
            channel = self._mcap.register_channel(
                topic=key,
                message_encoding=detect_format(payload, encoding),
                schema_id=self._schema_of(topic),
                metadata={WIRE: encoding},
            )
            self._wire[key, encoding] = channel
        self._mcap.add_message(channel, log_time=at_ns, data=payload, publish_time=stamp_ns)
        self.num_messages += 1

    def add_view(self, at_ns: int, name: str, data: bytes, stamp_ns: int) -> None:
        """Add what a channel of Foxglove shows."""
        channel = self._views.get(name)
        if channel is None:
            row = CHANNELS[name]
            channel = self._mcap.register_channel(
                topic=row.of(self.robot),
                message_encoding=row.encoding,
                schema_id=self._schema(row.schema.name, row.schema.encoding, row.schema.data),
            )
            self._views[name] = channel
        self._mcap.add_message(channel, log_time=at_ns, data=data, publish_time=stamp_ns)

    def flush(self) -> None:
        """End the chunk and wait until it is on the disk; `abandon` drops one that fills it."""
        self._mcap.flush()
        self._file.leave_room()
        self._file.sync()

    def finish(self) -> None:
        """Write the index, which ends the file."""
        self._mcap.finish()
        self._file.sync()

    def abandon(self) -> None:
        """Take away what was begun and could not be written, so that the file ends with a chunk."""
        self._file.cut()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._file.close()

    def _schema_of(self, topic: Topic[Any]) -> int:
        name = SCHEMA_PREFIX + topic.message.__name__
        data = json.dumps(msgspec.json.schema(topic.message)).encode()
        return self._schema(name, "jsonschema", data)

    def _schema(self, name: str, encoding: str, data: bytes) -> int:
        # The plain schema of a JSON channel and the full one of the wire share a name.
        known = f"{name} {len(data)}"
        if known not in self._schemas:
            self._schemas[known] = self._mcap.register_schema(name, encoding, data)
        return self._schemas[known]


class _File:
    """A new file without a buffer of its own: what was written is the kernel's, or an error."""

    def __init__(self, path: Path) -> None:
        self._handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
        self.size = 0
        self._synced = 0
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)  # the name must survive a power cut, too
        finally:
            os.close(folder)

    def write(self, data: bytes) -> int:
        left = memoryview(data)
        while left:
            written = os.write(self._handle, left)
            self.size += written
            left = left[written:]
        return len(data)

    def tell(self) -> int:
        return self.size

    def flush(self) -> None:
        """There is nothing to flush."""

    def sync(self) -> None:
        os.fsync(self._handle)
        self._synced = self.size

    def leave_room(self) -> None:
        disk = os.fstatvfs(self._handle)
        left = disk.f_frsize * disk.f_bavail
        if left < min(LEFT_SHARE * disk.f_frsize * disk.f_blocks, LEFT_BYTES):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def cut(self) -> None:
        os.ftruncate(self._handle, self._synced)
        self.size = self._synced

    def close(self) -> None:
        os.close(self._handle)
