"""State that outlives a process: readable TOML files, set aside when broken."""

import os
import tomllib
from pathlib import Path
from typing import Any, TypeVar, cast

import msgspec
import tomli_w

from trolley.config.load import DEFAULT_PATH
from trolley.files import READABLE_BY_ALL, SECRET, keep_aside, make_folder, write_atomically
from trolley.runtime.log import Log

T = TypeVar("T")


INSTALLED_STATE = Path("/var/lib/trolley")
"""What systemd gives the services of an installed robot."""


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
    base = os.environ.get("XDG_STATE_HOME")
    return (Path(base) if base else Path.home() / ".local" / "state") / "trolley"


class StateFolder:
    """A folder of TOML files, one struct each."""

    def __init__(self, path: Path, log: Log) -> None:
        self.path = path
        self._log = log

    def read(self, name: str, kind: type[T]) -> T | None:
        """The content of `name`, None if there is none.

        A file that cannot be read is kept aside as `<name>.broken-<Unix time>` and reported. Where
        that fails, the folder cannot be written, so nothing will overwrite it either.
        """
        path = self.path / name
        try:
            return msgspec.convert(tomllib.loads(path.read_bytes().decode()), type=kind)
        except (FileNotFoundError, NotADirectoryError):
            return None
        except (ValueError, msgspec.ValidationError, RecursionError, OSError) as error:
            self._keep_aside(path, str(error))
            return None

    def write(self, name: str, value: msgspec.Struct, *, is_secret: bool = False) -> None:
        """Write `value` whole or not at all; fields that are None are left out.

        What `is_secret` only the service's own user can read.

        It waits for the disk, so call it through `Service.work`.

        Raises:
            OSError: It cannot be written; what stood there stands.
        """
        plain = _without_none(msgspec.to_builtins(value))
        path = self.path / name
        make_folder(path.parent)
        mode = SECRET if is_secret else READABLE_BY_ALL
        write_atomically(path, tomli_w.dumps(plain).encode(), mode)

    def _keep_aside(self, path: Path, why: str) -> None:
        try:
            aside = keep_aside(path)
        except OSError as error:
            self._log.error(
                "A state file can neither be read nor kept aside",
                file=path,
                why=why,
                besides=error.strerror,
            )
        else:
            self._log.error(
                "A state file cannot be read and was kept aside", file=path, kept=aside, why=why
            )


def _without_none(item: Any) -> Any:
    """TOML has no null: drop such entries at any depth."""
    if isinstance(item, dict):
        entries = cast("dict[str, Any]", item)
        return {name: _without_none(value) for name, value in entries.items() if value is not None}
    if isinstance(item, list | tuple):
        return [_without_none(value) for value in cast("list[Any]", item)]
    return item
