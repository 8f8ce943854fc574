"""The map that is being made, on disk: a mapper that was killed goes on with it."""

from collections.abc import Callable
from pathlib import Path

import msgspec
from msgspec import Struct

from trolley.files import keep_aside, make_folder, write_atomically
from trolley.messages import Zone
from trolley.messages.mapping import MapName
from trolley_mapper.slam.estimate import Anchor

FILE = "mapping.bin"
_VERSION = 1


class Kept(Struct, frozen=True, kw_only=True):
    """What is kept of a map in the making."""

    version: int = _VERSION
    name: MapName
    extends: str | None = None
    zones: list[Zone] = []
    anchors: dict[str, Anchor] = {}
    seconds: float = 0.0
    loops: int = 0
    is_paused: bool = False
    is_exploring: bool = False
    core: bytes
    """The core's own bytes."""


def write(folder: Path, make: Callable[[], Kept]) -> str | None:
    """Make it and write it whole or not at all; returns why that failed, in a few words."""
    try:
        make_folder(folder)
        write_atomically(folder / FILE, msgspec.msgpack.encode(make()))
    except OSError as error:
        return error.strerror or str(error)
    return None


def read(folder: Path) -> Kept | str | None:
    """Read it; None if there is none, a sentence where it cannot be used and is kept aside."""
    file = folder / FILE
    try:
        kept = msgspec.msgpack.decode(file.read_bytes(), type=Kept)
    except FileNotFoundError:
        return None
    except OSError as error:
        return f"The map that was being made cannot be read: {error.strerror}."
    except (msgspec.MsgspecError, RecursionError):
        return put_aside(folder)
    return kept if kept.version == _VERSION else put_aside(folder)


def put_aside(folder: Path) -> str:
    """Keep what cannot be used under another name, and say so in a sentence."""
    try:
        aside = keep_aside(folder / FILE)
    except OSError as error:
        return f"The map that was being made cannot be read or kept aside: {error.strerror}."
    return f"The map that was being made cannot be read; it is kept as {aside.name}."


def forget(folder: Path) -> str | None:
    """Remove it: the map is saved, or was given up; returns why that failed."""
    try:
        (folder / FILE).unlink(missing_ok=True)
    except OSError as error:
        return error.strerror or str(error)
    return None
