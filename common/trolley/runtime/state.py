"""State that outlives a process: readable TOML files, set aside when broken."""

import os
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TypeVar, cast

import msgspec

from trolley.config.load import DEFAULT_PATH
from trolley.files import (
    READABLE_BY_ALL,
    SECRET,
    make_folder,
    read_file,
    write_atomically,
)
from trolley.runtime.log import Log
from trolley.state_file import (
    Unreadable,
    keep_original,
    keep_unreadable,
    parse_any_schema,
    reason_of,
    render,
    schema_of,
)
from trolley.topics import names_robot

S = TypeVar("S", bound=msgspec.Struct)


INSTALLED_STATE = Path("/var/lib/trolley")
"""What systemd gives the services of an installed robot."""
SAVED_FILES = ("poses.toml", "tours.toml")
"""What people save for a robot."""


def state_root(config: Path | None = None) -> Path:
    """The host's state folder: `TROLLEY_STATE`, systemd's `STATE_DIRECTORY`, else as XDG says.

    Args:
        config: for a command that looks at what services keep: the robot.toml that they run with.
            That of an installed robot stands for the folder that its services have.
    """
    for variable in ("TROLLEY_STATE", "STATE_DIRECTORY"):
        value = os.environ.get(variable, "").partition(":")[0]
        if value:
            return Path(value)
    if config == DEFAULT_PATH:
        return INSTALLED_STATE
    base = Path(os.environ.get("XDG_STATE_HOME", ""))  # XDG: one that is relative does not count
    return (base if base.is_absolute() else Path.home() / ".local" / "state") / "trolley"


def saved_for_others_only(root: Path, name: str) -> list[str]:
    """Names of the robots that have places or tours on this host; none if this one has, too.

    Args:
        root: the host's state folder.
        name: of this robot; perhaps it had another one before.
    """
    try:
        saved = {file.parent.name for file in root.glob("*/*.toml") if file.name in SAVED_FILES}
    except OSError:
        return []  # whoever reads them says so
    return [] if name in saved else sorted(filter(names_robot, saved))


class StateFolder:
    """A folder of TOML files, one struct each; the form of each is in `trolley.state_file`."""

    def __init__(self, path: Path, log: Log) -> None:
        self.path = path
        self.problems: dict[str, str] = {}
        """By file, what was the matter with it when it was read: sentences for people."""
        self._log = log
        self._unkept: dict[str, Callable[[], Path]] = {}
        """By file, what keeps its content before it is overwritten, where that failed so far."""

    def read(self, name: str, kind: type[S]) -> S | None:
        """The content of `name`, None if there is none.

        A file that cannot be used is set aside as `<name>.broken-<Unix time>`, or `newer-` where a
        newer Trolley wrote it, and reported. Of one of an older schema the original is kept as
        `<name>.schema-<n>`. Where either fails, it is tried again before the file is overwritten.
        """
        path = self.path / name
        try:
            content = read_file(path)
            found = parse_any_schema(content, kind)
        except (FileNotFoundError, NotADirectoryError):
            return None
        except (Unreadable, OSError) as error:
            self._keep_aside(name, error)
            return None
        if found.schema < schema_of(kind):
            self._keep_original(name, content, found.schema)
        return cast("S", found.value)

    def write(self, name: str, value: msgspec.Struct, *, is_secret: bool = False) -> None:
        """Write `value` whole or not at all; fields that are None are left out.

        What `is_secret` only the service's own user can read.

        It waits for the disk, so call it through `Service.work`.

        Raises:
            OSError: It cannot be written, or what stood there could not be kept; that stands.
        """
        path = self.path / name
        if name in self._unkept:
            with suppress(FileNotFoundError):  # somebody else has taken it away
                self._unkept[name]()
            del self._unkept[name]
        make_folder(path.parent)
        write_atomically(path, render(value), SECRET if is_secret else READABLE_BY_ALL)

    def _keep_aside(self, name: str, error: Exception) -> None:
        path, why = self.path / name, reason_of(error)
        keep = partial(keep_unreadable, path, error)
        try:
            aside = keep()
        except OSError as besides:
            self._unkept[name] = keep
            self.problems[name] = f"{name} can be neither read nor set aside."
            self._log.error(
                "A state file can be neither read nor set aside",
                file=path,
                why=why,
                besides=besides.strerror,
            )
        else:
            self.problems[name] = f"{name} could not be read and was set aside."
            self._log.error(
                "A state file cannot be read and was set aside", file=path, kept=aside, why=why
            )

    def _keep_original(self, name: str, content: bytes, schema: int) -> None:
        """Keep a file of an older schema beside the one that will take its place."""
        path = self.path / name
        keep = partial(keep_original, path, content, schema)
        try:
            original = keep()
        except OSError as error:
            self._unkept[name] = keep
            self._log.error(
                "The original of an older state file is not kept yet",
                file=path,
                why=error.strerror,
            )
        else:
            self._log.info("An older state file was brought forward", file=path, kept=original)
