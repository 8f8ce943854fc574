"""All that is wrong with a `robot.toml`, not the first thing only."""

from pathlib import Path
from typing import Any, cast

import msgspec

from trolley.config.hints import UNKNOWN_KEY, in_words_of_robot_toml
from trolley.config.load import (
    SET_ON_LOADING,
    ConfigError,
    HostConfig,
    read_toml,
)

MOST = 30


def find_problems(path: Path) -> list[str]:
    """Every problem of a host's file with key and what is allowed, [] where it can be used.

    A value that is refused is taken out, and the rest is looked at again.
    """
    try:
        plain = read_toml(path)
    except ConfigError as error:
        return [str(error)]
    found = [f"unknown key `{key}`" for key in SET_ON_LOADING if plain.pop(key, None) is not None]
    for name in plain:
        found += _problems_of(name, plain)
    return [f"{path}: {text}" for text in found[:MOST]]


def _problems_of(section: str, plain: dict[str, Any]) -> list[str]:
    """What is wrong with one table of the file."""
    tables: dict[str, Any] = {"robot": None, section: plain[section]}
    found: list[str] = []
    taken_out: set[tuple[str, ...]] = set()
    while len(found) < MOST:
        try:
            msgspec.convert(tables, type=HostConfig)
        except msgspec.ValidationError as error:
            text, _, where = str(error).partition(" - at `$")
            keys = [key.partition("[")[0] for key in where.rstrip("`").split(".") if key]
            unknown = UNKNOWN_KEY.match(text)
            gone = [*keys, unknown[1]] if unknown else keys
            # A table that lacks what was taken out of it for being wrong has not one fault more.
            is_result = any(one[: len(keys)] == tuple(keys) for one in taken_out)
            if unknown or not is_result or not _is_table(tables, keys):
                found.append(in_words_of_robot_toml(str(error), HostConfig))
            if not _take_out(tables, gone):
                return found
            taken_out.add(tuple(gone))
        else:
            return found
    return found


def _is_table(tables: dict[str, Any], keys: list[str]) -> bool:
    """Whether a table stands there, not a value."""
    found: Any = tables
    for key in keys:
        found = cast("dict[str, Any]", found).get(key) if isinstance(found, dict) else None
    return isinstance(found, dict)


def _take_out(tables: dict[str, Any], keys: list[str]) -> bool:
    """Take a value out of nested tables; False where it is not a value of one."""
    table: Any = tables
    for key in keys[:-1]:
        if not isinstance(table, dict) or key not in table:
            return False
        # On the way down each table is copied: what was read stays as it was.
        entries = cast("dict[str, Any]", table)
        inner: Any = entries[key]
        entries[key] = dict(cast("dict[str, Any]", inner)) if isinstance(inner, dict) else inner
        table = entries[key]
    if not isinstance(table, dict) or not keys or keys[-1] not in table:
        return False
    del table[keys[-1]]
    return True
