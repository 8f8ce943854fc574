"""Photos of past trips as files. These functions touch the disk: they run in `Service.work`."""

from collections.abc import Set
from pathlib import Path

from trolley.files import make_folder, make_newest, read_file, write_atomically

FOLDER = "photos"
SUFFIX = ".jpg"


def name_of(trip: str, number: int) -> str:
    """The name of the photo of a stop: the how manyth result of its trip, from 0."""
    return f"{trip}-{number}"


def keep(folder: Path, name: str, jpeg: bytes, max_bytes: int) -> None:
    """Write a photo; the oldest make room for it.

    Raises:
        OSError: It cannot be written.
    """
    photos = folder / FOLDER
    make_folder(photos)
    path = photos / f"{name}{SUFFIX}"
    there = {one: one.stat() for one in photos.glob(f"*{SUFFIX}")}
    num_bytes = len(jpeg) + sum(one.st_size for one in there.values())
    for old in sorted(there, key=lambda one: there[one].st_mtime_ns):
        if num_bytes <= max_bytes:
            break
        old.unlink(missing_ok=True)
        num_bytes -= there[old].st_size
    write_atomically(path, jpeg)
    make_newest(path, photos.glob(f"*{SUFFIX}"))


def names(folder: Path) -> Set[str]:
    """The names of all photos."""
    return {path.stem for path in (folder / FOLDER).glob(f"*{SUFFIX}")}


def read(folder: Path, name: str, max_bytes: int) -> bytes | None:
    """Read a photo; None where there is none.

    Raises:
        OSError: It cannot be read.
    """
    try:
        return read_file(folder / FOLDER / f"{name}{SUFFIX}", max_bytes)
    except FileNotFoundError:
        return None
