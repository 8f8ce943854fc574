"""What an older version sent stays readable: one file of msgpack bytes per message.

`TROLLEY_RENEW_GOLDEN=1 pytest tests/golden` writes the files of messages that have none.
"""

import os
from pathlib import Path
from typing import Any, cast

import msgspec
import pytest
from msgspec import inspect
from support.strategies import message_types

from trolley.messages.arrays import ARRAY_FIELDS

FOLDER = Path(__file__).with_name("messages")
TYPES = message_types()
WORDS = {
    r"\A[a-z0-9_-]{1,32}\Z": "trolley",
    r"\A[a-z0-9-]{1,36}\Z": "goal-1",
    r"\A[a-z0-9]{1,12}\Z": "trip1",
    r"\A[a-z0-9]{1,12}-[0-9]{1,9}\Z": "trip1-3",
    r"\A([01][0-9]|2[0-3]):[0-5][0-9]\Z": "08:30",
    r"\A(?!\.)[A-Za-z0-9_.-]{1,64}\Z": "home",
}
LEFT_OUT = {"SendGoal": "name", "AskOffer": "name", "Stop": "name", "StartTour": "tour"}
"""The one of two fields that is not given where exactly one is allowed."""


PLAIN: dict[type[inspect.Type], Any] = {
    inspect.BoolType: True,
    inspect.IntType: 3,  # the grid's 9 cells are 3 x 3
    inspect.FloatType: 0.25,
    inspect.BytesType: b"glb",
    inspect.DictType: {"code": 3},
    inspect.AnyType: "mppi",
}


def example(kind: type[msgspec.Struct]) -> msgspec.Struct:
    """A message with something in every field."""
    shape = cast("inspect.StructType", inspect.type_info(kind))
    values: dict[str, Any] = {}
    for field in shape.fields:
        if LEFT_OUT.get(kind.__name__) == field.name:
            values[field.name] = None
        elif (kind, field.name) in ARRAY_FIELDS:
            values[field.name] = array_bytes(kind, field.name)
        else:
            values[field.name] = value_of(field.type)
    return kind(**values)


def array_bytes(kind: type[msgspec.Struct], field: str) -> memoryview:
    layout = ARRAY_FIELDS[kind, field]
    if layout.dtype != "<f4":
        return memoryview(bytes([1, 2, 3, 4] if layout.dtype == "|u1" else [0] * 9))
    num = 6 if layout.shape[-1] == "3" else 2
    one = b"\x00\x00\x00\x3f"  # 0.5
    return memoryview(one * num)


def value_of(shape: inspect.Type) -> Any:
    match shape:
        case inspect.StructType(cls=cls):
            return example(cls)
        case inspect.UnionType(types=types):
            return value_of(next(one for one in types if not isinstance(one, inspect.NoneType)))
        case inspect.FloatType(ge=float(least)):
            return max(PLAIN[inspect.FloatType], least)
        case inspect.StrType(pattern=pattern):
            return "Küche" if pattern is None else WORDS[pattern]
        case inspect.LiteralType(values=values):
            return values[-1]
        case inspect.ListType(item_type=item, min_length=least):
            return [value_of(item)] * max(1, least or 0)
        case inspect.TupleType(item_types=items):
            return tuple(map(value_of, items))
        case _:
            return PLAIN[type(shape)]


def is_part_of(old: Any, new: Any) -> bool:
    """Whether all of `old` stands in `new` with the same values; fields may have been added."""
    if isinstance(old, dict):
        return isinstance(new, dict) and all(
            name in new and is_part_of(value, new[name]) for name, value in old.items()
        )
    if isinstance(old, list | tuple):
        same_length = isinstance(new, list | tuple) and len(old) == len(new)
        return same_length and all(map(is_part_of, old, new))
    return bool(old == new)


@pytest.mark.parametrize("kind", TYPES, ids=lambda kind: kind.__name__)
def test_bytes_of_an_older_version_mean_the_same(kind: type[msgspec.Struct]) -> None:
    file = FOLDER / f"{kind.__name__}.msgpack"
    if os.environ.get("TROLLEY_RENEW_GOLDEN") and not file.exists():
        FOLDER.mkdir(exist_ok=True)
        file.write_bytes(msgspec.msgpack.encode(example(kind)))
    assert file.exists(), "a new message: write its file with TROLLEY_RENEW_GOLDEN=1"
    payload = file.read_bytes()
    message = msgspec.msgpack.decode(payload, type=kind)
    again = msgspec.msgpack.decode(msgspec.msgpack.encode(message))
    assert is_part_of(msgspec.msgpack.decode(payload), again)


def test_no_message_is_lost() -> None:
    known = {f"{kind.__name__}.msgpack" for kind in TYPES}
    assert {file.name for file in FOLDER.iterdir()} == known
