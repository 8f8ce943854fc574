"""Hypothesis strategies for every message of the wire, built from what msgspec knows of it."""

import functools
import sys
from collections.abc import Callable
from typing import Any, cast

import msgspec
from hypothesis import strategies as st
from msgspec import inspect

from trolley import messages, requests, topics
from trolley.geometry import Pose2D
from trolley.messages import request_params
from trolley.messages.arrays import ARRAY_FIELDS
from trolley.messages.mapping import MAX_COORDINATE_M

MAX_ITEMS = 3
INT64 = 2**63 - 1


def message_types() -> list[type[msgspec.Struct]]:
    """Every struct that travels by itself: messages, parameters and replies of requests."""
    found: set[type[msgspec.Struct]] = {topic.message for topic in topics.TOPICS}
    found |= {request.params for request in requests.REQUESTS}
    found |= {request.reply for request in requests.REQUESTS if issubclass_of_struct(request.reply)}
    for module in (messages, request_params):
        found |= {value for value in vars(module).values() if issubclass_of_struct(value)}
    return sorted(found, key=lambda kind: kind.__name__)


def issubclass_of_struct(kind: Any) -> bool:
    """Whether it is a struct that can be made (not the base class itself)."""
    return (
        isinstance(kind, type) and issubclass(kind, msgspec.Struct) and kind is not msgspec.Struct
    )


def instances_of(kind: type[msgspec.Struct]) -> st.SearchStrategy[Any]:
    """Valid instances of a struct."""
    return _struct(kind)


@functools.cache
def _struct(kind: type[msgspec.Struct]) -> st.SearchStrategy[Any]:
    special = _SPECIAL.get(kind.__name__)
    if special is not None:
        return special(kind)
    return _built(kind)


def _built(kind: type[msgspec.Struct], **given: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    shape = cast("inspect.StructType", inspect.type_info(kind))
    fields: dict[str, st.SearchStrategy[Any]] = {}
    for field in shape.fields:
        layout = ARRAY_FIELDS.get((kind, field.name))
        if field.name in given:
            fields[field.name] = given[field.name]
        elif layout is None:
            fields[field.name] = _of(field.type)
        else:
            size = 4 if layout.dtype == "<f4" else 1
            columns = int(layout.shape[-1]) if layout.shape[-1].isdigit() else 1
            fields[field.name] = _bytes(size * columns)
    return st.builds(kind, **fields)


def _bytes(unit: int) -> st.SearchStrategy[memoryview]:
    rows = st.integers(0, MAX_ITEMS)
    return rows.flatmap(lambda n: st.binary(min_size=n * unit, max_size=n * unit)).map(memoryview)


def _of(shape: inspect.Type) -> st.SearchStrategy[Any]:
    make = _BY_TYPE.get(type(shape))
    if make is None:
        raise TypeError(f"no strategy for {shape}")
    return make(shape)


def _strings(shape: inspect.StrType) -> st.SearchStrategy[str]:
    if shape.pattern is not None:
        # Python reads the end of a pattern as msgspec does.
        return st.from_regex(shape.pattern)
    low = shape.min_length or 0
    return st.text(min_size=low, max_size=max(low, min(shape.max_length or 8, 8)))


def _lists(shape: inspect.ListType) -> st.SearchStrategy[list[Any]]:
    low = shape.min_length or 0
    most = MAX_ITEMS if shape.max_length is None else min(shape.max_length, MAX_ITEMS)
    return st.lists(_of(shape.item_type), min_size=low, max_size=max(low, most))


def _integers(shape: inspect.IntType) -> st.SearchStrategy[int]:
    low = shape.ge if shape.ge is not None else (shape.gt + 1 if shape.gt is not None else -INT64)
    high = shape.le if shape.le is not None else (shape.lt - 1 if shape.lt is not None else INT64)
    return st.integers(int(low), int(high))


def _floats(shape: inspect.FloatType) -> st.SearchStrategy[float]:
    least, most = -sys.float_info.max, sys.float_info.max
    return st.floats(
        least if shape.ge is None and shape.gt is None else shape.ge or shape.gt or 0.0,
        most if shape.le is None else shape.le,
        exclude_min=shape.gt is not None,
        allow_nan=False,
        allow_infinity=False,
    )


# Structs whose fields depend on each other.


def _grid(kind: type[msgspec.Struct]) -> st.SearchStrategy[Any]:
    def sized(size: tuple[int, int]) -> st.SearchStrategy[Any]:
        width, height = size
        cells = st.binary(min_size=width * height, max_size=width * height).map(memoryview)
        far = st.floats(-MAX_COORDINATE_M, MAX_COORDINATE_M)
        origin = st.builds(Pose2D, far, far, st.floats(-7.0, 7.0))
        size_of = {"width": st.just(width), "height": st.just(height)}
        return _built(kind, cells=cells, origin=origin, **size_of)

    return st.tuples(st.integers(1, 4), st.integers(1, 4)).flatmap(sized)


def _scan(kind: type[msgspec.Struct]) -> st.SearchStrategy[Any]:
    def sized(beams: int) -> st.SearchStrategy[Any]:
        floats = st.binary(min_size=4 * beams, max_size=4 * beams).map(memoryview)
        none = st.just(memoryview(b""))
        return _built(kind, ranges=floats, intensities=st.one_of(none, floats))

    return st.integers(0, 4).flatmap(sized)


def _cloud(kind: type[msgspec.Struct]) -> st.SearchStrategy[Any]:
    def sized(n: int) -> st.SearchStrategy[Any]:
        poses = st.binary(min_size=12 * n, max_size=12 * n).map(memoryview)
        weights = st.binary(min_size=4 * n, max_size=4 * n).map(memoryview)
        return _built(kind, poses=poses, weights=weights)

    return st.integers(0, 4).flatmap(sized)


def _either(one: str, other: str, kind: type[msgspec.Struct]) -> st.SearchStrategy[Any]:
    """Exactly one of two optional fields is given."""
    shape = cast("inspect.StructType", inspect.type_info(kind))
    by_name = {field.name: field.type for field in shape.fields}

    def only(name: str, missing: str) -> st.SearchStrategy[Any]:
        union = cast("inspect.UnionType", by_name[name])
        given = [_of(one) for one in union.types if not isinstance(one, inspect.NoneType)]
        return _built(kind, **{name: st.one_of(*given), missing: st.none()})

    return st.one_of(only(one, other), only(other, one))


_BY_TYPE: dict[type[inspect.Type], Callable[[Any], st.SearchStrategy[Any]]] = {
    inspect.StructType: lambda shape: st.deferred(lambda: _struct(shape.cls)),
    inspect.UnionType: lambda shape: st.one_of(*map(_of, shape.types)),
    inspect.NoneType: lambda _: st.none(),
    inspect.BoolType: lambda _: st.booleans(),
    inspect.IntType: _integers,
    inspect.FloatType: _floats,
    inspect.StrType: _strings,
    inspect.BytesType: lambda _: st.binary(max_size=8),
    inspect.LiteralType: lambda shape: st.sampled_from(shape.values),
    inspect.ListType: _lists,
    inspect.TupleType: lambda shape: st.tuples(*map(_of, shape.item_types)),
    inspect.DictType: lambda shape: st.dictionaries(
        st.text(max_size=8), _of(shape.value_type), max_size=MAX_ITEMS
    ),
    inspect.AnyType: lambda _: st.one_of(st.none(), st.booleans(), st.text(max_size=8)),
}
_SPECIAL = {
    "OccupancyGrid": _grid,
    "Scan": _scan,
    "ParticleCloud": _cloud,
    "SendGoal": functools.partial(_either, "pose", "name"),
    "AskOffer": functools.partial(_either, "pose", "name"),
    "Stop": functools.partial(_either, "pose", "name"),
    "StartTour": functools.partial(_either, "name", "tour"),
}
