"""Past trips in SQLite. These functions touch the disk: they run through `Service.work`."""

import contextlib
import datetime
import sqlite3
from collections.abc import Callable, Generator
from pathlib import Path
from typing import NamedTuple, TypeVar

import msgspec

from trolley.files import NEWER, keep_aside, make_folder, sync_folder
from trolley.messages import PastTrip
from trolley_tour.stored.checks import parse_utc

FILE = "history.sqlite"
SCHEMA = 1
"""The database's `user_version`; 0 stands for 1, which Trolley did not write at first."""
MAX_TRIPS = 10_000
"""Older trips are dropped."""
MAX_BYTES = 64 << 20
"""Greatest size of all trips as JSON; older trips that do not fit are dropped [bytes]."""
BUSY_S = 1.0
"""How long to wait for another reader of the file."""
DAY_S = 86_400.0
_CREATE = """
CREATE TABLE trips (
    number INTEGER PRIMARY KEY AUTOINCREMENT,
    trip TEXT NOT NULL,
    name TEXT,
    state TEXT NOT NULL,
    started_at TEXT,
    started REAL,  -- the same as Unix time [s], to compare
    document BLOB NOT NULL  -- the PastTrip as JSON
)
"""
_DROP_WHAT_DOES_NOT_FIT = """
DELETE FROM trips WHERE number IN (
    SELECT number FROM (
        SELECT
            number,
            row_number() OVER newest AS rank,
            sum(length(document)) OVER newest AS bytes
        FROM trips WINDOW newest AS (ORDER BY number DESC)
    ) WHERE rank > ? OR bytes > ? AND rank > 1
)
"""

T = TypeVar("T")


class Outcome(NamedTuple):
    """What became of saving or reading."""

    problem: str | None = None
    """What kept it from being done."""
    kept: str | None = None
    """What the file is called now that was found broken."""
    trips: tuple[PastTrip, ...] = ()
    num_unreadable: int = 0
    """Trips that are there but cannot be read."""


def keep_trip(folder: Path, trip: PastTrip, days: float) -> Outcome:
    """Add a trip and drop those older than `days` before it.

    A trip that is there already stays as it is.
    """
    return _with_recovery(folder / FILE, lambda path: _insert(path, trip, days))


def read_trips(
    folder: Path, since: datetime.datetime | None, limit: int, max_bytes: int
) -> Outcome:
    """Find the newest `limit` trips that began at or after `since`, newest first.

    Where they would not fit into `max_bytes` of JSON, the older ones are left out. Trips that began
    without a known time count only where no `since` is asked for.
    """

    def act(path: Path) -> Outcome:
        return _select(path, since, limit, max_bytes) if path.exists() else Outcome()

    return _with_recovery(folder / FILE, act)


def _with_recovery(path: Path, act: Callable[[Path], Outcome]) -> Outcome:
    """Run `act` on the file; one that is not our history is set aside, and a new one begun."""
    try:
        try:
            return act(path)
        except sqlite3.OperationalError:
            raise  # the disk: trying again elsewhere would not help
        except _NewerHistory:
            kept = keep_aside(path, NEWER)
            return act(path)._replace(kept=kept.name)
        except sqlite3.DatabaseError:
            kept = keep_aside(path)
            return act(path)._replace(kept=kept.name)
    except (sqlite3.Error, OSError) as error:
        return Outcome(problem=str(error))


class _NewerHistory(sqlite3.DatabaseError):
    """A newer Trolley has written the file."""


@contextlib.contextmanager
def _opened(path: Path) -> Generator[sqlite3.Connection]:
    """The database, in a transaction.

    Raises:
        sqlite3.DatabaseError: It is empty or of something else; `_NewerHistory`: of a newer
            Trolley.
    """
    if not path.exists():
        _make(path)
    elif not path.is_file() or path.stat().st_size == 0:
        raise sqlite3.DatabaseError("it is empty, or no file")
    with _connected(path) as connection:
        _check(connection)
        yield connection


@contextlib.contextmanager
def _connected(path: Path) -> Generator[sqlite3.Connection]:
    with contextlib.closing(sqlite3.connect(path, timeout=BUSY_S)) as connection, connection:
        # The end of a transaction is the deletion of its journal, and that is synced by this only.
        connection.execute("PRAGMA synchronous = EXTRA")
        yield connection


def _make(path: Path) -> None:
    """Begin a history: under its name it is never empty, whenever the power fails."""
    make_folder(path.parent)
    fresh = path.with_name(f".{path.name}.new")
    fresh.unlink(missing_ok=True)
    with _connected(fresh) as connection:
        connection.execute(_CREATE)
        connection.execute(f"PRAGMA user_version = {SCHEMA}")
    fresh.replace(path)
    sync_folder(path.parent)


def _check(connection: sqlite3.Connection) -> None:
    """Refuse what is not a history, or one of a newer schema."""
    (schema,) = connection.execute("PRAGMA user_version").fetchone()
    if schema > SCHEMA:
        raise _NewerHistory(f"schema {schema}")
    is_ours = connection.execute("SELECT 1 FROM sqlite_master WHERE name = 'trips'").fetchone()
    if not is_ours:
        raise sqlite3.DatabaseError("there are no trips in it")


def _unix(text: str | None) -> float | None:
    moment = None if text is None else parse_utc(text)
    return None if moment is None else moment.timestamp()


def _insert(path: Path, trip: PastTrip, days: float) -> Outcome:
    started, document = _unix(trip.started_at), msgspec.json.encode(trip)
    row = (trip.trip, trip.name, trip.state, trip.started_at, started, document)
    with _opened(path) as connection:
        there = connection.execute("SELECT document FROM trips WHERE trip = ?", (trip.trip,))
        if any(known == document for (known,) in there):
            return Outcome()
        connection.execute(
            "INSERT INTO trips (trip, name, state, started_at, started, document)"
            " VALUES (?, ?, ?, ?, ?, ?)",
            row,
        )
        if started is not None:
            connection.execute("DELETE FROM trips WHERE started < ?", (started - days * DAY_S,))
        connection.execute(_DROP_WHAT_DOES_NOT_FIT, (MAX_TRIPS, MAX_BYTES))
        connection.execute(f"PRAGMA user_version = {SCHEMA}")
    return Outcome()


def _select(path: Path, since: datetime.datetime | None, limit: int, max_bytes: int) -> Outcome:
    trips: list[PastTrip] = []
    num_unreadable = 0
    with _opened(path) as connection:
        rows = connection.execute(
            "SELECT document FROM trips WHERE ? IS NULL OR started >= ?"
            " ORDER BY number DESC LIMIT ?",
            (*2 * (None if since is None else since.timestamp(),), limit),
        )
        for (document,) in rows:
            max_bytes -= len(document) + 1
            if max_bytes < 0:
                break
            try:
                trips.append(msgspec.json.decode(document, type=PastTrip))
            except msgspec.DecodeError:
                num_unreadable += 1
    return Outcome(trips=tuple(trips), num_unreadable=num_unreadable)
