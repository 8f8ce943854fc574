"""Reads bags from beginning to end, or as far as they are intact: no index, no metadata needed.

The readers of rosbags want both, which a bag that was cut does not have.
"""

import re
import sqlite3
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import IO, Any, NamedTuple

from rosbags.rosbag1.reader import Header, ReaderError, RecordType, decompressors
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore
from rosbags.typesys.msg import normalize_msgtype

from trolley.files import open_file
from trolley.recording.layout import MAX_RECORD_BYTES
from trolley.recording.reader import Damage, read_any

_BAG1 = b"#ROSBAG V"
_SQLITE = b"SQLite format 3"
_MCAP = b"\x89MCAP0"
_ZSTD = b"\x28\xb5\x2f\xfd"
_UNREADABLE = (ReaderError, EOFError, OSError, ValueError, RuntimeError, struct.error)


class BadBag(Exception):
    """A file cannot be used as a bag; the text says why and what to do."""


class NotRead(Exception):
    """A message cannot be read; the text says why."""


@dataclass(frozen=True, slots=True)
class Channel:
    """What is sent under a topic."""

    topic: str
    type_name: str
    """As in ROS 2, such as `sensor_msgs/msg/LaserScan`."""
    encoding: str
    """`cdr` or `ros1`."""
    definition: str
    """Of the type and those in it, empty where the bag does not say."""


class Message(NamedTuple):
    """One message, as it was recorded."""

    channel: Channel
    at_ns: int
    """When it was recorded [ns since 1970]."""
    data: bytes


class Bag:
    """A ROS 1 bag, or a rosbag2: a file (mcap, db3), or a folder of them.

    Raises:
        BadBag: It is none.
    """

    def __init__(self, path: Path) -> None:
        self.damage: list[str] = []
        """Sentences about what could not be read, by the last `messages` that came to its end."""
        self._files = _files(path)
        self._stores: dict[Channel, Any] = {}

    def messages(self) -> Iterator[Message]:
        """All messages that can be read, in the order of the file."""
        self.damage = []
        for path, read in self._files:
            yield from read(path, self.damage)

    def read(self, message: Message) -> Any:
        """What a message says, by the definition in the bag.

        Raises:
            NotRead: It is not what its type says.
        """
        channel = message.channel
        if message.data.startswith(_ZSTD):
            raise NotRead("each message is compressed: `ros2 bag convert` unpacks them")
        try:
            if channel not in self._stores:
                self._stores[channel] = _store(channel)
            store = self._stores[channel]
            if channel.encoding == "ros1":
                return store.deserialize_ros1(message.data, channel.type_name)
            return store.deserialize_cdr(message.data, channel.type_name)
        except (SerdeError, TypesysError, KeyError, ValueError, IndexError, struct.error) as error:
            raise NotRead(f"it is no {channel.type_name} as the bag defines it: {error}") from error


def _store(channel: Channel) -> Any:
    if not channel.definition:
        return get_typestore(Stores.ROS2_JAZZY if channel.encoding == "cdr" else Stores.ROS1_NOETIC)
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(channel.definition, channel.type_name))
    return store


def _files(path: Path) -> list[tuple[Path, Any]]:
    if not path.is_dir():
        return [(path, _reader(path))]
    found = [one for one in path.iterdir() if one.suffix in {".db3", ".mcap", ".bag", ".zstd"}]
    if not found:
        raise BadBag(f"{path}: holds no bag: no file that ends in .mcap, .db3 or .bag")
    return [(one, _reader(one)) for one in sorted(found, key=_natural)]


def _natural(path: Path) -> list[tuple[int, str]]:
    """`drive_10` comes after `drive_9`."""
    return [(int(part or -1), "") if part.isdigit() else (-1, part)
            for part in re.split(r"(\d+)", path.name)]  # fmt: skip


def _reader(path: Path) -> Any:
    try:
        with open_file(path) as file:
            head = file.read(16)
    except OSError as error:
        raise BadBag(f"{path}: cannot be read: {error.strerror or error}") from error
    for magic, reader in ((_BAG1, _bag1), (_SQLITE, _db3), (_MCAP, _mcap)):
        if head.startswith(magic):
            return reader
    if head.startswith(_ZSTD):
        raise BadBag(f"{path}: is compressed as a whole; unpack it with `unzstd` first")
    raise BadBag(f"{path}: is neither a ROS 1 bag nor a rosbag2 (mcap, db3)")


def _cut(path: Path, left: int) -> str:
    return f"{path} was cut or is damaged: its last {left} bytes cannot be read."


def _bag1(path: Path, damage: list[str]) -> Iterator[Message]:
    known: dict[int, Channel] = {}
    with open_file(path) as file:
        file.readline()
        good = file.tell()
        while True:
            try:
                found = _record(file)
                rows = [] if found is None else list(_in_record(*found, known))
            except _UNREADABLE:
                damage.append(_cut(path, path.stat().st_size - good))
                return
            if found is None:
                return
            good = file.tell()
            yield from rows


def _record(file: IO[bytes]) -> tuple[Header, bytes] | None:
    """The next record's header and data; None at the end."""
    start = file.tell()
    if not file.read(1):
        return None
    file.seek(start)
    header = Header.read(file)  # pyrefly: ignore[bad-argument-type]
    (size,) = struct.unpack("<L", file.read(4))
    if size > MAX_RECORD_BYTES:
        raise EOFError
    data = file.read(size)
    if len(data) < size:
        raise EOFError
    return header, data


def _in_record(header: Header, data: bytes, known: dict[int, Channel]) -> Iterator[Message]:
    match header.get_uint8("op"):
        case RecordType.CHUNK:
            compression = header.get_string("compression")
            if compression not in decompressors:
                raise ValueError(compression)
            chunk = BytesIO(decompressors[compression](data))
            while (inner := _record(chunk)) is not None:
                yield from _in_record(*inner, known)
        case RecordType.CONNECTION:
            about = Header.read(BytesIO(struct.pack("<L", len(data)) + data))
            known[header.get_uint32("conn")] = Channel(
                topic=header.get_string("topic"),
                type_name=normalize_msgtype(about.get_string("type")),
                encoding="ros1",
                definition=about.get_string("message_definition"),
            )
        case RecordType.MSGDATA:
            channel = known.get(header.get_uint32("conn"))
            if channel is not None:
                yield Message(channel, header.get_time("time"), data)
        case _:  # indices
            pass


def _mcap(path: Path, damage: list[str]) -> Iterator[Message]:
    known: dict[int, Channel] = {}
    lost = Damage()
    for record, channel, schema in read_any(path, lost):
        if channel.id not in known:
            has_text = schema is not None and schema.encoding in {"ros2msg", "ros1msg"}
            known[channel.id] = Channel(
                topic=channel.topic,
                type_name="" if schema is None else normalize_msgtype(schema.name),
                encoding=channel.message_encoding,
                definition=schema.data.decode("utf-8", "replace") if schema and has_text else "",
            )
        yield Message(known[channel.id], record.log_time, record.data)
    damage += [f"{path}: {sentence}" for sentence in lost.sentences()]


def _db3(path: Path, damage: list[str]) -> Iterator[Message]:
    # Nothing is written, not even beside a bag that was not closed.
    base = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)
    try:
        # Else SQLite opens no file that is shorter than it says.
        base.execute("PRAGMA writable_schema = ON")
        known = {
            number: Channel(topic, normalize_msgtype(name), encoding, definition)
            for number, topic, name, encoding, definition in _topics(base)
        }
        for number, at_ns, data in base.execute("SELECT topic_id, timestamp, data FROM messages"):
            if number in known:
                yield Message(known[number], at_ns, data)
    except sqlite3.DatabaseError as error:
        damage.append(f"{path} was cut or is damaged: the rest cannot be read ({error}).")
    finally:
        base.close()


def _topics(base: sqlite3.Connection) -> list[tuple[int, str, str, str, str]]:
    rows = base.execute("SELECT id, name, type, serialization_format FROM topics").fetchall()
    has_definitions = base.execute(
        "SELECT 1 FROM sqlite_master WHERE name = 'message_definitions'"
    ).fetchone()
    definitions: dict[str, str] = {}
    if has_definitions:
        definitions = dict(
            base.execute(
                "SELECT topic_type, encoded_message_definition FROM message_definitions "
                "WHERE encoding = 'ros2msg'"
            )
        )
    return [(*row, definitions.get(row[2], "")) for row in rows]
