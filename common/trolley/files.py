"""Files that are written whole or not at all; broken ones are set aside."""

import ctypes
import errno
import os
import stat
import tempfile
import time
from collections.abc import Generator, Iterable
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

READABLE_BY_ALL, SECRET = 0o644, 0o600
BROKEN, NEWER = "broken", "newer"
"""How files are marked that were set aside: the content is broken, or of a newer Trolley."""
NOT_REGULAR = "It is a pipe or a device, not a file"
MOST_BYTES = 256 << 20
"""No file that Trolley reads as a whole is larger."""
_GRAIN_NS = 1_000_000_000
"""Some file systems keep no finer times."""
_AT_FDCWD, _RENAME_EXCHANGE = -100, 2


def write_atomically(path: Path, content: bytes, mode: int = READABLE_BY_ALL) -> None:
    """Replace a file so that after a crash it holds the old or the new content, never a part.

    Args:
        path: the file.
        content: the new content.
        mode: who may read and write it.

    Raises:
        OSError: It cannot be written; the old content stands.
    """
    with written_atomically(path, mode) as file:
        file.write(content)


@contextmanager
def written_atomically(path: Path, mode: int = READABLE_BY_ALL) -> Generator[BinaryIO]:
    """A file to write to that takes the place of `path` when the context ends without an error.

    Raises:
        OSError: It cannot be written; the old content stands.
    """
    handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            os.fchmod(handle, mode)
            yield file
            file.flush()
            os.fsync(handle)
        Path(temporary).replace(path)
    finally:
        Path(temporary).unlink(missing_ok=True)
    sync_folder(path.parent)  # the new name itself must survive a power cut, too


def make_newest(path: Path, others: Iterable[Path]) -> None:
    """Let a file that was just written be newer than others, also where the clock was set back.

    Raises:
        OSError: Its time cannot be set, or that of another one cannot be read.
    """
    newest_ns = max((other.stat().st_mtime_ns for other in others if other != path), default=0)
    if path.stat().st_mtime_ns <= newest_ns:
        later_ns = newest_ns + _GRAIN_NS
        os.utime(path, ns=(later_ns, later_ns))


def why_not_written(path: Path, error: OSError) -> str:
    """Say why a new file could not be made; a folder that is not there is named."""
    if not path.parent.exists():
        return f"there is no folder {path.parent}"
    if error.errno == errno.ENOENT:
        return f"nothing can be written into {path.parent}"
    return error.strerror or str(error)


def make_folder(path: Path) -> None:
    """Make a folder that survives a power cut, and those above it; nothing if it is there.

    Raises:
        OSError: It cannot be made.
    """
    if path.is_dir():
        return
    make_folder(path.parent)
    path.mkdir(exist_ok=True)
    sync_folder(path.parent)


def exchange(one: Path, other: Path) -> None:
    """Let two files or folders swap their names, in one step.

    Raises:
        OSError: They cannot, as where the file system has no such step.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    names = os.fsencode(one), os.fsencode(other)
    if libc.renameat2(_AT_FDCWD, names[0], _AT_FDCWD, names[1], _RENAME_EXCHANGE) != 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()), str(one))


def sync_folder(folder: Path) -> None:
    """Make sure that names in a folder survive a power cut, too."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def expand_home(name: str | Path) -> Path:
    """A path in which `~` stands for a home folder; of a user who is unknown it stays as it is."""
    return Path(os.path.expanduser(name))


def open_file(path: Path) -> BinaryIO:
    """Open a regular file to read: a pipe would never end, and a device may do anything.

    Raises:
        OSError: It cannot be read, or is not a regular file.
    """
    # Without O_NONBLOCK a pipe that nobody writes to would hold up the opening itself.
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    mode = os.fstat(handle).st_mode
    if stat.S_ISREG(mode):
        return os.fdopen(handle, "rb")
    os.close(handle)
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    raise OSError(errno.EINVAL, NOT_REGULAR, str(path))


def read_file(path: Path, most_bytes: int = MOST_BYTES) -> bytes:
    """The content of a regular file.

    Raises:
        OSError: It cannot be read, is not a regular file, or is larger than `most_bytes`.
    """
    with open_file(path) as file:
        if os.fstat(file.fileno()).st_size > most_bytes:
            raise OSError(errno.EFBIG, os.strerror(errno.EFBIG), str(path))
        return file.read(most_bytes)


def read_text(path: Path, most_bytes: int = MOST_BYTES) -> str:
    """The text, in UTF-8, of a regular file.

    Raises:
        OSError: As `read_file` does.
        UnicodeDecodeError: It is not UTF-8.
    """
    return read_file(path, most_bytes).decode("utf-8")


def keep_aside(path: Path, why: str = BROKEN) -> Path:
    """Rename a file to `<name>.broken-<Unix time>`, and say what it is called now.

    Args:
        path: the file.
        why: stands in place of `broken`.

    Raises:
        OSError: It cannot be renamed.
    """
    first = path.with_name(f"{path.name}.{why}-{int(time.time())}")
    aside, number = first, 1
    while aside.exists():
        number += 1
        aside = first.with_name(f"{first.name}-{number}")
    path.rename(aside)
    return aside
