"""Gets over a real bus: who answers, who no longer does, and their end."""

import pytest
from support.waiting import PATIENCE_S, wait_until
from support.wire import read

from trolley.runtime.bus import Query, Sample
from trolley.runtime.zenoh_bus import ZenohBus, open_bus
from trolley.topics import Qos


def answer(query: Query) -> None:
    query.reply(query.key, b"x", "")
    query.finish()


def wait_until_known(bus: ZenohBus, other: ZenohBus) -> None:
    """Until what a bus has declared so far is known to another."""
    heard: list[Sample] = []
    closer = bus.subscribe("trolley/tester/known", heard.append)

    def is_known() -> bool:
        other.put("trolley/tester/known", b"", "", Qos.STATE)
        return bool(heard)

    wait_until(is_known, "the other knows what this one has declared")
    closer.close()


@pytest.fixture
def other(router_endpoint: str):
    with open_bus([router_endpoint], timeout_s=PATIENCE_S) as opened:
        yield opened


def test_a_get_ends_once_after_its_last_reply(bus: ZenohBus, other: ZenohBus) -> None:
    for number in range(3):

        def answer(query, number: int = number) -> None:
            query.reply("trolley/tester/three", bytes([number]), "")
            query.finish()

        other.serve("trolley/tester/three", answer)
    wait_until_known(other, bus)
    told: list[int | None] = []
    bus.get(
        "trolley/tester/three",
        b"",
        "",
        PATIENCE_S,
        lambda reply: told.append(reply.payload[0]),
        lambda: told.append(None),
    )
    wait_until(lambda: None in told, "the end")
    assert sorted(one for one in told[:-1] if one is not None) == [0, 1, 2]
    assert told[-1] is None


def test_who_served_a_key_and_has_ended_is_not_waited_for(
    bus: ZenohBus, other: ZenohBus, router_endpoint: str
) -> None:
    key = "trolley/tester/five"
    bus.serve(key, answer)
    with open_bus([router_endpoint], timeout_s=PATIENCE_S) as third:
        served = third.serve(key, answer)
        for one in (bus, third):
            wait_until_known(one, other)
        assert [reply.payload for reply in read(other, key)] == [b"x", b"x"]
        served.close()
    # One that waited would end with an error, after the time that it was given.
    assert [(reply.is_error, reply.payload) for reply in read(other, key)] == [(False, b"x")]


def test_a_key_that_was_closed_is_served_again(bus: ZenohBus, other: ZenohBus) -> None:
    key = "trolley/tester/six"
    served = bus.serve(key, answer)
    wait_until_known(bus, other)
    served.close()
    assert read(other, key) == []
    bus.serve(key, answer)
    assert [reply.payload for reply in read(other, key)] == [b"x"]
