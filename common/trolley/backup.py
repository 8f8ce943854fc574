"""A robot's state and settings as one file, and back: what `trolley backup` and `restore` do.

The file is a `.tar.gz`: first `trolley-backup.toml` (what it is), then `state/...`, the host's
state folder, and `config/...`, robot.toml with the files beside it that it names. Nothing in an
archive is used before all of it has been read and checked.
"""

import gzip
import os
import re
import shutil
import sqlite3
import stat
import tarfile
import tempfile
import tomllib
import zlib
from collections.abc import Iterator
from contextlib import closing
from datetime import datetime
from io import BytesIO
from pathlib import Path, PurePosixPath
from typing import IO

import msgspec
import tomli_w

from trolley.config import ConfigError, RobotConfig, load_config
from trolley.files import (
    READABLE_BY_ALL,
    SECRET,
    exchange,
    open_file,
    read_file,
    sync_folder,
    write_atomically,
    written_atomically,
)
from trolley.sanitize import escape

FORMAT = 1
MANIFEST, STATE, CONFIG, CONFIG_FILE = "trolley-backup.toml", "state", "config", "robot.toml"
MAX_FILES = 20_000
MAX_BYTES = 4 << 30
"""Greatest size of all files together, unpacked [bytes]."""
_LATEST_S = 2.0**32
"""No file was changed later [s since 1970]."""
_PHOTO = ".jpg"
"""Of stops that were reached: a backup that is full leaves out the oldest of them."""
_STATE_FOLDER = re.compile(r"maps|[a-z0-9_-]{1,32}")
# SQLite's own side files belong to the database at that moment, not to its copy.
_SIDE_FILES = ("-wal", "-shm", "-journal")


class BackupError(Exception):
    """It cannot be saved or restored; the text says why, and what has been changed if anything."""


class Manifest(msgspec.Struct, frozen=True, kw_only=True):
    """What a backup says about itself."""

    format: int
    made_at: str
    """The host's clock, which may have been wrong; ISO 8601."""
    version: str
    """Version of the Trolley that made it."""


class Saved(msgspec.Struct, frozen=True):
    """What went into a backup."""

    num_files: int
    left_out: list[str]
    """Files that were left out or could only be taken as they are, a sentence each."""


def save(target: Path, state: Path, config: Path | None, manifest: Manifest) -> Saved:
    """Write a backup of a state folder and a robot.toml; services may run meanwhile.

    Raises:
        BackupError: It cannot be written; there is no such file then.
    """
    left_out: list[str] = []
    num_files = 0
    try:
        # It holds the viewer's tokens.
        with (
            written_atomically(target, SECRET) as file,
            tarfile.open(fileobj=file, mode="w:gz", compresslevel=6) as archive,
        ):
            _add(archive, MANIFEST, tomli_w.dumps(msgspec.to_builtins(manifest)).encode())
            room = _Room()
            for name, path in _entries(state, config, left_out):
                if room.takes(path):
                    num_files += _add_file(archive, name, path, left_out)
    except (OSError, tarfile.TarError) as error:
        raise BackupError(f"{target} cannot be written: {error}") from error
    if room.num_left_out:
        photos = "photo was" if room.num_left_out == 1 else "photos were"
        left_out.append(
            f"{room.num_left_out} {photos} left out, the oldest: a backup holds {MAX_FILES} files "
            f"and {MAX_BYTES / 1e9:.1f} GB"
        )
    return Saved(num_files, left_out)


class _Room:
    """What a backup may hold so that it can be restored: photos count last."""

    def __init__(self) -> None:
        self.num_left_out = 0
        self._num_files = 0
        self._num_bytes = 0

    def takes(self, path: Path) -> bool:
        """Whether a file goes in; a photo may not.

        Raises:
            BackupError: It does not fit, and is no photo.
        """
        try:
            num_bytes = path.stat().st_size
        except FileNotFoundError:  # it has gone meanwhile
            return False
        if self._num_files < MAX_FILES and self._num_bytes + num_bytes <= MAX_BYTES:
            self._num_files += 1
            self._num_bytes += num_bytes
            return True
        if path.suffix != _PHOTO:
            raise BackupError(
                f"{path} does not fit: a backup holds {MAX_FILES} files and "
                f"{MAX_BYTES / 1e9:.1f} GB. Move away what Trolley did not make"
            )
        self.num_left_out += 1
        return False


def _entries(state: Path, config: Path | None, left_out: list[str]) -> Iterator[tuple[str, Path]]:
    """All files by their names in the backup, photos last and the newest of them first."""
    photos: list[tuple[float, str, Path]] = []
    for path in _files_of(state, left_out):
        name = f"{STATE}/{path.relative_to(state).as_posix()}"
        if not _belongs(name):
            left_out.append(
                f"{escape(str(path))} does not belong to a robot's state and was left out"
            )
        elif path.suffix == _PHOTO:
            photos.append((-_changed_s(path), name, path))
        else:
            yield name, path
    if config is not None:
        for name, path in _config_files(config, left_out):
            yield f"{CONFIG}/{name}", path
    for _, name, path in sorted(photos):
        yield name, path


def _changed_s(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except FileNotFoundError:
        return 0.0


def _files_of(state: Path, left_out: list[str]) -> Iterator[Path]:
    """All files to keep, in order; temporary ones are left out silently."""
    for folder, folders, names in os.walk(state):
        folders.sort()
        for name in sorted(names):
            path = Path(folder) / name
            if name.startswith(".") or name.endswith(_SIDE_FILES):
                continue
            if path.is_symlink() or not path.is_file():
                left_out.append(f"{path} is not a regular file and was left out")
                continue
            yield path


def _config_files(config: Path, left_out: list[str]) -> Iterator[tuple[str, Path]]:
    """robot.toml and the files that it names, by their names in the backup."""
    yield CONFIG_FILE, config
    try:
        settings = load_config(config)
    except ConfigError as error:
        left_out.append(f"the files that robot.toml names were left out: {error}")
        return
    folder = config.resolve().parent
    for path in _named_files(settings, left_out):
        if path.is_relative_to(folder):
            yield path.relative_to(folder).as_posix(), path
        else:
            left_out.append(f"{path} was left out: it does not lie below {folder}")


def _named_files(settings: RobotConfig, left_out: list[str]) -> Iterator[Path]:
    named = [settings.map.file, settings.robot.mesh]
    for name in [one for one in named if one is not None]:
        path = settings.path(name).resolve()
        if not path.is_file():
            left_out.append(f"{path}, which robot.toml names, is not there")
            continue
        yield path
        if name == settings.map.file:
            yield from _beside_map(path, left_out)


def _beside_map(file: Path, left_out: list[str]) -> Iterator[Path]:
    """The image of a map and the zones that come with it."""
    from trolley.gridmap import MapError  # numba, which only this needs
    from trolley.gridmap.description import read_description

    try:
        image = (file.parent / read_description(file).image).resolve()
    except MapError as error:
        left_out.append(f"the image of the map was left out: {error}")
    else:
        if image.is_file():
            yield image
    zones = file.with_name(f"{file.stem}.zones.toml")
    if zones.is_file():
        yield zones


def _add_file(archive: tarfile.TarFile, name: str, path: Path, left_out: list[str]) -> bool:
    """Put a file into the archive; False where it has gone meanwhile."""
    try:
        about = path.stat()
        content = (
            _database(path, left_out) if path.suffix == ".sqlite" else read_file(path, MAX_BYTES)
        )
    except FileNotFoundError:
        return False
    _add(archive, name, content, _kept_mode(stat.S_IMODE(about.st_mode)), about.st_mtime)
    return True


def _kept_mode(mode: int) -> int:
    return READABLE_BY_ALL if mode & stat.S_IROTH else SECRET


def _database(path: Path, left_out: list[str]) -> bytes:
    """A database as it is between two changes, whoever writes to it meanwhile."""
    try:
        with (
            closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as source,
            closing(sqlite3.connect(":memory:")) as copy,
        ):
            source.backup(copy)
            return copy.serialize()
    except sqlite3.Error as error:
        left_out.append(f"{path} was taken as it is: {error}")
        return path.read_bytes()


def _add(
    archive: tarfile.TarFile,
    name: str,
    content: bytes,
    mode: int = READABLE_BY_ALL,
    changed_s: float = 0.0,
) -> None:
    entry = tarfile.TarInfo(name)
    # With the time, since the oldest photos make room for new ones after a restore, too.
    entry.size, entry.mode, entry.mtime = len(content), mode, max(0.0, changed_s)
    archive.addfile(entry, BytesIO(content))


class Unpacked:
    """A backup that has been read and checked, in a folder beside the state folder.

    Args:
        source: the backup.
        state: the state folder.
        state_only: its robot.toml is not wanted, so it need not be a good one.

    Raises:
        BackupError: It is not a backup, is damaged, or contains what no backup contains.
    """

    def __init__(self, source: Path, state: Path, *, state_only: bool = False) -> None:
        try:
            state.parent.mkdir(parents=True, exist_ok=True)
            self._folder = Path(
                tempfile.mkdtemp(prefix=f".{state.name}.restoring.", dir=state.parent)
            )
        except OSError as error:
            raise BackupError(f"{state.parent} cannot be written: {error.strerror}") from error
        try:
            self.manifest = _unpack(source, self._folder)
            if self.config is not None and not state_only:
                load_config(self.config)
        except ConfigError as error:
            self.close()
            why = (
                str(error)
                .removeprefix(f"{self._folder / CONFIG / CONFIG_FILE}: ")
                .removesuffix(".")
            )
            raise BackupError(
                f"{source}: its robot.toml cannot be used here: {why}; --state-only restores "
                "the rest"
            ) from error
        except BackupError:
            self.close()
            raise

    @property
    def config(self) -> Path | None:
        """Its robot.toml, None if it has none."""
        path = self._folder / CONFIG / CONFIG_FILE
        return path if path.is_file() else None

    def put_state(self, state: Path, now: datetime) -> Path | None:
        """Replace the state, and return the new name of the old one.

        Wherever the power is cut the old state or the new one is in place, except on a file system
        that cannot swap two names in one step.

        Raises:
            BackupError: What is there cannot be moved aside.
        """
        fresh = self._folder / STATE
        fresh.mkdir(exist_ok=True)
        aside: Path | None = None
        try:
            _sync_folders(fresh)
            if state.exists():
                _take_over_owner(state, fresh)
                aside = _free_name(state, now)
                _swap(fresh, state, aside)
            else:
                fresh.rename(state)
            sync_folder(state.parent)
        except OSError as error:
            if aside is not None and aside.exists() and not state.exists():
                aside.rename(state)
            raise BackupError(f"{state} cannot be replaced: {error.strerror}") from error
        return aside

    def put_config(self, config: Path, now: datetime) -> list[Path]:
        """Put its robot.toml and what belongs to it in place; what changes is kept beside.

        Returns:
            What the old files are called now.

        Raises:
            BackupError: It cannot be written.
        """
        source, kept = self._folder / CONFIG, list[Path]()
        try:
            for path in sorted(source.rglob("*")):
                name = path.relative_to(source)
                target = config if name == Path(CONFIG_FILE) else config.parent / name
                if path.is_dir() or (target.is_file() and target.read_bytes() == path.read_bytes()):
                    continue
                target.parent.mkdir(parents=True, exist_ok=True)
                if target.exists():
                    kept.append(_free_name(target, now))
                    shutil.copy2(target, kept[-1])
                # The old file's owner and mode, else those that let services of its group read it.
                example = target.stat() if target.exists() else target.parent.stat()
                mode = example.st_mode if target.exists() else path.stat().st_mode | stat.S_IRGRP
                write_atomically(target, path.read_bytes(), stat.S_IMODE(mode))
                if os.geteuid() == 0:
                    os.chown(target, example.st_uid, example.st_gid)
        except OSError as error:
            raise BackupError(f"{config.parent} cannot be written: {error.strerror}") from error
        return kept

    def close(self) -> None:
        """Remove what was unpacked but not used."""
        shutil.rmtree(self._folder, ignore_errors=True)


def _free_name(path: Path, now: datetime) -> Path:
    first = path.with_name(f"{path.name}.before-{now:%Y%m%d-%H%M%S}")
    aside, number = first, 1
    while aside.exists():
        number += 1
        aside = first.with_name(f"{first.name}-{number}")
    return aside


def _swap(fresh: Path, state: Path, aside: Path) -> None:
    """Put a folder in the place of another one, which is called `aside` afterwards."""
    fresh.rename(aside)
    try:
        exchange(aside, state)
    except OSError:
        aside.rename(fresh)
        state.rename(aside)
        fresh.rename(state)


def _sync_folders(folder: Path) -> None:
    """Make sure that all names in a folder survive a power cut."""
    for path in (folder, *folder.rglob("*")):
        if path.is_dir():
            sync_folder(path)


def _take_over_owner(example: Path, folder: Path) -> None:
    """Give all of a folder the owner of the one that it replaces, as only root can."""
    if os.geteuid() != 0:
        return
    owner = example.stat()
    folder.chmod(stat.S_IMODE(owner.st_mode))
    for path in (folder, *folder.rglob("*")):
        os.chown(path, owner.st_uid, owner.st_gid)


def _unpack(source: Path, folder: Path) -> Manifest:
    """Write all files of a backup into an empty folder.

    Raises:
        BackupError: At the first thing that is wrong.
    """
    num_bytes, manifest = 0, None
    try:
        with (
            open_file(source) as file,
            gzip.open(file) as stream,
            tarfile.open(fileobj=stream, mode="r:") as archive,
        ):
            for number, entry in enumerate(archive):
                if number == 0:
                    manifest = _read_manifest(source, archive, entry)
                    continue
                target = folder / _checked_name(source, entry)
                num_bytes += entry.size
                if number > MAX_FILES or num_bytes > MAX_BYTES:
                    raise BackupError(f"{source}: larger than any backup")
                if entry.isfile():
                    _write(archive.extractfile(entry), target, entry)
            while stream.read(1 << 20):  # the checksum stands behind all of it
                pass
    except (gzip.BadGzipFile, tarfile.TarError, EOFError, zlib.error, ValueError) as error:
        raise BackupError(f"{source} is not a backup, or is damaged: {error}") from error
    except OSError as error:
        raise BackupError(f"{source} cannot be unpacked: {error}") from error
    if manifest is None:
        raise BackupError(f"{source} is empty")
    return manifest


def _read_manifest(source: Path, archive: tarfile.TarFile, entry: tarfile.TarInfo) -> Manifest:
    content = archive.extractfile(entry) if entry.name == MANIFEST and entry.isfile() else None
    if content is None or entry.size > 1 << 16:
        raise BackupError(f"{source} was not made by `trolley backup`")
    try:
        manifest = msgspec.convert(tomllib.loads(content.read().decode()), type=Manifest)
    except (ValueError, msgspec.ValidationError, RecursionError) as error:
        raise BackupError(f"{source} was not made by `trolley backup`: {error}") from error
    if manifest.format != FORMAT:
        raise BackupError(f"{source} was made by a newer Trolley ({manifest.version})")
    return manifest


def _checked_name(source: Path, entry: tarfile.TarInfo) -> PurePosixPath:
    """Where an entry belongs.

    Raises:
        BackupError: It is anything but a file in a folder that backups have.
    """
    if not (entry.isfile() or entry.isdir()) or not _belongs(entry.name):
        raise BackupError(f"{source} holds {entry.name[:80]!r}, which no backup contains")
    return PurePosixPath(entry.name)


def _belongs(name: str) -> bool:
    """Whether a file of this name may be in a backup: nothing is saved that is not restored."""
    parts = name.split("/")
    try:
        is_plain = all(
            part not in ("", ".", "..") and "\0" not in part and len(part.encode()) <= 255
            for part in parts
        )
    except UnicodeEncodeError:  # a file's name that is not UTF-8
        return False
    is_ours = parts[0] == CONFIG or (
        parts[0] == STATE and (len(parts) < 2 or _STATE_FOLDER.fullmatch(parts[1]) is not None)
    )
    return is_plain and is_ours and len(name) <= 1024


def _write(content: IO[bytes] | None, target: Path, entry: tarfile.TarInfo) -> None:
    if content is None:
        return
    target.parent.mkdir(parents=True, exist_ok=True)
    with target.open("xb") as file:  # x: nothing is in an archive twice
        os.fchmod(file.fileno(), _kept_mode(entry.mode))
        shutil.copyfileobj(content, file)
        file.flush()
        if 0.0 < entry.mtime < _LATEST_S:  # older backups say no time
            os.utime(file.fileno(), (entry.mtime, entry.mtime))
        os.fsync(file.fileno())
