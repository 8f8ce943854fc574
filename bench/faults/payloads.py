"""Every key and request of the tables, with a valid payload and all kinds of broken ones for it."""

import random
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, cast

import msgspec
from msgspec import inspect

from trolley import requests, topics
from trolley.messages.arrays import ARRAY_FIELDS
from trolley.runtime import codec
from trolley.topics import Kind

HUGE_BYTES = 100_000_000
DEEP = 100_000
MANY = 2000
WRONG_VALUES = (float("nan"), float("inf"), -(10**18), [[]], {"x": {}}, "\0" * 70, True, b"1")
# What the varying chunks of keys are called here.
PARTS = {
    "child": "odom",
    "source": "planner",
    "name": "kitchen",
    "ns": "lamps",
    "id": "one",
    "service": "base",
    "run": "host-1-1",
}
# Structs that want one of two fields, or whose fields depend on each other.
SPECIAL: dict[str, dict[str, Any]] = {
    "OccupancyGrid": {"cells": b"\0"},
    "SendGoal": {"name": "kitchen"},
    "AskOffer": {"name": "kitchen"},
    "Stop": {"name": "kitchen"},
    "StartTour": {"name": "evening"},
    "WhichPhoto": {"name": "evening-1"},
    "CameraImage": {"jpeg": b""},
}


@dataclass(frozen=True)
class Target:
    """A key to which anybody on the network may send something."""

    key: str
    kind: type[msgspec.Struct]
    is_request: bool
    is_stored: bool = False
    always: bool = False
    """A request that is obeyed whatever it holds."""

    def accepts(self, payload: bytes, encoding: str = "") -> bool:
        """Whether this is a valid message."""
        try:
            if self.is_request:
                codec.decode_strict(self.kind, payload, encoding)
            else:
                codec.decode(self.kind, payload, encoding)
        except codec.BadPayload:
            return False
        return True


def targets(robot: str) -> list[Target]:
    """All of them but what `trolley setup` answers, which runs only where no service does."""
    found: list[Target] = []
    for topic in topics.TOPICS:
        if topic.kind is Kind.TOKEN:
            continue  # a sign of life carries nothing
        parts = [PARTS[chunk.strip("{}")] for chunk in topic.chunks if chunk.startswith("{")]
        is_stored = topic.kind is Kind.STORED
        found.append(Target(topic.key(robot, *parts), topic.message, False, is_stored))
    for request in requests.REQUESTS:
        if request.owner == "setup":
            continue
        key = request.key(robot)
        found.append(Target(key, request.params, True, always=request.always))
    return found


def valid(kind: type[msgspec.Struct]) -> bytes:
    """The smallest valid message, as msgpack."""
    return msgspec.msgpack.encode(_value(inspect.type_info(kind)))


def _value(shape: inspect.Type) -> Any:
    match shape:
        case inspect.StructType():
            return _struct(shape)
        case inspect.UnionType():
            is_optional = any(isinstance(one, inspect.NoneType) for one in shape.types)
            return None if is_optional else _value(shape.types[0])
        case inspect.IntType():
            return max(int(shape.ge or 0), 0)
        case inspect.FloatType():
            return max(float(shape.ge or 0.0), 0.1)
        case inspect.StrType():
            return "08:30" if shape.pattern and "[0-5]" in shape.pattern else "kitchen"
        case inspect.LiteralType():
            return shape.values[0]
        case inspect.ListType():
            return [_value(shape.item_type) for _ in range(shape.min_length or 0)]
        case inspect.TupleType():
            return [_value(one) for one in shape.item_types]
        case inspect.BoolType():
            return False
        case _:
            return {} if isinstance(shape, inspect.DictType) else None


def _struct(shape: inspect.StructType) -> dict[str, Any]:
    made = {
        field.encode_name: b"" if (shape.cls, field.name) in ARRAY_FIELDS else _value(field.type)
        for field in shape.fields
        if field.required
    }
    tag = {} if shape.tag_field is None else {shape.tag_field: shape.tag}
    return tag | made | SPECIAL.get(shape.cls.__name__, {})


def broken(target: Target, seed: int = 1) -> Iterator[tuple[str, bytes]]:
    """Payloads that no reader may take, each with what is wrong with it."""
    for what, payload in _all_broken(target, random.Random(f"{seed}/{target.key}")):
        if not target.accepts(payload):
            yield what, payload


def _all_broken(target: Target, rng: random.Random) -> Iterator[tuple[str, bytes]]:
    good = valid(target.kind)
    yield "nothing", b""
    yield "random bytes", rng.randbytes(300)
    yield "a byte that msgpack never uses", b"\xc1"
    yield "deep lists in JSON", b"[" * DEEP
    yield "deep maps in JSON", b'{"a":' * DEEP
    yield "deep lists in msgpack", b"\x91" * DEEP
    yield "a list", b"[1, 2, 3]"
    yield "half of it", good[: len(good) // 2]
    yield "no UTF-8", b"\xa4\xff\xfe\xfd\xfc"
    fields = cast("dict[str, Any]", msgspec.msgpack.decode(good))
    names = [field.encode_name for field in msgspec.structs.fields(target.kind)]
    for name in names:
        for wrong in (
            float("nan"),
            float("inf"),
            -(10**18),
            [[]],
            {"x": {}},
            "\0" * 70,
            True,
            b"1",
        ):
            payload = msgspec.msgpack.encode({**fields, name: wrong})
            yield f"{name} is {wrong!r:.20}", payload
    for name in fields:
        rest = {key: value for key, value in fields.items() if key != name}
        yield f"{name} is missing", msgspec.msgpack.encode(rest)
    strange = {f"no such field {i}": i for i in range(MANY)}
    yield "thousands of unknown fields", msgspec.msgpack.encode({**fields, **strange})
