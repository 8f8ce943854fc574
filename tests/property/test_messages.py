"""Every message survives both encodings, and whatever else arrives is refused in one way."""

from typing import Any

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.cases import cases
from support.strategies import instances_of, message_types

from trolley.messages import Scan, Stop, Tour
from trolley.messages.arrays import ARRAY_FIELDS
from trolley.requests import REQUESTS
from trolley.runtime import codec

TYPES = message_types()
EXAMPLES = cases(18)  # of each of some ninety types
FORMATS: tuple[codec.Format, ...] = ("json", "msgpack")


def plain(message: Any) -> Any:
    """A message as comparable values: arrays as bytes."""
    return msgspec.to_builtins(message, builtin_types=(bytes,))


@pytest.mark.parametrize("kind", TYPES, ids=lambda kind: kind.__name__)
@settings(max_examples=EXAMPLES)
@given(data=st.data())
def test_every_message_survives_both_encodings(kind: type[msgspec.Struct], data: st.DataObject):
    message = data.draw(instances_of(kind))
    for fmt in FORMATS:
        payload = codec.encode(message, fmt)
        back = codec.decode(kind, payload, codec.MIME[fmt])
        assert plain(back) == plain(message)
        assert codec.encode(back, fmt) == payload


@pytest.mark.parametrize(
    "kind", list(dict.fromkeys(one.params for one in REQUESTS)), ids=lambda kind: kind.__name__
)
@settings(max_examples=EXAMPLES)
@given(data=st.data())
def test_parameters_survive_and_are_left_out_where_that_says_the_same(
    kind: type[msgspec.Struct], data: st.DataObject
):
    params = data.draw(instances_of(kind))
    payload = codec.encode_parameters(params)
    assert plain(codec.decode_strict(kind, payload, codec.MIME["msgpack"])) == plain(params)


def test_a_tour_for_any_map_is_understood_by_a_robot_that_knows_of_no_maps():
    tour = codec.encode_parameters(Tour(name="round", stops=[Stop(name="kitchen")]))
    assert set(msgspec.msgpack.decode(tour)) == {"name", "stops"}


@pytest.mark.parametrize("kind", TYPES, ids=lambda kind: kind.__name__)
@settings(max_examples=EXAMPLES)
@given(data=st.data())
def test_the_format_is_recognised_without_an_encoding(
    kind: type[msgspec.Struct], data: st.DataObject
):
    message = data.draw(instances_of(kind))
    blank = data.draw(st.sampled_from(["", " ", "\n\t "]))
    as_json = blank.encode() + codec.encode(message, "json")
    assert plain(codec.decode(kind, as_json)) == plain(message)
    assert plain(codec.decode(kind, codec.encode(message, "msgpack"))) == plain(message)


@pytest.mark.parametrize("kind", TYPES, ids=lambda kind: kind.__name__)
@settings(max_examples=EXAMPLES)
@given(data=st.data())
def test_truncated_messages_are_refused(kind: type[msgspec.Struct], data: st.DataObject):
    message = data.draw(instances_of(kind))
    for fmt in FORMATS:
        payload = codec.encode(message, fmt)
        cut = data.draw(st.integers(0, len(payload) - 1))
        with pytest.raises(codec.BadPayload):
            codec.decode(kind, payload[:cut], codec.MIME[fmt])


def decodes_or_refuses(kind: type[Any], payload: bytes, encoding: str, *, strictly: bool) -> None:
    """Pass if it decodes or is refused as a `BadPayload`; any other exception is a failure."""
    decode = codec.decode_strict if strictly else codec.decode
    try:
        decode(kind, payload, encoding)
    except codec.BadPayload:
        return


ENCODINGS = st.sampled_from(["", "application/json", "application/msgpack", "text/plain"])


@given(kind=st.sampled_from(TYPES), payload=st.binary(), encoding=ENCODINGS, strictly=st.booleans())
def test_noise_is_refused(
    kind: type[msgspec.Struct], payload: bytes, encoding: str, strictly: bool
) -> None:
    decodes_or_refuses(kind, payload, encoding, strictly=strictly)


MSGPACK_INTEGERS = st.integers(-(2**63), 2**64 - 1)
JSON_VALUES = st.recursive(
    st.one_of(st.none(), st.booleans(), MSGPACK_INTEGERS, st.floats(), st.text()),
    lambda inner: st.one_of(st.lists(inner), st.dictionaries(st.text(), inner)),
    max_leaves=8,
)


@given(kind=st.sampled_from(TYPES), value=JSON_VALUES, strictly=st.booleans(), data=st.data())
def test_well_formed_values_of_the_wrong_shape_are_refused(
    kind: type[msgspec.Struct], value: Any, strictly: bool, data: st.DataObject
) -> None:
    fields = [field.name for field in msgspec.structs.fields(kind)]
    if fields and data.draw(st.booleans()):  # the right names with wrong values
        value = dict.fromkeys(fields, value)
    payload = msgspec.msgpack.encode(value)
    decodes_or_refuses(kind, payload, codec.MIME["msgpack"], strictly=strictly)
    decodes_or_refuses(kind, msgspec.json.encode(value), codec.MIME["json"], strictly=strictly)


@pytest.mark.parametrize("kind", TYPES, ids=lambda kind: kind.__name__)
@settings(max_examples=EXAMPLES)
@given(data=st.data(), bad=st.sampled_from([float("nan"), float("inf"), -float("inf")]))
def test_no_number_outside_an_array_may_be_nan_or_infinite(
    kind: type[msgspec.Struct], data: st.DataObject, bad: float
) -> None:
    values = msgspec.to_builtins(data.draw(instances_of(kind)), builtin_types=(bytes,))
    found = number_paths(values)
    if not found:
        return
    path = data.draw(st.sampled_from(found))
    put_in(values, path, bad)
    with pytest.raises(codec.BadPayload):
        codec.decode(kind, msgspec.msgpack.encode(values), codec.MIME["msgpack"])


def number_paths(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Where in nested maps and lists floats stand."""
    if isinstance(value, float):
        return [path]
    if not isinstance(value, dict | list):
        return []
    items = value.items() if isinstance(value, dict) else enumerate(value)
    return [found for key, inner in items for found in number_paths(inner, (*path, key))]


def put_in(value: Any, path: tuple[Any, ...], new: float) -> None:
    for key in path[:-1]:
        value = value[key]
    value[path[-1]] = new


@given(text=st.text())
def test_selector_parameters_never_fail_to_split(text: str) -> None:
    for name, value in codec.parse_parameters(text).items():
        assert isinstance(name, str)
        assert isinstance(value, str)


@given(values=st.dictionaries(st.text(), st.text(), max_size=4), kind=st.sampled_from(TYPES))
def test_selector_parameters_are_refused_in_one_way(
    values: dict[str, str], kind: type[msgspec.Struct]
) -> None:
    try:
        codec.decode_parameters(kind, values)
    except codec.BadPayload:
        return


def test_arrays_are_views_of_the_payload() -> None:
    assert (Scan, "ranges") in ARRAY_FIELDS
    scan = Scan(
        stamp_ns=1,
        frame="laser",
        angle_min=0.0,
        angle_increment=0.1,
        time_increment=0.0,
        range_min=0.1,
        range_max=10.0,
        ranges=memoryview(bytes(8)),
    )
    back = codec.decode(Scan, codec.encode(scan, "msgpack"))
    assert isinstance(back.ranges, memoryview)
    assert back.ranges.readonly
