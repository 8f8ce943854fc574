"""The record of one trip as a file: msgpack, with its tables as packed columns.

A table is what `numpy` has of it in memory, column by column, packed by zlib. Each number of a
pose or of an echo is stored as its difference from the one before, byte by byte of equal weight:
so a file takes a third of what the plain numbers would.
"""

import zlib
from pathlib import Path
from typing import Any, ClassVar

import msgspec
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from trolley.files import make_folder, make_newest, read_file, write_atomically
from trolley.state_file import Unreadable, parse_encoded
from trolley_viz.features.past.record import POSE, SCAN, TRIP, Aim, Failure, Record, Sentence
from trolley_viz.features.past.rows import AT, Rows

MAX_BYTES = 2 << 20
"""No file of ours is larger."""
LEVEL = 6
"""How hard zlib tries."""


class Table(Struct, frozen=True, kw_only=True):
    """Rows of poses or scans."""

    num_rows: int
    gap_ns: int
    packed: bytes


class TripFile(Struct, frozen=True, kw_only=True):
    """The content of a file; times are those of `Record`."""

    SCHEMA: ClassVar[int] = 1
    """Counted up when the form changes, or the columns of the tables."""

    schema: int = SCHEMA
    robot: str
    trip: str
    unix_offset_ns: int
    """What is added to a time for nanoseconds since 1970, as the host's clock was at the end."""
    first_ns: int
    last_ns: int
    maps: list[str]
    poses: Table
    scans: Table
    sentences: list[Sentence]
    aims: list[Aim]
    failures: list[Failure]


def encode(robot: str, trip: str, unix_offset_ns: int, record: Record) -> bytes:
    """The content of a file; the record must not change meanwhile."""
    return msgspec.msgpack.encode(
        TripFile(
            robot=robot,
            trip=trip,
            unix_offset_ns=unix_offset_ns,
            first_ns=record.first_ns or 0,
            last_ns=record.last_ns,
            maps=record.maps,
            poses=_packed(record.poses),
            scans=_packed(record.scans),
            sentences=record.sentences,
            aims=record.aims,
            failures=record.failures,
        )
    )


def decode(content: bytes) -> tuple[Record, int]:
    """The record in a file, and its `unix_offset_ns`.

    Raises:
        Unreadable: It is broken, empty or of something else; `Newer`: of a newer Trolley.
    """
    file = parse_encoded(content, TripFile, msgspec.msgpack.decode)
    record = Record(TRIP)
    record.maps = file.maps
    record.poses.fill(_unpacked(file.poses, POSE, TRIP.poses), file.poses.gap_ns)
    record.scans.fill(_unpacked(file.scans, SCAN, TRIP.scans), file.scans.gap_ns)
    for rows in (record.poses.rows, record.scans.rows):
        if len(rows) and int(rows["map"].max()) >= len(record.maps):
            raise Unreadable("it names a map that it does not tell of")
    if (
        len(record.scans.rows)
        and int(record.scans.rows["count"].max()) > SCAN["points_cm"].shape[0]
    ):
        raise Unreadable("a scan has more echoes than there is room for")
    record.sentences, record.aims, record.failures = file.sentences, file.aims, file.failures
    record.first_ns, record.last_ns = file.first_ns, file.last_ns
    return record, file.unix_offset_ns


def write(path: Path, content: bytes) -> OSError | None:
    """Write a file, whole or not at all, as the newest of all robots; returns why that failed."""
    try:
        make_folder(path.parent)
        write_atomically(path, content)
        make_newest(path, path.parent.parent.glob(f"*/*{path.suffix}"))
    except OSError as error:
        return error
    return None


def read(path: Path) -> tuple[Record, int]:
    """What `decode` says of a file.

    Raises:
        OSError: It cannot be read.
        Unreadable: As `decode` does.
    """
    return decode(read_file(path, MAX_BYTES))


# Inside.
def _packed(table: Rows) -> Table:
    rows = table.rows
    columns = [_shuffled(np.ascontiguousarray(rows[name])) for name in rows.dtype.names or ()]
    packed = zlib.compress(b"".join(columns), LEVEL)
    return Table(num_rows=len(rows), gap_ns=table.gap_ns, packed=packed)


def _unpacked(table: Table, kind: np.dtype[Any], most: int) -> NDArray[Any]:
    if not 0 <= table.num_rows <= most or table.gap_ns < 0:
        raise Unreadable(f"a table of {table.num_rows} rows")
    size = table.num_rows * kind.itemsize
    unpacker = zlib.decompressobj()
    try:
        plain = unpacker.decompress(table.packed, size + 1)
    except zlib.error as error:
        raise Unreadable(str(error)) from error
    if len(plain) != size:
        raise Unreadable(f"a table of {len(plain)} bytes in place of {size}")
    rows, at = np.zeros(table.num_rows, kind), 0
    for name in kind.names or ():
        column = rows[name]
        rows[name] = _sorted_back(plain[at : at + column.nbytes], column)
        at += column.nbytes
    if not (np.diff(rows[AT]) > 0).all():
        raise Unreadable("its times are out of order")
    return rows


def _shuffled(column: NDArray[Any]) -> bytes:
    """Differences from row to row, as whole numbers, first all their lowest bytes and so on."""
    whole = column.view(f"<u{column.dtype.itemsize}")
    steps = np.diff(whole, axis=0, prepend=np.zeros_like(whole[:1]))
    return steps.reshape(-1, 1).view(np.uint8).T.tobytes()


def _sorted_back(plain: bytes, like: NDArray[Any]) -> NDArray[Any]:
    """Undo `_shuffled`."""
    size = like.dtype.itemsize
    steps = np.frombuffer(plain, np.uint8).reshape(size, -1).T
    whole = np.ascontiguousarray(steps).view(f"<u{size}").reshape(like.shape)
    return np.cumsum(whole, axis=0, dtype=whole.dtype).view(like.dtype)
