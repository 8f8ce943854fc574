"""Changes single settings of a `robot.toml` and leaves the rest of the file as people wrote it."""

import difflib
import os
import re
import stat
import tempfile
import tomllib
from collections.abc import Mapping, MutableMapping, Sequence
from pathlib import Path
from typing import Any, cast

import tomlkit
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import InlineTable

from trolley.config import ConfigError, load_config
from trolley.config.describe import as_comment, to_toml
from trolley.files import READABLE_BY_ALL, why_not_written, write_atomically

Values = Mapping[tuple[str, ...], Any]
"""Settings by their keys from the outermost table on, such as ("base", "lidar", "port").

None takes a setting out, a `dict` is written on one line.
"""


class NotWritable(ConfigError):
    """The file is as good as before, but cannot be written where it is."""


def read_text(path: Path) -> str:
    """Read a `robot.toml` that is to be changed.

    Raises:
        ConfigError: it cannot be read, or what it says is not allowed.
    """
    load_config(path)
    return path.read_text(encoding="utf-8")


def with_values(
    text: str, values: Values, waiting: Values | None = None, tables: Sequence[str] = ()
) -> str:
    """Return the text with these settings, everything else as it was, comments included.

    A new setting takes the place of the line that explains it (`# port = ""`, as `trolley init`
    writes it), else it stands first in its table.

    Args:
        text: a file that TOML can read.
        values: the settings.
        waiting: settings to write as comments, for a person to take the # away.
        tables: whole tables with the comments above them, for the file's end or in place of the
            same lines commented out, as `trolley init` writes them; also such that stay comments.
            What the file has already is not written again.

    Raises:
        ConfigError: the file is written in a way that cannot be changed without changing more.
    """
    changed = text
    try:
        for keys, value in values.items():
            changed = _with_value(changed, keys, value)
        for keys, value in (waiting or {}).items():
            changed = _with_line(changed, keys, f"# {keys[-1]} = {to_toml(value)}") or changed
        for table in tables:
            changed = _with_table(changed, table)
        wanted = {**values, **_settings_in("\n".join(tables))}
        is_right = tomllib.loads(changed) == _expected(tomllib.loads(text), wanted)
    except (TOMLKitError, TypeError, AttributeError, ValueError) as error:
        raise ConfigError(f"these settings cannot be put into the file: {error}") from error
    if not is_right:
        raise ConfigError(
            "these settings cannot be put into the file without changing others; "
            "write them in by hand"
        )
    return changed


def check_text(path: Path, text: str) -> None:
    """Refuse a text that could not be used as this file.

    Raises:
        ConfigError: with the key and what is allowed.
        NotWritable: nothing can be written beside the file.
    """
    try:
        # Beside the file itself: names of other files count from its folder.
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".check", dir=path.parent)
    except OSError as error:
        raise NotWritable(f"{path} cannot be written: {why_not_written(path, error)}") from error
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
        load_config(Path(name))
    except ConfigError as error:
        raise ConfigError(str(error).replace(name, str(path))) from error
    finally:
        Path(name).unlink(missing_ok=True)


def replace_text(path: Path, text: str) -> None:
    """Put a checked text in the file's place, or a new file there; a link stays a link.

    Raises:
        ConfigError: the text is not allowed; the old file stands.
        NotWritable: it cannot be written; the old file stands.
    """
    file = path.resolve()
    check_text(file, text)
    try:
        mode = stat.S_IMODE(file.stat().st_mode) if file.exists() else READABLE_BY_ALL
        write_atomically(file, text.encode("utf-8"), mode)
    except OSError as error:
        raise NotWritable(f"{path}: cannot be written: {error.strerror}") from error


def difference(path: Path, old: str, new: str) -> str:
    """Return what changes, as `diff -u` shows it."""
    lines = difflib.unified_diff(
        old.splitlines(keepends=True), new.splitlines(keepends=True), str(path), f"{path} (new)"
    )
    return "".join(lines)


def _with_value(text: str, keys: tuple[str, ...], value: Any) -> str:
    """Return the text with one setting, or without it if it is None."""
    document = tomlkit.parse(text)
    if value is None and not _has(document, keys):
        return text
    table = _table(document, keys[:-1])
    if value is None:
        del table[keys[-1]]
        return tomlkit.dumps(document)
    if keys[-1] in table and table[keys[-1]] == value:
        return text
    if keys[-1] not in table:
        # tomlkit would put it behind the comments that belong to the next table.
        changed = _with_line(text, keys, f"{keys[-1]} = {to_toml(value)}")
        if changed is not None:
            return changed
    table[keys[-1]] = _on_one_line(value)
    return tomlkit.dumps(document)


def _with_table(text: str, table: str) -> str:
    """Return the text with a whole table, which may be commented out."""
    if table in text:
        return text
    commented = as_comment(table)
    changed = text.replace(commented, table, 1) if commented in text else f"{text}\n{table}"
    try:
        tomllib.loads(changed)
    except tomllib.TOMLDecodeError:  # its outer table stands there in another form
        for keys, value in _settings_in(table).items():
            text = _with_value(text, keys, value)
        return text
    return changed


def _settings_in(text: str) -> dict[tuple[str, ...], Any]:
    """Return the settings of tables by their keys."""
    found: dict[tuple[str, ...], Any] = {}

    def collect(table: Mapping[str, Any], keys: tuple[str, ...]) -> None:
        for key, value in table.items():
            if isinstance(value, dict):
                collect(cast("dict[str, Any]", value), (*keys, key))
            else:
                found[*keys, key] = value

    collect(tomllib.loads(text), ())
    return found


def _on_one_line(value: Any) -> Any:
    """Return a value so that a table is written on one line."""
    if not isinstance(value, dict):
        return value
    table = tomlkit.inline_table()
    for key, one in cast("dict[str, Any]", value).items():
        table[key] = one
    return table


def _with_line(text: str, keys: tuple[str, ...], line: str) -> str | None:
    """Put a line into its table; None where the table has no header of its own."""
    lines = text.split("\n")
    header = re.compile(r"\s*\[\s*" + r"\s*\.\s*".join(keys[:-1]) + r"\s*\]\s*(#.*)?")
    start = next((i for i, one in enumerate(lines) if header.fullmatch(one)), None)
    if start is None:
        return None
    ends = (i for i in range(start + 1, len(lines)) if lines[i].lstrip().startswith("["))
    explained = re.compile(rf"#\s*{keys[-1]}\s*=.*")
    end = next(ends, len(lines))
    place = next((i for i in range(start + 1, end) if explained.fullmatch(lines[i])), None)
    if place is None:
        lines.insert(start + 1, line)
    else:
        lines[place] = line
    return "\n".join(lines)


def _table(document: MutableMapping[str, Any], keys: tuple[str, ...]) -> MutableMapping[str, Any]:
    """Return a table of the document, made where it is not there."""
    table = document
    for key in keys:
        if key not in table:
            is_inline = isinstance(table, InlineTable)
            table[key] = tomlkit.inline_table() if is_inline else tomlkit.table()
        table = cast("MutableMapping[str, Any]", table[key])
    return table


def _expected(plain: dict[str, Any], values: Values) -> dict[str, Any]:
    """Set the same values in the plain content of the file."""
    for keys, value in values.items():
        if value is not None:
            _plain_table(plain, keys[:-1])[keys[-1]] = value
        elif _has(plain, keys):
            _plain_table(plain, keys[:-1]).pop(keys[-1])
    return plain


def _has(plain: Any, keys: tuple[str, ...]) -> bool:
    """Whether a setting stands there."""
    for key in keys:
        if not isinstance(plain, dict) or key not in plain:
            return False
        plain = cast("dict[str, Any]", plain)[key]
    return True


def _plain_table(plain: dict[str, Any], keys: tuple[str, ...]) -> dict[str, Any]:
    for key in keys:
        plain = plain.setdefault(key, {})
    return plain
