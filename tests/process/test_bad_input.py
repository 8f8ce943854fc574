"""Bad input through a real session: it is refused or dropped and counted, and the service lives."""

import os
import signal

import msgspec
import pytest
from support.processes import Process
from support.samples import make_place
from support.waiting import wait_until
from support.wire import error_code, health_of, read, stored_names

from trolley import codes
from trolley.messages import BaseState, SavedPose
from trolley.runtime import codec
from trolley.runtime.zenoh_bus import ZenohBus
from trolley.topics import Qos

# Floods and messages of 100 MB shall meet a router as it is in a house: all that is in one process
# shares Zenoh's threads.
pytestmark = pytest.mark.usefixtures("router")

REQUEST = "trolley/tester/@do/poses/put"
PLACE = {"name": "kitchen", "pose": {"x": 1.0, "y": 2.0, "yaw": 0.5}}


BAD_REQUESTS: dict[str, tuple[bytes, str]] = {
    "truncated json": (b'{"name": "kitchen"', codes.BAD_REQUEST),
    "noise": (b"\xc1\xff\xfe\x00", codes.BAD_REQUEST),
    "truncated msgpack": (msgspec.msgpack.encode(PLACE)[:-3], codes.BAD_REQUEST),
    "nested json lists": (b"[" * 1_000_000, codes.BAD_REQUEST),
    "nested json maps": (b'{"a":' * 200_000, codes.BAD_REQUEST),
    "nested msgpack": (b"\x91" * 1_000_000, codes.BAD_REQUEST),
    "wrong types": (b'{"name": 5, "pose": {}}', codes.BAD_REQUEST),
    "unknown field": (msgspec.json.encode({**PLACE, "colour": "red"}), codes.BAD_REQUEST),
    "nan": (
        msgspec.msgpack.encode({**PLACE, "pose": {"x": float("nan"), "y": 0.0, "yaw": 0.0}}),
        codes.BAD_REQUEST,
    ),
    "100 MB": (b'{"name": "' + b"a" * 100_000_000 + b'"}', codes.TOO_LARGE),
}


def test_bad_requests_are_refused_and_the_service_lives(keeper: Process, bus: ZenohBus):
    for what, (payload, code) in BAD_REQUESTS.items():
        assert [error_code(reply) for reply in read(bus, REQUEST, payload)] == [code], what
        assert stored_names(bus) == set(), what
    (reply,) = read(bus, REQUEST, msgspec.json.encode(PLACE))
    assert not reply.is_error
    assert keeper.is_running


def test_bad_puts_are_dropped_and_counted(keeper: Process, bus: ZenohBus):
    good = codec.encode(make_place(), "msgpack")
    mime = codec.MIME["msgpack"]
    key = "trolley/tester/poses/kitchen"
    for payload in (b"", good[:-2], b"\xc1", b"[" * 500_000, b"\x91" * 500_000, b'{"pose": 1}'):
        bus.put(key, payload, "", Qos.STATE)
    wait_until(lambda: counters(bus).get("poses/invalid") == 6, "what is not understood is counted")
    bus.put("trolley/tester/poses/*", good, mime, Qos.STATE)
    bus.put("trolley/*/poses/kitchen", good, mime, Qos.STATE)
    bus.put("trolley/**", good, mime, Qos.STATE)
    bus.delete("trolley/tester/poses/**")
    bus.put("trolley/tester/poses/cellar", good, mime, Qos.STATE)
    wait_until(lambda: stored_names(bus) == {"cellar"}, "the good one is stored")
    wait_until(lambda: counters(bus).get("poses/key", 0) >= 3, "wildcards are counted")
    bus.put(key, b"x" * 100_000_000, mime, Qos.STATE)
    wait_until(lambda: counters(bus).get("poses/too_large") == 1, "what is too large is counted")
    health = health_of(bus, "tour")
    assert health is not None
    assert health.counters["poses/invalid"] == 6
    assert health.rss < 400e6
    assert stored_names(bus) == {"cellar"}
    assert keeper.is_running


def counters(bus: ZenohBus) -> dict[str, int]:
    """What the service has counted."""
    health = health_of(bus, "tour")
    return {} if health is None else health.counters


def test_names_stand_raw_in_the_key(keeper: Process, bus: ZenohBus):
    for i, name in enumerate(["..", "a b", "K\u00fcche", "Ku\u0308che", "x" * 60]):
        key = f"trolley/tester/poses/{name}"
        bus.put(key, codec.encode(make_place(x=i), "json"), codec.MIME["json"], Qos.STATE)

        def is_stored(key: str = key, x: float = i) -> bool:
            (reply,) = read(bus, key)
            is_there = not reply.is_error and codec.decode(SavedPose, reply.payload).pose.x == x
            return is_there and reply.key == key

        wait_until(is_stored, f"{name} is stored")
    assert len(stored_names(bus)) == 4  # two ways to write one name
    assert read(bus, "trolley/*/poses/Ku\u0308che") == []  # no answer may stand on such a key
    assert len(stored_names(bus)) == 4
    assert keeper.is_running


def test_a_name_that_is_not_there_is_told(keeper: Process, bus: ZenohBus):
    (reply,) = read(bus, "trolley/tester/poses/attic")
    assert error_code(reply) == codes.UNKNOWN_NAME
    assert read(bus, "trolley/*/poses/attic") == []


def test_reading_everything_moves_nothing(keeper: Process, bus: ZenohBus):
    replies = read(bus, "trolley/**")
    assert {"trolley/tester/poses", "trolley/tester/health/tour"} <= {r.key for r in replies}
    assert not any("@" in reply.key for reply in replies)
    health = health_of(bus, "tour")
    assert health is not None
    assert "stops" not in health.counters


def test_a_stop_of_all_robots_is_obeyed_in_a_flood(keeper: Process, bus: ZenohBus):
    junk = b"x" * 100_000
    for _ in range(300):
        bus.put("trolley/tester/poses/kitchen", junk, "", Qos.STATE)
    (reply,) = read(bus, "trolley/*/@do/base/stop", b"\xff nonsense")
    assert reply.key == "trolley/tester/@do/base/stop"
    assert codec.decode(BaseState, reply.payload).mode == "stopped"


def test_a_flood_does_not_keep_it_from_ending(keeper: Process, bus: ZenohBus):
    good = codec.encode(make_place(), "msgpack")
    sent = 0

    def has_ended() -> bool:
        nonlocal sent
        for _ in range(50):
            bus.put(f"trolley/tester/poses/p{sent % 50}", good, codec.MIME["msgpack"], Qos.STATE)
            sent += 1
        if sent == 200:
            os.kill(keeper.pid, signal.SIGTERM)
        return not keeper.is_running

    wait_until(has_ended, "it ends while the flood goes on")
    assert keeper.wait() == 0, keeper.log
