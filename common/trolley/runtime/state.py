"""Files that outlive a process: readable TOML, written whole or not at all, kept aside when broken."""

import os
import tempfile
import time
import tomllib
from pathlib import Path
from typing import TypeVar

import msgspec
import tomli_w

from trolley.runtime.log import Log

T = TypeVar("T")


def state_root() -> Path:
    """The host's state folder: `TROLLEY_STATE`, systemd's `STATE_DIRECTORY`, else the XDG state folder."""
    for variable in ("TROLLEY_STATE", "STATE_DIRECTORY"):
        value = os.environ.get(variable, "").partition(":")[0]
        if value:
            return Path(value)
    base = os.environ.get("XDG_STATE_HOME")
    return (Path(base) if base else Path.home() / ".local" / "state") / "trolley"


def write_atomically(path: Path, content: bytes) -> None:
    """Write a file so that after a crash either the old or the new content stands there, never a part.

    Raises:
        OSError: It cannot be written; the old content stands.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except OSError:
        Path(temporary).unlink(missing_ok=True)
        raise
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


class StateFolder:
    """A folder of TOML files, one struct each."""

    def __init__(self, path: Path, log: Log) -> None:
        self.path = path
        self._log = log

    def read(self, name: str, kind: type[T]) -> T | None:
        """The content of `name`, None if there is none.

        A file that cannot be read is kept aside as `<name>.broken-<Unix time>` and reported.
        """
        path = self.path / name
        try:
            content = path.read_bytes()
        except FileNotFoundError:
            return None
        except OSError as error:
            self._log.error("A state file cannot be read", file=path, why=error.strerror)
            return None
        try:
            return msgspec.convert(tomllib.loads(content.decode()), type=kind)
        except (
            tomllib.TOMLDecodeError,
            msgspec.ValidationError,
            UnicodeDecodeError,
            RecursionError,
        ) as error:
            aside = path.with_name(f"{path.name}.broken-{int(time.time())}")
            path.rename(aside)
            self._log.error(
                "A state file is broken and was kept aside", file=path, kept=aside, why=str(error)
            )
            return None

    def write(self, name: str, value: msgspec.Struct) -> None:
        """Write `value` atomically (call it through `Service.work`); unset (None) fields are left out.

        Raises:
            OSError: It cannot be written; what stood there stands.
        """
        plain = _without_none(msgspec.to_builtins(value))
        write_atomically(self.path / name, tomli_w.dumps(plain).encode())


def _without_none(value: object) -> dict[str, object]:
    """TOML has no null: drop such entries at any depth."""

    def clean(item: object) -> object:
        if isinstance(item, dict):
            return {str(k): clean(v) for k, v in item.items() if v is not None}  # pyright: ignore[reportUnknownVariableType, reportUnknownArgumentType]
        if isinstance(item, list | tuple):
            return [clean(v) for v in item]  # pyright: ignore[reportUnknownVariableType]
        return item

    cleaned = clean(value)
    assert isinstance(cleaned, dict)
    return cleaned  # pyright: ignore[reportUnknownVariableType]
