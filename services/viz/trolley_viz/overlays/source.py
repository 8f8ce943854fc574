"""Where an overlay's value comes from: `<topic>:<field>` or `tf:<parent>/<child>:<what>`.

A field is a path into the topic's message, such as `twist.vx`, `ranges[12]` or `counters.dropped`.
"""

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal, cast

import msgspec
import numpy as np
from msgspec import inspect

from trolley import topics
from trolley.messages.arrays import ARRAY_FIELDS
from trolley.topics import Kind, Topic

MAX_LENGTH = 300
MAX_LISTED = 14
"""How many fields a sentence names."""
MAX_DEPTH = 5

Key = str | int
Value = float | str | None
"""A number, a word such as a state, or nothing known."""

_STEP = re.compile(r"\.?([^.\[\]\s]+)|\[(\d{1,9})\]")


class BadSource(ValueError):
    """There is no such value; the text says so in one sentence and names what there is."""


@dataclass(frozen=True)
class FieldSource:
    """A field of a topic's messages."""

    topic: Topic[Any]
    parts: tuple[str, ...]
    path: tuple[Key, ...]

    @property
    def is_periodic(self) -> bool:
        """Whether a silence of some seconds means that nobody publishes it any more."""
        rate = self.topic.rate
        return "on change" not in rate and "at most" not in rate


@dataclass(frozen=True)
class FrameSource:
    """Distance [m] or bearing [rad] of one frame as seen from another."""

    parent: str
    child: str
    what: Literal["distance", "bearing"]


Source = FieldSource | FrameSource


def parse_source(text: str) -> Source:
    """Read a source.

    Raises:
        BadSource: It names no topic, field or pair of frames.
    """
    text = text.strip()
    if len(text) > MAX_LENGTH:
        raise BadSource(f"A source has at most {MAX_LENGTH} characters.")
    if text.startswith("tf:"):
        return _parse_frames(text)
    name, colon, field = text.partition(":")
    topic, parts = _find_topic(name)
    if not colon or not field:
        raise BadSource(f"Which field of {name}? {_listed(topic)}")
    path = _parse_path(name, field)
    _check_path(name, topic, path)
    return FieldSource(topic, parts, path)


def read_field(source: FieldSource, message: msgspec.Struct) -> Value:
    """Read the value out of a message; None where it is unknown or no finite number.

    Raises:
        BadSource: This message does not hold it: the index is past the end, the key is missing.
    """
    here: Any = message
    for i, key in enumerate(source.path):
        if here is None:
            return None
        here = _step(here, key, _written(source.path[:i]))
    if here is None or isinstance(here, str):
        return here
    if isinstance(here, bool | int | float | np.number):
        number = float(cast("float", here))
        return number if math.isfinite(number) else None
    raise BadSource(f"{_written(source.path)} is not a single number or word.")


def fields_of(topic: Topic[Any]) -> list[str]:
    """The numeric fields of a topic's messages; `[0]` stands for any index."""
    return list(_leaves(inspect.type_info(topic.message), "", MAX_DEPTH, numbers_only=True))


def _parse_frames(text: str) -> FrameSource:
    frames, _, what = text.removeprefix("tf:").rpartition(":")
    parent, _, child = frames.strip("/").partition("/")
    child = child.strip("/")
    if not parent or not child or what not in ("distance", "bearing"):
        raise BadSource(
            "Two frames are written tf:parent/child:distance or tf:parent/child:bearing."
        )
    return FrameSource(parent, child, what)


def _find_topic(name: str) -> tuple[Topic[Any], tuple[str, ...]]:
    found = topics.find("/".join((topics.ROOT, "-", name.strip("/"))))
    if found is None or found[0].kind is not Kind.STREAM or set(name) & set("*$?#"):
        known = ", ".join(one.name for one in topics.TOPICS if one.kind is Kind.STREAM)
        raise BadSource(f"There is no topic “{name}”; there are {known}.")
    return found[0], found[2]


def _parse_path(name: str, field: str) -> tuple[Key, ...]:
    path: list[Key] = []
    at = 0
    while at < len(field):
        step = _STEP.match(field, at)
        if step is None or (at == 0 and field[0] in ".["):
            raise BadSource(
                f"“{field}” is not a field of {name}; write it like pose.x or ranges[3]."
            )
        path.append(step[1] if step[1] is not None else int(step[2]))
        at = step.end()
    return tuple(path)


def _check_path(name: str, topic: Topic[Any], path: tuple[Key, ...]) -> None:
    """Follow the path through the types, so that a wrong one is reported at once."""
    here: inspect.Type | int | None = inspect.type_info(topic.message)
    for key in path:
        here = _step_type(here, key)
        if here is None:
            raise BadSource(f"{name} has no field “{_written(path)}”. {_listed(topic)}")
    if not _is_leaf(here, numbers_only=False):
        raise BadSource(f"{name}:{_written(path)} is not a single value. {_listed(topic)}")


def _step_type(here: inspect.Type | int | None, key: Key) -> inspect.Type | int | None:
    """The type one step further, None where there is none; a number: dimensions of an array."""
    if isinstance(here, int):
        return here - 1 if isinstance(key, int) and here > 0 else None
    match _known(here):
        case inspect.StructType() as struct if isinstance(key, str):
            return next((t for name, t in _fields(struct) if name == key), None)
        case inspect.DictType() as table if isinstance(key, str):
            return table.value_type
        case inspect.ListType() as items if isinstance(key, int):
            return items.item_type
        case inspect.TupleType() as items if isinstance(key, int):
            return items.item_types[key] if key < len(items.item_types) else None
        case _:
            return None


def _leaves(
    here: inspect.Type | int | None, path: str, depth: int, *, numbers_only: bool
) -> Iterator[str]:
    if depth < 0:
        return
    if _is_leaf(here, numbers_only=numbers_only):
        if not path.endswith("stamp_ns"):
            yield path
        return
    steps: list[tuple[str, inspect.Type | int | None]] = []
    match here if isinstance(here, int) else _known(here):
        case int() as dimensions:
            steps = [("[0]", dimensions - 1)]
        case inspect.StructType() as struct:
            steps = [(f".{name}" if path else name, kind) for name, kind in _fields(struct)]
        case inspect.DictType() as table:
            steps = [(".NAME", table.value_type)]
        case inspect.ListType() as items:
            steps = [("[0]", items.item_type)]
        case inspect.TupleType() as items:
            steps = [(f"[{i}]", kind) for i, kind in enumerate(items.item_types)]
        case _:
            return
    for step, kind in steps:
        yield from _leaves(kind, path + step, depth - 1, numbers_only=numbers_only)


def _fields(struct: inspect.StructType) -> Iterator[tuple[str, inspect.Type | int]]:
    for field in struct.fields:
        layout = ARRAY_FIELDS.get((struct.cls, field.name))
        yield field.name, field.type if layout is None else len(layout.shape)


def _known(here: inspect.Type | int | None) -> inspect.Type | int | None:
    """A type without its `None`."""
    if isinstance(here, inspect.UnionType):
        kinds = [one for one in here.types if not isinstance(one, inspect.NoneType)]
        return kinds[0] if kinds else None
    return here


def _is_leaf(here: inspect.Type | int | None, *, numbers_only: bool) -> bool:
    if isinstance(here, int):
        return here == 0
    kind = _known(here)
    if isinstance(kind, inspect.IntType | inspect.FloatType | inspect.BoolType):
        return True
    return not numbers_only and isinstance(kind, inspect.StrType | inspect.LiteralType)


def _listed(topic: Topic[Any]) -> str:
    kind = inspect.type_info(topic.message)
    names = list(_leaves(kind, "", MAX_DEPTH, numbers_only=False))
    if not names:
        return "It has none that can be shown."
    more = " …" if len(names) > MAX_LISTED else "."
    return f"It has {', '.join(names[:MAX_LISTED])}{more}"


def _step(here: Any, key: Key, path: str) -> Any:
    """One step into a message."""
    if isinstance(here, msgspec.Struct):
        layout = ARRAY_FIELDS.get((type(here), str(key)))
        value = getattr(here, str(key))
        return value if layout is None or value is None else layout.read(value, here)
    if isinstance(here, dict):
        table = cast("dict[str, Any]", here)
        if str(key) not in table:
            raise BadSource(f"{path} has no “{key}” now; it has {_some(list(table))}.")
        return table[str(key)]
    items = cast("list[Any]", here)
    if not isinstance(key, int) or key >= len(items):
        raise BadSource(f"{path} has {len(items)} entries, so there is no [{key}].")
    return items[key]


def _some(names: list[str]) -> str:
    shown = ", ".join(sorted(names)[:MAX_LISTED])
    return f"{shown} …" if len(names) > MAX_LISTED else shown or "nothing"


def _written(path: tuple[Key, ...]) -> str:
    return "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in path).lstrip(".")
