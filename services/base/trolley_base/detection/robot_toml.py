"""Changes single settings of a `robot.toml` and leaves the rest of the file as people wrote it."""

import difflib
import os
import tempfile
import tomllib
from collections.abc import Mapping, MutableMapping
from pathlib import Path
from typing import Any, cast

import tomlkit
from tomlkit.exceptions import TOMLKitError

from trolley.config import ConfigError, load_config
from trolley.files import write_atomically

Values = Mapping[tuple[str, ...], str | int | float]
"""Settings by their keys from the outermost table on, such as ("base", "lidar", "port")."""


def read_text(path: Path) -> str:
    """Read a `robot.toml` that is to be changed.

    Raises:
        ConfigError: it cannot be read, or what it says is not allowed.
    """
    load_config(path)
    return path.read_text(encoding="utf-8")


def with_values(text: str, values: Values, remarks: Mapping[tuple[str, ...], str]) -> str:
    """Return the text with these settings, everything else as it was, comments included.

    Args:
        text: a file that TOML can read.
        values: the settings.
        remarks: comments to put at the end of tables, by the table's keys; several lines each. One
            that the file has already is not repeated.

    Raises:
        ConfigError: the file is written in a way that cannot be changed without changing more.
    """
    try:
        document = tomlkit.parse(text)
        for keys, value in values.items():
            table = _table(document, keys[:-1])
            if keys[-1] not in table or table[keys[-1]] != value:
                table[keys[-1]] = value
        for keys, remark in remarks.items():
            if remark.splitlines()[0] not in text:
                _remark(_table(document, keys), remark)
        changed = tomlkit.dumps(document)  # pyright: ignore[reportUnknownMemberType]
    except (TOMLKitError, TypeError, AttributeError) as error:
        raise ConfigError(f"these settings cannot be put into the file: {error}") from error
    if tomllib.loads(changed) != _expected(tomllib.loads(text), values):
        raise ConfigError(
            "these settings cannot be put into the file without changing others; "
            "write them in by hand"
        )
    return changed


def check_text(path: Path, text: str) -> None:
    """Refuse a text that could not be used as this file.

    Raises:
        ConfigError: with the key and what is allowed.
    """
    try:
        # Beside the file itself: names of other files count from its folder.
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".check", dir=path.parent)
    except OSError as error:
        raise ConfigError(f"{path.parent} cannot be written to: {error.strerror}") from error
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
        load_config(Path(name))
    except ConfigError as error:
        raise ConfigError(str(error).replace(name, str(path))) from error
    finally:
        Path(name).unlink(missing_ok=True)


def replace_text(path: Path, text: str) -> None:
    """Put a checked text in the file's place; a link stays a link.

    Raises:
        ConfigError: the text is not allowed, or cannot be written; then the old file stands.
    """
    file = path.resolve()
    check_text(file, text)
    try:
        write_atomically(file, text.encode("utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}") from error


def difference(path: Path, old: str, new: str) -> str:
    """Return what changes, as `diff -u` shows it."""
    lines = difflib.unified_diff(
        old.splitlines(keepends=True), new.splitlines(keepends=True), str(path), f"{path} (new)"
    )
    return "".join(lines)


def _table(document: MutableMapping[str, Any], keys: tuple[str, ...]) -> MutableMapping[str, Any]:
    """Return a table of the document, made where it is not there."""
    table = document
    for key in keys:
        if key not in table:
            table[key] = tomlkit.table()
        table = cast("MutableMapping[str, Any]", table[key])
    return table


def _remark(table: MutableMapping[str, Any], remark: str) -> None:
    for line in remark.splitlines():
        cast("Any", table).add(tomlkit.comment(line))


def _expected(plain: dict[str, Any], values: Values) -> dict[str, Any]:
    """Set the same values in the plain content of the file."""
    for keys, value in values.items():
        _plain_table(plain, keys[:-1])[keys[-1]] = value
    return plain


def _plain_table(plain: dict[str, Any], keys: tuple[str, ...]) -> dict[str, Any]:
    for key in keys:
        plain = plain.setdefault(key, {})
    return plain
