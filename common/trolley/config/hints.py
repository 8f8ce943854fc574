"""What somebody may have meant by a key that `robot.toml` does not have."""

import re
from collections.abc import Iterator
from typing import cast

from msgspec import Struct
from msgspec import inspect as shapes

from trolley.config.robot import FOOTPRINTS
from trolley.invalid import in_words_of_a_file
from trolley.suggestions import did_you_mean

UNKNOWN_KEY = re.compile(r"Object contains unknown field `(.*?)`(?: - at `\$\.(.*)`)?\Z", re.DOTALL)
"""What msgspec says of an unknown key: the key, and the table where it stands, if any."""


AT_LINE = re.compile(r"\(at line (\d+), column \d+\)\Z")
CURLY_QUOTES = set("\u2018\u2019\u201a\u201c\u201d\u201e\u00ab\u00bb")
"""As web pages and word processors put them in place of straight ones."""
DECIMAL_COMMA = re.compile(r"=\s*[-+]?\d+,\d")
"""Right after the `=`: in an array it is the comma between two values."""


def in_words_of_robot_toml(problem: str, file: type[Struct]) -> str:
    """What msgspec says is wrong with a `robot.toml`; of an unknown key also what may be meant.

    Args:
        problem: msgspec's words.
        file: all that may stand in it.
    """
    words, unknown = in_words_of_a_file(problem, file), UNKNOWN_KEY.match(problem)
    if words.startswith("[robot.footprint] an object"):
        return words.replace("an object is needed", f"give {FOOTPRINTS}")
    if unknown is None:
        return words
    key, table, tables = unknown[1], unknown[2] or "", dict(_tables(file))
    places = [
        f"[{name}.{key}]" if f"{name}.{key}" in tables else f"[{name}]"
        for name, keys in tables.items()
        if name and key in keys
    ]
    if places:
        last = f" or {places.pop()}" if len(places) > 1 else ""
        return f"{words}; it belongs in {', '.join(places)}{last}"
    return f"{words}. {did_you_mean(key, tables[table])}" if table in tables else words


def typed_hint(text: str, error: ValueError) -> str:
    """What to write in place of a value that TOML does not know, if that can be seen; else "".

    Args:
        text: the file.
        error: Python's words, which end with the line.
    """
    place = AT_LINE.search(str(error))
    line = text.split("\n")[int(place[1]) - 1] if place else ""
    if CURLY_QUOTES & set(line):
        return '; text stands in straight quotes: "text"'
    if DECIMAL_COMMA.search(line):
        return "; decimals have a point: 0.5"
    return ""


def _tables(struct: type[Struct], name: str = "") -> Iterator[tuple[str, list[str]]]:
    """All tables of a file by their names, "" for the file itself, with their keys."""
    fields = cast("shapes.StructType", shapes.type_info(struct)).fields
    below: dict[str, type[Struct]] = {}
    for field in fields:
        is_union = isinstance(field.type, shapes.UnionType)
        for one in cast("shapes.UnionType", field.type).types if is_union else (field.type,):
            if isinstance(one, shapes.StructType):
                below[field.name] = one.cls
    yield name, [field.name for field in fields if name or field.name in below]
    for key, table in below.items():
        yield from _tables(table, f"{name}.{key}".lstrip("."))
