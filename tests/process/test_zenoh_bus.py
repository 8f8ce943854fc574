"""A real bus: on whose threads it calls back, what leaves the process, and the ends of gets."""

import time
from pathlib import Path

import pytest
from support.waiting import PATIENCE_S, wait_until
from support.wire import read

from trolley.runtime.bus import Query, Sample
from trolley.runtime.zenoh_bus import MOST_PUBLISHERS, ZenohBus, open_bus, open_bus_patiently
from trolley.topics import Qos

MANY = 40


def num_threads() -> int:
    """Threads of this process, the libraries' too."""
    return len(list(Path("/proc/self/task").iterdir()))


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


@pytest.fixture
def direct(router_endpoint: str):
    """A bus as services have it."""
    opened = open_bus_patiently([router_endpoint], lambda: True)
    assert opened is not None
    yield opened
    opened.close()


def test_a_service_s_bus_takes_no_thread_for_each_key(direct: ZenohBus, other: ZenohBus) -> None:
    before = num_threads()
    heard: list[str] = []
    for number in range(MANY):
        direct.subscribe(f"trolley/tester/one/{number}", lambda sample: heard.append(sample.key))
        direct.serve(f"trolley/tester/served/{number}", answer)
    wait_until_known(direct, other)
    sent = [f"trolley/tester/one/{number}" for number in range(MANY)] * 5
    for key in sent:
        other.put(key, b"x", "", Qos.STATE)
    wait_until(lambda: len(heard) == len(sent), "all have been heard")
    assert heard == sent
    assert len(read(other, "trolley/tester/served/*")) == MANY
    assert num_threads() < before + MANY // 2  # Zenoh may take one or another for itself
    direct.put("trolley/tester/one/0", b"x", "", Qos.SENSOR)  # what it says itself, it hears too
    wait_until(lambda: len(heard) == len(sent) + 1, "its own")


def test_a_service_s_bus_goes_on_after_a_callback_that_fails(
    direct: ZenohBus, other: ZenohBus
) -> None:
    heard: list[bytes] = []

    def hear(sample: Sample) -> None:
        heard.append(sample.payload)
        if sample.payload == b"bad":
            raise ValueError("a program has a fault")

    direct.subscribe("trolley/tester/two", hear)
    wait_until_known(direct, other)
    for payload in (b"bad", b"good"):
        other.put("trolley/tester/two", payload, "", Qos.STATE)
    wait_until(lambda: heard == [b"bad", b"good"], "both have been heard")


def test_a_stream_is_heard_by_who_listens_late_and_by_who_listens_again(
    bus: ZenohBus, other: ZenohBus
) -> None:
    """Nobody hears it at first, so that it does not leave the process that publishes it."""
    heard: list[Sample] = []
    passed: list[Sample] = []
    other.subscribe("trolley/tester/after", passed.append)

    def has_passed() -> bool:
        bus.put("trolley/tester/after", b"", "", Qos.SENSOR)
        return bool(passed)

    for _ in range(3):
        bus.put("trolley/tester/stream", b"early", "", Qos.SENSOR)
        # A new publisher sends until it knows that nobody listens: let the router drop that first.
        passed.clear()
        wait_until(has_passed, "what was put before has passed the router")
        closer = other.subscribe("trolley/tester/stream", heard.append)
        wait_until(lambda: bus.is_heard("trolley/tester/stream", ""), "somebody listens")
        bus.put("trolley/tester/stream", b"now", "", Qos.SENSOR)
        wait_until(lambda: [one.payload for one in heard] == [b"now"], "the stream")
        closer.close()
        # Else the next one is taken to listen already, before the router has told of it.
        wait_until(lambda: not bus.is_heard("trolley/tester/stream", ""), "nobody listens")
        heard.clear()


def test_more_keys_than_a_bus_keeps_publishers_of_are_heard(bus: ZenohBus, other: ZenohBus) -> None:
    heard: set[str] = set()
    other.subscribe("trolley/tester/many/*", lambda sample: heard.add(sample.key))
    wait_until_known(other, bus)
    keys = {f"trolley/tester/many/{number}" for number in range(MOST_PUBLISHERS + 50)}

    def are_heard() -> bool:
        for key in keys - heard:
            bus.put(key, b"x", "", Qos.SENSOR)
        return heard == keys

    wait_until(are_heard, "every key")


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


def test_a_bus_tells_whether_a_stream_is_heard(bus: ZenohBus, other: ZenohBus) -> None:
    key = "trolley/tester/costly"
    bus.put(key, b"early", "", Qos.SENSOR)
    wait_until(lambda: not bus.is_heard(key, ""), "nobody listens")
    closer = other.subscribe(key, lambda _: None)
    wait_until(lambda: bus.is_heard(key, ""), "somebody listens")
    closer.close()
    wait_until(lambda: not bus.is_heard(key, ""), "nobody listens any more")


def test_no_callback_goes_on_after_the_bus_is_closed(router_endpoint: str, other: ZenohBus) -> None:
    """Its thread is a daemon: it aborted the process where Python ended meanwhile."""
    heard: list[str] = []

    def take_long(sample: Sample) -> None:
        heard.append(sample.key)
        time.sleep(0.2)
        heard.append("done")

    with open_bus([router_endpoint], timeout_s=PATIENCE_S) as closing:
        closing.subscribe("trolley/tester/slow", take_long)
        wait_until_known(closing, other)
        for _ in range(MANY):
            other.put("trolley/tester/slow", b"", "", Qos.STATE)
        wait_until(lambda: bool(heard), "the first is being taken")
    assert heard[-1] == "done"
    assert len(heard) < MANY
