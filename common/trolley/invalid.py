"""What is wrong with a value, in words for people: msgspec's own are for programmers."""

import re
from typing import Any

from msgspec import inspect as shapes

from trolley.geometry.pose import LARGEST
from trolley.messages.driving import GoalId
from trolley.messages.editing import EditId
from trolley.messages.mapping import MAP_NAME_RULE, MapName
from trolley.messages.motion import RobotName
from trolley.messages.request_params import PhotoName
from trolley.messages.touring import TimeOfDay

_KINDS: dict[Any, str] = {
    MapName: MAP_NAME_RULE,
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
    "bytes": "base64",
    "bool": "true or false",
    "array": "a list",
    "object": "an object",
    "null": "nothing",
    "None": "nothing",
}
_SENTENCES = {
    "Input data was truncated": "it is cut short, or not valid JSON or msgpack",
    "Integer value out of range": "the number is too large",
    "Number out of range": "the number is too large",
}
_MOST_CHOICES = 8
"""Where more words are allowed, a message does not list them."""
_PATTERN = re.compile(r"Expected `str` matching regex '(.*)'\Z", re.DOTALL)
_BOUNDS = {">=": "at least", ">": "more than", "<=": "at most", "<": "less than"}
_ITEMS = {"str": "character", "array": "entry", "object": "key"}
_MANY = {"character": "characters", "entry": "entries", "key": "keys"}
_KIND = re.compile(r"Expected `([^`]+)`, got `([^`]+)`\Z")
_BOUND = re.compile(r"Expected `[^`]+` ([<>]=?) (\S+)\Z")
_LENGTH = re.compile(r"Expected `([^`]+)` of length (?:([<>]=?) )?(\d+)(?:, got \d+)?\Z")
_ENUM = re.compile(r"Invalid (?:enum )?value (.+)\Z", re.DOTALL)
_UNKNOWN = re.compile(r"Object contains unknown field (`.*`)\Z", re.DOTALL)
_MISSING = re.compile(r"Object missing required field (`.+`)\Z", re.DOTALL)


def in_plain_words(problem: str, kind: type) -> str:
    """What msgspec says is wrong, and with which field: `` `name`: text is needed, not a list ``.

    What has no plain words stays as it is.

    Args:
        problem: msgspec's words.
        kind: what the value was to be.
    """
    text, _, where = problem.partition(" - at `$")
    name = where.rstrip("`").lstrip(".")
    words = plain_words(text, _choices(kind, where))
    return f"`{name}`: {words}" if name else words


def in_words_of_a_file(problem: str, kind: type, table: str = "") -> str:
    """What msgspec says is wrong with a file of tables: `[planner.speed] a number is needed`.

    Args:
        problem: msgspec's words.
        kind: what was to be read.
        table: what was read of the file, such as `base.lidar.settings`; "" for all of it.
    """
    text, _, where = problem.partition(" - at `$")
    key = f"{table}{where.rstrip('`')}".lstrip(".")
    words = plain_words(text, _choices(kind, where), field="key")
    return f"[{key}] {words}" if key else words


def plain_words(text: str, choices: list[str], field: str = "field") -> str:
    """What is wrong, without where.

    Args:
        text: msgspec's words.
        choices: the words that are allowed there, if it is one of some.
        field: what one entry is called there.
    """
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
        return f"it must be {_BOUNDS[found[1]]} {found[2].replace(str(LARGEST), '1e12')}"
    if found := _LENGTH.match(text):
        kind, bound, count = found.groups()
        item = _ITEMS.get(kind, "entry")
        how_many = f"{count} {item if count == '1' else _MANY[item]}"
        return f"it must have {_BOUNDS[bound]} {how_many}" if bound else f"it must have {how_many}"
    if found := _ENUM.match(text):
        if not 0 < len(choices) <= _MOST_CHOICES:
            return f"{found[1]} is not among the values that it may have"
        *others, last = (f"`{choice}`" for choice in choices)
        allowed = f"{', '.join(others)} or {last}" if others else last
        return f"it may be {allowed}, not {found[1]}"
    if found := _UNKNOWN.match(text):
        return f"unknown {field} {found[1]}"
    if found := _MISSING.match(text):
        return f"missing {field} {found[1]}" if field == "key" else f"{found[1]} is missing"
    return _SENTENCES.get(text, text)


def _choices(kind: type, where: str) -> list[str]:
    """The words that are allowed at msgspec's path into a type, [] where there are no such."""
    found = _options([shapes.type_info(kind)])
    for step in re.findall(r"\w+|\.{3}", where):  # fields, numbers of items, `...` for any key
        inner: list[shapes.Type] = []
        for shape in found:
            match shape:
                case shapes.StructType():
                    inner += [one.type for one in shape.fields if one.encode_name == step]
                    if shape.tag_field == step:
                        inner.append(shapes.LiteralType((shape.tag,)))
                case shapes.ListType() | shapes.VarTupleType():
                    inner.append(shape.item_type)
                case shapes.DictType():
                    inner.append(shape.value_type)
                case _:
                    pass
        found = _options(inner)
    literals = (shape for shape in found if isinstance(shape, shapes.LiteralType))
    return [str(value) for literal in literals for value in literal.values]


def _options(types: list[shapes.Type]) -> list[shapes.Type]:
    """The same types, with what a union is of in place of each union."""
    return [
        option
        for one in types
        for option in (one.types if isinstance(one, shapes.UnionType) else (one,))
    ]
