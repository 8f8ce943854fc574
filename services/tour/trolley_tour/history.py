"""Past trips in SQLite. These functions touch the disk: they run through `Service.work`."""

import contextlib
import datetime
import sqlite3
import time
from collections.abc import Generator
from pathlib import Path

import msgspec

from trolley.messages import PastTrip
from trolley_tour.store import parse_utc

FILE = "history.sqlite"
MAX_TRIPS = 10_000
BUSY_S = 1.0
DAY_S = 86_400.0
_CREATE = """
CREATE TABLE IF NOT EXISTS trips (
    number INTEGER PRIMARY KEY AUTOINCREMENT,
    trip TEXT NOT NULL,
    name TEXT,
    state TEXT NOT NULL,
    started_at TEXT,
    started REAL,  -- the same as Unix time [s], to compare
    document BLOB NOT NULL  -- the PastTrip as JSON
)
"""


@contextlib.contextmanager
def _opened(path: Path) -> Generator[sqlite3.Connection]:
    path.parent.mkdir(parents=True, exist_ok=True)
    with contextlib.closing(sqlite3.connect(path, timeout=BUSY_S)) as connection, connection:
        connection.execute(_CREATE)
        yield connection


def _unix(text: str | None) -> float | None:
    moment = None if text is None else parse_utc(text)
    return None if moment is None else moment.timestamp()


def keep_trip(folder: Path, trip: PastTrip, days: float) -> str | None:
    """Add a trip and drop those older than `days` before it; returns what kept it from being saved.

    A trip that is there already stays as it is. A file that is no database is kept aside, and a new
    one begun.
    """
    path = folder / FILE
    try:
        try:
            _insert(path, trip, days)
        except sqlite3.OperationalError:
            raise  # the disk: trying again elsewhere would not help
        except sqlite3.DatabaseError:
            path.rename(path.with_name(f"{FILE}.broken-{int(time.time())}"))
            _insert(path, trip, days)
    except (sqlite3.Error, OSError) as error:
        return str(error)
    return None


def _insert(path: Path, trip: PastTrip, days: float) -> None:
    started, document = _unix(trip.started_at), msgspec.json.encode(trip)
    row = (
        trip.trip,
        trip.name,
        trip.state,
        trip.started_at,
        started,
        document,
    )
    with _opened(path) as connection:
        there = connection.execute("SELECT document FROM trips WHERE trip = ?", (trip.trip,))
        if any(known == document for (known,) in there):
            return
        connection.execute(
            "INSERT INTO trips (trip, name, state, started_at, started, document)"
            " VALUES (?, ?, ?, ?, ?, ?)",
            row,
        )
        if started is not None:
            connection.execute("DELETE FROM trips WHERE started < ?", (started - days * DAY_S,))
        connection.execute(
            "DELETE FROM trips WHERE number <= (SELECT max(number) FROM trips) - ?", (MAX_TRIPS,)
        )


def read_trips(
    folder: Path, since: datetime.datetime | None, limit: int, max_bytes: int
) -> list[PastTrip] | str:
    """The newest `limit` trips that began at or after `since`, newest first; or why not.

    Where they would not fit into `max_bytes` of JSON, the older ones are left out. Trips that began
    without a known time count only where no `since` is asked for.
    """
    path = folder / FILE
    if not path.exists():
        return []
    trips: list[PastTrip] = []
    try:
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
                trips.append(msgspec.json.decode(document, type=PastTrip))
    except (sqlite3.Error, OSError, msgspec.DecodeError) as error:
        return str(error)
    return trips
