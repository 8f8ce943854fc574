"""The tables of topics, requests and codes fit each other and the contract."""

import itertools
import re
from collections.abc import Iterator
from typing import Any

import msgspec
import pytest
from support.strategies import message_types

from trolley import codes, requests, topics
from trolley.geometry.pose import LARGEST
from trolley.messages.arrays import ARRAY_FIELDS
from trolley.runtime import codec
from trolley.runtime.bus import matches
from trolley.topics import Kind

COMMON = {
    codes.BAD_REQUEST,
    codes.UNKNOWN_NAME,
    codes.TOO_LARGE,
    codes.NOT_READY,
    codes.TIMEOUT,
    codes.INTERNAL,
}


def constants(module: object) -> set[str]:
    return {
        value for name, value in vars(module).items() if name.isupper() and isinstance(value, str)
    }


def test_every_code_has_one_sentence_for_people():
    assert constants(codes) == set(codes.SENTENCES)
    for code, sentence in codes.SENTENCES.items():
        assert re.fullmatch(r"[a-z]+(_[a-z]+)*", code)
        assert re.fullmatch(r"[A-Z][^\n]*\.", sentence)


def test_a_refusal_carries_its_sentence():
    assert codes.Refused(codes.LOST).message == codes.SENTENCES[codes.LOST]
    assert str(codes.Refused(codes.LOST, "Where?", x=1)) == "Where?"
    assert codes.Refused(codes.LOST, "Where?", x=1).details == {"x": 1}


def test_requests_refuse_with_known_codes_beside_the_common_ones():
    for request in requests.REQUESTS:
        assert set(request.refusals) <= set(codes.SENTENCES) - COMMON, request.name


def numbers_in(schema: Any) -> Iterator[dict[str, Any]]:
    """What a JSON schema says of each number that need not be whole."""
    if isinstance(schema, dict):
        if schema.get("type") == "number":
            yield schema
        schema = list(schema.values())
    if isinstance(schema, list):
        for part in schema:
            yield from numbers_in(part)


def test_any_two_numbers_of_messages_can_be_multiplied() -> None:
    schemas = msgspec.json.schema_components(message_types())[1]
    assert len(list(numbers_in(schemas))) > 100
    for number in numbers_in(schemas):
        bounds = [value for name, value in number.items() if name.endswith("imum")]
        assert len(bounds) == 2, number
        assert all(abs(bound) <= LARGEST for bound in bounds), number


def test_no_two_topics_share_a_key():
    for one, other in itertools.combinations(topics.TOPICS, 2):
        assert not matches(one.key("x"), other.key("x")), (one.name, other.name)


def test_requests_lie_where_no_wildcard_reaches():
    for request in requests.REQUESTS:
        key = request.key("x")
        assert key.startswith("trolley/x/@do/")
        assert not matches("trolley/x/**", key)
        assert topics.find(key) is None
    assert len({request.name for request in requests.REQUESTS}) == len(requests.REQUESTS)


@pytest.mark.parametrize("topic", topics.TOPICS, ids=lambda topic: topic.name)
def test_a_key_finds_its_topic_again(topic: topics.Topic[msgspec.Struct]):
    parts = tuple("abc"[: topic.num_parts])
    key = topic.key("robby", *parts)
    assert topics.find(key) == (topic, "robby", parts)
    assert topic.match(key + "/more") is None
    assert topic.match("other" + key) is None
    assert matches(topic.key("*"), key)


@pytest.mark.parametrize("topic", topics.TOPICS, ids=lambda topic: topic.name)
def test_messages_have_a_stamp_unless_they_are_stored_as_they_are(
    topic: topics.Topic[msgspec.Struct],
):
    fields = {field.name for field in msgspec.structs.fields(topic.message)}
    assert ("stamp_ns" in fields) == (topic.kind is Kind.STREAM)
    assert not topic.of_epoch or "stamp_ns" in fields


def test_every_message_says_what_it_is():
    for topic in topics.TOPICS:
        assert topic.message.__doc__
        assert topic.owner
        assert topic.rate


def test_every_array_is_in_the_table_of_arrays():
    found = {
        (topic.message, field.name)
        for topic in topics.TOPICS
        for field in msgspec.structs.fields(topic.message)
        if field.type is memoryview
    }
    assert found == set(ARRAY_FIELDS)


def test_all_tours_of_a_robot_of_release_0_2_0_are_heard_of():
    """It took any number of rounds; a limit on the wire made its whole list unreadable."""
    endless = {"name": "round", "stops": [{"name": "kitchen"}], "repeat": 2**63 - 1}
    sent = {"stamp_ns": 0, "tours": [{**endless, "name": "evening", "repeat": 2}, endless]}
    heard = codec.decode(topics.TOURS.message, msgspec.msgpack.encode(sent))
    assert [tour.name for tour in heard.tours] == ["evening", "round"]
