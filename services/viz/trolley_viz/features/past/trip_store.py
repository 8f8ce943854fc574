"""The records of trips on disk: written while a trip goes on, read when somebody looks at it."""

import re
from collections.abc import Callable
from pathlib import Path

from trolley.runtime.service import Service
from trolley.state_file import Unreadable, keep_unreadable
from trolley_viz.features.past import trip_file
from trolley_viz.features.past.record import Record

FOLDER = "viewer_trips"
"""In the state folder; below it one folder per robot, with one file per trip."""
ENDING = ".trip"
GONE = "The record of this trip is no longer there."
MAX_TRIPS = 50
"""Older ones are deleted."""
MAX_BYTES = 20 << 20
"""Greatest size of all files together; older ones are deleted [bytes]."""

NAMES = re.compile(r"[a-z0-9_-]{1,32}/[a-z0-9]{1,12}")
"""A robot and its trip that a file may be called by: other names may lead anywhere."""

TripName = tuple[str, str]
"""A robot and the id of its trip."""


class TripStore:
    """The files of all trips.

    Args:
        service: whose state folder and worker it uses.
    """

    def __init__(self, service: Service) -> None:
        self.names: frozenset[TripName] = frozenset()
        """The trips that there are on disk."""
        self.is_open = False
        """Whether it is known which there are."""
        self._service = service

    def open(self) -> None:
        """Look which there are."""
        folder = self._folder
        self._service.work(lambda: _prune(folder), self._listed)

    def save(self, name: TripName, record: Record) -> None:
        """Write the record of a trip, which must not change any more."""
        if not NAMES.fullmatch("/".join(name)):
            return
        folder, write = self._folder, self._writing(name, record)

        def work() -> tuple[OSError | None, frozenset[TripName]]:
            return write(), _prune(folder)

        def done(outcome: tuple[OSError | None, frozenset[TripName]]) -> None:
            error, names = outcome
            self._listed(names)
            if error is not None:
                self._service.count("past/not_saved")
                self._service.log.limited("past", "A trip was not recorded", why=error.strerror)

        self._service.work(work, done)

    def save_now(self, name: TripName, record: Record) -> None:
        """Write it before the viewer ends."""
        if not NAMES.fullmatch("/".join(name)):
            return
        error = self._writing(name, record)()
        if error is not None:
            self._service.log.error("A trip was not recorded", why=error.strerror)

    def read(self, name: TripName, then: Callable[[Record | str], None]) -> None:
        """Read the record of a trip, in time since boot; a sentence where that fails.

        What is broken, or of a newer Trolley, is set aside.
        """
        if name not in self.names:
            then(GONE)
            return
        path = self._path(name)

        def work() -> tuple[Record, int] | Unreadable | OSError:
            try:
                return trip_file.read(path)
            except (Unreadable, OSError) as error:
                return error

        def done(found: tuple[Record, int] | Unreadable | OSError) -> None:
            if isinstance(found, tuple):
                record, unix_offset_ns = found
                record.shift(unix_offset_ns - self.unix_offset_ns)
                then(record)
                return
            self.names -= {name}
            then(self._keep_aside(path, found))

        self._service.work(work, done)

    @property
    def unix_offset_ns(self) -> int:
        """What is added to time since boot for the clock on the wall, as that is set now."""
        return self._service.unix_ns - self._service.since_boot_ns

    # Inside.
    @property
    def _folder(self) -> Path:
        return self._service.state.path / FOLDER

    def _path(self, name: TripName) -> Path:
        robot, trip = name
        return self._folder / robot / f"{trip}{ENDING}"

    def _writing(self, name: TripName, record: Record) -> Callable[[], OSError | None]:
        path, unix_offset_ns = self._path(name), self.unix_offset_ns
        return lambda: trip_file.write(path, trip_file.encode(*name, unix_offset_ns, record))

    def _listed(self, names: frozenset[TripName]) -> None:
        self.names, self.is_open = names, True

    def _keep_aside(self, path: Path, why: Unreadable | OSError) -> str:
        if isinstance(why, FileNotFoundError):
            return GONE
        try:
            aside = keep_unreadable(path, why)
        except OSError:
            return "The record of this trip cannot be read."
        self._service.log.error(
            "The record of a trip cannot be read and was set aside", kept=aside, why=why
        )
        return f"The record of this trip cannot be read; it is kept as {aside.name}."


def _prune(folder: Path) -> frozenset[TripName]:
    """Delete the oldest files where there are too many, and tell which there are then."""
    found: list[tuple[float, int, Path]] = []
    for path in folder.glob(f"*/*{ENDING}"):
        try:
            stat = path.stat()
        except OSError:
            continue
        found.append((stat.st_mtime, stat.st_size, path))
    found.sort(reverse=True)
    names: set[TripName] = set()
    num_bytes = 0
    for number, (_, size, path) in enumerate(found):
        num_bytes += size
        if number < MAX_TRIPS and num_bytes <= MAX_BYTES:
            names.add((path.parent.name, path.name.removesuffix(ENDING)))
            continue
        try:
            path.unlink()
        except OSError:
            continue
    return frozenset(names)
