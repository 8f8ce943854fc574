"""What is wrong with a value, in words for people: msgspec's own are for programmers."""

import re
from typing import Any

from trolley.messages.driving import GoalId
from trolley.messages.editing import EditId
from trolley.messages.mapping import MapName
from trolley.messages.motion import RobotName
from trolley.messages.request_params import PhotoName
from trolley.messages.touring import TimeOfDay

_KINDS: dict[Any, str] = {
    MapName: "a map's name has 1 to 64 of A-Z, a-z, 0-9, _, - and ., and no dot first",
    RobotName: "a robot's name has 1 to 32 of a-z, 0-9, _ and -",
    GoalId: "an id has 1 to 36 of a-z, 0-9 and -",
    EditId: "an id has 1 to 36 of a-z, 0-9 and -",
    PhotoName: "a photo is called as `trolley tour history --stops` says, such as k3v9x0a7c2mq-0",
    TimeOfDay: "a time of day is written as 07:30",
}
_PATTERNS = {kind.__metadata__[0].pattern: words for kind, words in _KINDS.items()}
_TYPES = {
    "int": "a whole number",
    "float": "a number",
    "str": "text",
    "bool": "true or false",
    "array": "a list",
    "object": "an object",
    "null": "nothing",
}
_PATTERN = re.compile(r"Expected `str` matching regex '(.*)'\Z", re.DOTALL)
_BOUNDS = {">=": "at least", ">": "more than", "<=": "at most", "<": "less than"}
_ITEMS = {"str": "character", "array": "entry", "object": "key"}
_MANY = {"character": "characters", "entry": "entries", "key": "keys"}
_KIND = re.compile(r"Expected `([^`]+)`, got `([^`]+)`\Z")
_BOUND = re.compile(r"Expected `[^`]+` ([<>]=?) (\S+)\Z")
_LENGTH = re.compile(r"Expected `([^`]+)` of length (?:([<>]=?) )?(\d+)(?:, got \d+)?\Z")
_ENUM = re.compile(r"Invalid enum value (.+)\Z", re.DOTALL)
_UNKNOWN = re.compile(r"Object contains unknown field (`.*`)\Z", re.DOTALL)
_MISSING = re.compile(r"Object missing required field (`.+`)\Z", re.DOTALL)


def in_plain_words(problem: str) -> str:
    """What msgspec says is wrong, and with which field: `` `name`: text is needed, not a list ``.

    What has no plain words stays as it is.
    """
    text, _, where = problem.partition(" - at `$")
    name = where.rstrip("`").lstrip(".")
    words = plain_words(text)
    return f"`{name}`: {words}" if name else words


def in_words_of_a_file(problem: str, table: str = "") -> str:
    """What msgspec says is wrong with a file of tables: `[planner.speed] a number is needed`.

    Args:
        problem: msgspec's words.
        table: what was read of the file, such as `base.lidar.settings`; "" for all of it.
    """
    text, _, where = problem.partition(" - at `$")
    key = f"{table}{where.rstrip('`')}".lstrip(".")
    words = plain_words(text, field="key")
    return f"[{key}] {words}" if key else words


def plain_words(text: str, field: str = "field") -> str:
    """What is wrong, without where; `field` is what one entry is called there."""
    if found := _PATTERN.match(text):
        pattern = found[1].replace(r"\\", "\\")
        return _PATTERNS.get(pattern, f"it must match {pattern}")
    if found := _KIND.match(text):
        needed, got = (
            " or ".join(_TYPES.get(one.strip(), one.strip()) for one in group.split("|"))
            for group in found.groups()
        )
        return f"{needed} is needed, not {got}"
    if found := _BOUND.match(text):
        return f"it must be {_BOUNDS[found[1]]} {found[2]}"
    if found := _LENGTH.match(text):
        kind, bound, count = found.groups()
        item = _ITEMS.get(kind, "entry")
        how_many = f"{count} {item if count == '1' else _MANY[item]}"
        return f"it must have {_BOUNDS[bound]} {how_many}" if bound else f"it must have {how_many}"
    if found := _ENUM.match(text):
        return f"{found[1]} is not among the values that it may have"
    if found := _UNKNOWN.match(text):
        return f"unknown {field} {found[1]}"
    if found := _MISSING.match(text):
        return f"missing {field} {found[1]}" if field == "key" else f"{found[1]} is missing"
    return text
