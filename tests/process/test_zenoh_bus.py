"""What arrives over a real bus: on one thread, in its order, and whatever a callback does."""

import logging
import threading

import pytest
from support.waiting import PATIENCE_S, wait_until
from support.wire import read

from trolley.runtime.bus import Query, Sample
from trolley.runtime.zenoh_bus import ZenohBus, open_bus
from trolley.topics import Qos

MANY = 40


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


def test_however_many_listen_one_thread_calls_them(bus: ZenohBus, other: ZenohBus) -> None:
    before, callers = threading.active_count(), set[int]()
    heard: list[str] = []

    def hear(sample: Sample) -> None:
        callers.add(threading.get_ident())
        heard.append(sample.key)

    for number in range(MANY):
        bus.subscribe(f"trolley/tester/one/{number}", hear)
    assert threading.active_count() == before
    wait_until_known(bus, other)
    sent = [f"trolley/tester/one/{number}" for number in range(MANY)] * 5
    for key in sent:
        other.put(key, b"x", "", Qos.STATE)
    wait_until(lambda: len(heard) == len(sent), "all have been heard")
    assert heard == sent
    assert len(callers) == 1
    assert threading.get_ident() not in callers


def test_a_callback_that_fails_is_told_of_and_the_next_one_is_called(
    bus: ZenohBus, other: ZenohBus, caplog: pytest.LogCaptureFixture
) -> None:
    heard: list[bytes] = []

    def hear(sample: Sample) -> None:
        heard.append(sample.payload)
        if sample.payload == b"bad":
            raise ValueError("a program has a fault")

    bus.subscribe("trolley/tester/two", hear)
    wait_until_known(bus, other)
    with caplog.at_level(logging.ERROR):
        for payload in (b"bad", b"good"):
            other.put("trolley/tester/two", payload, "", Qos.STATE)
        wait_until(lambda: heard == [b"bad", b"good"], "both have been heard")
    assert "a program has a fault" in caplog.text


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


def test_a_flood_is_heard_to_its_end_while_a_callback_is_slow(
    bus: ZenohBus, other: ZenohBus
) -> None:
    """More than the bus keeps waiting: nothing of a reliable stream is lost."""
    gate, heard = threading.Event(), list[int]()

    def hear(sample: Sample) -> None:
        gate.wait(PATIENCE_S)
        heard.append(int(sample.payload))

    bus.subscribe("trolley/tester/four", hear)
    wait_until_known(bus, other)
    sender = threading.Thread(
        target=lambda: [
            other.put("trolley/tester/four", str(number).encode(), "", Qos.STATE)
            for number in range(3000)
        ]
    )
    sender.start()
    gate.set()
    wait_until(lambda: len(heard) == 3000, "all have been heard")
    sender.join()
    assert heard == list(range(3000))


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
