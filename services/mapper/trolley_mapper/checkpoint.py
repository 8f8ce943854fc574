"""The map in the making on disk, so that a mapper that was killed goes on with it."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import msgspec
from msgspec import Struct

from trolley.files import make_folder, write_atomically
from trolley.geometry import Pose2D
from trolley.messages import Zone
from trolley.messages.mapping import MapName
from trolley.runtime.service import Service
from trolley.state_file import Unreadable, keep_unreadable, read_encoded, reason_of
from trolley_mapper.anchored_zones import ZoneTie
from trolley_mapper.slam.estimate import Anchor

FILE = "mapping.bin"
"""The checkpoint's name in the robot's state folder."""
PERIOD_NS = 30_000_000_000
"""Local time between two checkpoints [ns]."""


class LastScan(Struct, frozen=True, kw_only=True):
    """The newest scan that was taken into account, if the robot was on the map then."""

    epoch_ns: int
    """Run of `base` in which it came [ns]."""
    stamp_ns: int
    """Robot time [ns]."""
    odom_T_base: Pose2D
    """Odometry of that run."""


class Checkpoint(Struct, frozen=True, kw_only=True):
    """A map in the making as it is stored."""

    schema: int = 7
    """Version of the file's format. Files of the first version have none."""
    name: MapName
    extends: str | None = None
    zones: list[Zone] = []
    zone_ties: dict[str, ZoneTie] = {}
    zones_deleted: list[str] = []
    anchors: dict[str, Anchor] = {}
    saved_at: dict[str, str | None] = {}
    """When the places had been saved that are tied to the map."""
    older: dict[str, str | None] | None = None
    """When those had been saved that were there before the map was begun, if that is known."""
    mirrors: list[Zone] = []
    """Where the robot has seen its own image while exploring."""
    seconds: float = 0.0
    loops: int = 0
    is_paused: bool = False
    is_exploring: bool = False
    home: Anchor | None = None
    """Where the map was first explored from."""
    last_scan: LastScan | None = None
    core: bytes
    """The map itself, see `slam.serialization`."""


class Checkpointer:
    """Writes checkpoints aside, and reports a disk that does not take them.

    Args:
        service: whose state folder and health it uses.
    """

    def __init__(self, service: Service) -> None:
        self.problem = ""
        """What is wrong with the disk, in a sentence; empty when all is well."""
        self._service = service
        self._saved_ns = 0
        self._saved: tuple[object, ...] = ()
        self._num_discarded = 0

    def restart(self) -> None:
        """Count the period until the next checkpoint from now on."""
        self._saved_ns = self._service.monotonic_ns

    @property
    def is_due(self) -> bool:
        """Whether the last checkpoint is old enough for another."""
        return self._service.monotonic_ns - self._saved_ns >= PERIOD_NS

    def save(
        self,
        revision: tuple[object, ...],
        snapshot: Callable[[], Callable[[], Checkpoint] | None],
    ) -> None:
        """Write a checkpoint, unless this revision is on disk already.

        Args:
            revision: differs whenever the checkpoint does.
            snapshot: takes hold of the map at once, and returns what makes the checkpoint, aside.
        """
        self.restart()
        make = None if revision == self._saved else snapshot()
        if make is not None:
            write = partial(_write, self._service.state.path, make)
            self._service.work(write, partial(self._written, self._num_discarded, revision))

    def discard(self) -> None:
        """Remove the checkpoint: its map was saved or canceled."""
        self._saved = ()
        self._num_discarded += 1
        self._service.work(partial(_remove, self._service.state.path), self._removed)
        self._set_problem("")

    def _written(
        self, num_discarded: int, revision: tuple[object, ...], problem: str | None
    ) -> None:
        if num_discarded != self._num_discarded:
            return  # its map was saved or canceled meanwhile
        self._saved = () if problem else revision
        self._set_problem(
            f"The map could not be backed up to disk ({problem}); mapping continues."
            if problem
            else ""
        )

    def _removed(self, problem: str | None) -> None:
        if problem is not None:
            self._service.log.error("The finished map's working file was not removed", why=problem)

    def _set_problem(self, problem: str) -> None:
        if problem and problem != self.problem:
            self._service.log.error(problem)
        self.problem = problem
        self._service.set_health("degraded" if problem else "ok", problem)


def _write(folder: Path, make: Callable[[], Checkpoint]) -> str | None:
    """Write a checkpoint, whole or not at all; returns why that failed, in a few words."""
    try:
        make_folder(folder)
        write_atomically(folder / FILE, msgspec.msgpack.encode(make()))
    except OSError as error:
        return error.strerror or str(error)
    return None


def read(folder: Path) -> Checkpoint | str | None:
    """Read the checkpoint: None if there is none, a sentence if it cannot be used."""
    try:
        return read_encoded(folder / FILE, Checkpoint, msgspec.msgpack.decode)
    except FileNotFoundError:
        return None
    except (Unreadable, OSError) as error:
        return put_aside(folder, error)


def put_aside(folder: Path, why: Exception) -> str:
    """Rename a checkpoint that cannot be used, and say so in a sentence."""
    try:
        aside = keep_unreadable(folder / FILE, why)
    except OSError as error:
        return f"The unfinished map can be neither read nor moved aside: {error.strerror}."
    return f"The unfinished map cannot be read ({reason_of(why)}); it is kept as {aside.name}."


def _remove(folder: Path) -> str | None:
    try:
        (folder / FILE).unlink(missing_ok=True)
    except OSError as error:
        return error.strerror or str(error)
    return None
