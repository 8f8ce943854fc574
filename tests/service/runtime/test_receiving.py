"""What a service hears: newest wins, history, late joiners, earlier runs, bad input, deletes."""

import dataclasses
from collections.abc import Generator
from contextlib import contextmanager
from typing import Any

import pytest
from support.samples import (
    make_clock,
    make_estimate,
    make_goal,
    make_odometry,
    make_place,
    make_places,
    make_scan,
    make_transform,
)

from trolley import topics
from trolley.geometry import Twist2D
from trolley.messages import Marker, Odometry, SavedPoses, Scan, VelocityCommand
from trolley.runtime import codec
from trolley.runtime.lockstep import Lockstep
from trolley.runtime.service import Service, on, on_delete
from trolley.topics import Qos

SECOND = 1_000_000_000


class Listener(Service):
    """Hears scans and saved poses, watches what the test wants."""

    name = "localizer"

    def __init__(self) -> None:
        self.scans: list[int] = []
        self.places: list[SavedPoses] = []
        self.epochs = 0

    @on(topics.SCAN)
    def hear_scan(self, scan: Scan) -> None:
        self.scans.append(scan.stamp_ns)

    @on(topics.POSES)
    def hear_places(self, places: SavedPoses) -> None:
        self.places.append(places)

    def epoch_began(self) -> None:
        self.epochs += 1


class Speaker(Service):
    """Owns what the test lets it publish."""

    name = "tour"


@pytest.fixture
def listener(lockstep: Lockstep) -> Listener:
    return lockstep.add(Listener())


def put_unsettled(lockstep: Lockstep, topic: Any, message: Any, *parts: str) -> None:
    """Put a message as on a busy bus: the service has not got round to it yet."""
    key = topic.key("trolley", *parts)
    payload = codec.encode(message, "msgpack")
    lockstep.bus.put(key, payload, codec.MIME["msgpack"], Qos.STATE)


def test_of_a_sensor_the_newest_message_wins(lockstep: Lockstep, listener: Listener):
    for stamp in (1, 2, 3):
        put_unsettled(lockstep, topics.SCAN, make_scan(stamp))
    lockstep.run(0.1)
    assert listener.scans == [3]


def test_of_a_state_every_message_counts(lockstep: Lockstep, listener: Listener):
    for stamp in (1, 2, 3):
        put_unsettled(lockstep, topics.POSES, make_places(stamp))
    lockstep.run(0.1)
    assert [places.stamp_ns for places in listener.places] == [1, 2, 3]


def test_newest_wins_for_each_key_by_itself(lockstep: Lockstep, listener: Listener):
    commands = listener.watch(topics.CLOCK, robot="*")
    for robot in ("one", "two"):
        for stamp in (1, 2):
            payload = codec.encode(make_clock(stamp), "msgpack")
            lockstep.bus.put(f"trolley/{robot}/clock", payload, codec.MIME["msgpack"], Qos.SENSOR)
    lockstep.run(0.1)
    assert {parts: clock.stamp_ns for parts, clock in commands.by_parts.items()} == {
        ("one",): 2,
        ("two",): 2,
    }


def test_history_keeps_every_message_of_the_last_seconds(lockstep: Lockstep, listener: Listener):
    odometry = listener.watch(topics.ODOM, seconds=0.5)
    for i in range(20):
        put_unsettled(lockstep, topics.ODOM, make_odometry(i, x=0.1 * i))
        put_unsettled(lockstep, topics.ODOM, make_odometry(i, x=0.1 * i + 0.05))
        lockstep.run(0.1)
    assert [one.stamp_ns for one in odometry.history] == [
        stamp for stamp in range(14, 20) for _ in range(2)
    ]
    assert odometry.latest == odometry.history[-1]
    assert odometry.arrived_ns == 19 * SECOND // 10


def test_a_late_joiner_reads_what_is_there(lockstep: Lockstep):
    speaker = lockstep.add(Speaker())
    speaker.publish(topics.POSES, make_places(5, "kitchen"))
    speaker.publish(topics.TF, make_transform(6, "laser"), "laser")
    listener = lockstep.add(Listener())
    transforms = listener.watch(topics.TF)
    lockstep.run(0.1)
    assert listener.places == [make_places(5, "kitchen")]
    assert set(transforms.by_parts) == {("laser",)}


def test_a_late_joiner_keeps_the_newer(lockstep: Lockstep):
    speaker = lockstep.add(Speaker())
    speaker.publish(topics.POSES, make_places(5, "old"))
    listener = Listener()
    lockstep.nodes["tour"].inbox.push(lambda _: None)
    lockstep.add(listener)  # subscribed and asked; the answer is on its way or in
    put_unsettled(lockstep, topics.POSES, make_places(9, "new"))
    lockstep.run(0.1)
    assert listener.places[-1] == make_places(9, "new")


@contextmanager
def outage(lockstep: Lockstep) -> Generator[None]:
    """The bus is away: what is published reaches nobody."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(lockstep.bus, "put", lambda *_: None)
        yield


def test_after_a_reconnection_the_owner_is_right_even_without_robot_time(lockstep: Lockstep):
    """What was published while the bus was away had stamp 0, as what was known before."""
    speaker = lockstep.add(Speaker())
    listener = lockstep.add(Listener())
    speaker.publish(topics.POSES, make_places(0, "a"))
    lockstep.run(1.0)
    with outage(lockstep):
        speaker.publish(topics.POSES, make_places(0, "b"))
    lockstep.nodes["localizer"].reconnected()
    lockstep.run(0.1)
    assert listener.places == [make_places(0, "a"), make_places(0, "b")]
    lockstep.run(5.0)
    assert len(listener.places) == 2  # what is known already is not told again


def test_an_owner_that_comes_back_later_is_read_as_well(lockstep: Lockstep):
    """Everybody looks for the router at their own pace."""
    listener = lockstep.add(Listener())
    lockstep.nodes["localizer"].reconnected()
    lockstep.run(0.5)
    speaker = lockstep.add(Speaker())
    with outage(lockstep):
        speaker.publish(topics.POSES, make_places(3, "a"))
    lockstep.run(3.0)
    assert listener.places == [make_places(3, "a")]


def test_messages_of_an_earlier_run_are_dropped(lockstep: Lockstep, listener: Listener):
    listener.watch(topics.TF)
    listener.watch(topics.POSE)
    lockstep.publish(topics.CLOCK, make_clock(1000, epoch=1000))
    lockstep.publish(topics.SCAN, make_scan(999))
    lockstep.publish(topics.POSE, make_estimate(999))
    lockstep.publish(topics.TF, make_transform(999, "odom"), "odom")
    lockstep.publish(topics.TF, make_transform(999, "laser"), "laser")
    lockstep.publish(topics.POSES, make_places(999))
    assert listener.scans == []
    assert len(listener.places) == 1
    assert lockstep.counters("localizer") == {
        "scan/earlier_run": 1,
        "pose/earlier_run": 1,
        "tf/earlier_run": 1,
    }


def test_a_new_run_drops_what_was_measured_before_it_and_nothing_else(
    lockstep: Lockstep, listener: Listener
):
    odometry = listener.watch(topics.ODOM, seconds=2.0)
    transforms = listener.watch(topics.TF)
    estimate = listener.watch(topics.POSE)
    lockstep.publish(topics.CLOCK, make_clock(0, epoch=0))
    lockstep.publish(topics.POSE, make_estimate(90))
    lockstep.publish(topics.ODOM, make_odometry(100))
    lockstep.publish(topics.TF, make_transform(100, "odom"), "odom")
    lockstep.publish(topics.TF, make_transform(100, "laser"), "laser")
    # The first odometry of the new run overtakes its clock.
    lockstep.publish(topics.ODOM, make_odometry(1001))
    lockstep.publish(topics.CLOCK, make_clock(1002, epoch=1000))
    assert [one.stamp_ns for one in odometry.history] == [1001]
    assert odometry.latest == make_odometry(1001)
    assert set(transforms.by_parts) == {("laser",)}
    assert estimate.latest is None
    assert estimate.arrived_ns is None
    assert listener.epochs == 2


def test_a_run_of_another_robot_is_its_own_affair(lockstep: Lockstep):
    class Viewer(Listener):
        name = "viz"
        all_robots = True

    viewer = lockstep.add(Viewer())
    odometry = viewer.watch(topics.ODOM, robot="*")

    def put(robot: str, topic: Any, message: Any) -> None:
        payload = codec.encode(message, "msgpack")
        lockstep.put(topic.key(robot), payload, codec.MIME["msgpack"])

    for robot in ("trolley", "other"):
        put(robot, topics.CLOCK, make_clock(10, epoch=10))
        put(robot, topics.ODOM, make_odometry(20))
    assert viewer.epochs == 1
    put("other", topics.CLOCK, make_clock(500, epoch=500))
    assert viewer.epochs == 1
    assert set(odometry.by_parts) == {("trolley",)}
    put("other", topics.ODOM, make_odometry(20))
    assert set(odometry.by_parts) == {("trolley",)}
    assert viewer.time_of("other").epoch == 500
    assert viewer.epoch_ns == 10


def test_a_read_drops_what_is_of_an_earlier_run(lockstep: Lockstep):
    speaker = lockstep.add(Speaker())
    listener = lockstep.add(Listener())
    found: list[dict[tuple[str, ...], Any]] = []
    speaker.publish(topics.POSE, make_estimate(5))
    listener.get(topics.POSE, then=found.append)
    lockstep.run(0.1)
    lockstep.publish(topics.CLOCK, make_clock(100, epoch=100))
    listener.get(topics.POSE, then=found.append)
    lockstep.run(0.1)
    assert found == [{(): make_estimate(5)}, {}]


@pytest.mark.parametrize(
    ("payload", "reason"),
    [
        (b"", "invalid"),
        (b"\xc1", "invalid"),
        (b"{", "invalid"),
        (b'{"stamp_ns": 1}', "invalid"),
        (b'{"stamp_ns": "1", "poses": []}', "invalid"),
        (b'{"stamp_ns": -1, "poses": []}', "invalid"),
        (b"[" * 100_000, "invalid"),
        (b"\x91" * 100_000, "invalid"),
        (b'{"stamp_ns": 1, "poses": [], "x": "' + b"x" * (1 << 20) + b'"}', "too_large"),
    ],
)
def test_bad_input_is_counted_and_dropped(
    lockstep: Lockstep, listener: Listener, payload: bytes, reason: str
):
    lockstep.put("trolley/trolley/poses", payload)
    lockstep.publish(topics.POSES, make_places(1))
    assert listener.places == [make_places(1)]
    assert lockstep.counters("localizer") == {f"poses/{reason}": 1}


def test_unknown_fields_of_a_stream_are_ignored(lockstep: Lockstep, listener: Listener):
    lockstep.put("trolley/trolley/poses", b' {"stamp_ns": 1, "poses": [], "colour": "red"}')
    assert listener.places == [make_places(1)]


def test_a_put_on_a_wildcard_key_is_dropped_and_counted(lockstep: Lockstep, listener: Listener):
    payload = codec.encode(make_places(1), "msgpack")
    for key in ("trolley/*/poses", "trolley/**", "trolley/trolley/$*es"):
        lockstep.put(key, payload, codec.MIME["msgpack"])
    assert listener.places == []
    assert lockstep.counters("localizer")["poses/key"] == 3


def test_a_watch_of_many_keys_stops_growing(lockstep: Lockstep, listener: Listener):
    transforms = listener.watch(dataclasses.replace(topics.TF, max_keys=3))
    for i in range(9):
        lockstep.publish(topics.TF, make_transform(i, f"t{i}"), f"t{i}")
    lockstep.publish(topics.TF, make_transform(99, "t0"), "t0")
    assert len(transforms.by_parts) == 3
    assert transforms.by_parts["t0",].stamp_ns == 99
    assert lockstep.counters("localizer") == {"tf/too_many": 6}
    assert transforms.is_full
    transforms.forget(lambda where, _: where == ("t0",))
    assert not transforms.is_full


def test_of_many_commands_the_newest_are_kept(lockstep: Lockstep, listener: Listener):
    commands = listener.watch(dataclasses.replace(topics.COMMAND, max_keys=3))
    for i, source in enumerate("abcadeb"):
        command = VelocityCommand(stamp_ns=1 + i, twist=Twist2D.zero(), valid_for=0.3)
        lockstep.publish(topics.COMMAND, command, source)
    assert sorted(commands.by_parts) == [("b",), ("d",), ("e",)]
    assert commands.by_parts["b",].stamp_ns == 7
    assert lockstep.counters("localizer") == {}


def test_a_watch_of_large_messages_stops_growing(lockstep: Lockstep, listener: Listener):
    size = len(codec.encode(make_transform(1, "a"), "msgpack"))
    transforms = listener.watch(dataclasses.replace(topics.TF, max_kept_bytes=2 * size))
    for child in "abc":
        lockstep.publish(topics.TF, make_transform(1, child), child)
    assert transforms.by_parts.keys() == {("a",), ("b",)}
    lockstep.publish(topics.TF, make_transform(2, "a"), "a")  # in place of what it was
    assert transforms.by_parts["a",].stamp_ns == 2
    transforms.forget(lambda where, _: where == ("a",))
    lockstep.publish(topics.TF, make_transform(1, "c"), "c")
    assert transforms.by_parts.keys() == {("b",), ("c",)}
    assert lockstep.counters("localizer") == {"tf/too_many": 1}


def test_who_draws_reads_markers_and_sees_them_go(lockstep: Lockstep, listener: Listener):
    class Keeper(Service):
        """Keeps markers for late joiners, in memory."""

        name = "tour"

        def __init__(self) -> None:
            self.deleted: list[tuple[str, ...]] = []

        @on_delete(topics.MARKER)
        def delete(self, *parts: str) -> None:
            self.deleted.append(parts)

    marker = Marker(kind="cube")
    keeper = lockstep.add(Keeper())
    keeper.publish(topics.MARKER, marker, "ns", "early")
    watched = listener.watch(topics.MARKER)
    lockstep.run(0.1)
    lockstep.publish(topics.MARKER, marker, "ns", "late")
    lockstep.publish(topics.MARKER, marker, "other", "one")
    assert set(watched.by_parts) == {("ns", "early"), ("ns", "late"), ("other", "one")}
    lockstep.delete("trolley/trolley/markers/ns/late")
    assert set(watched.by_parts) == {("ns", "early"), ("other", "one")}
    lockstep.delete("trolley/trolley/markers/ns/**")
    assert set(watched.by_parts) == {("other", "one")}
    assert keeper.deleted == [("ns", "late"), ("ns", "**")]
    assert lockstep.counters("tour") == {}


@pytest.mark.parametrize("key", ["tf/*", "tf/laser", "**"])
def test_a_stream_cannot_be_deleted(lockstep: Lockstep, listener: Listener, key: str):
    """The mounting of the lidar is said once: whoever forgot it would never hear it again."""
    transforms = listener.watch(topics.TF)
    lockstep.publish(topics.TF, make_transform(1, "laser"), "laser")
    lockstep.delete(f"trolley/trolley/{key}")
    assert set(transforms.by_parts) == {("laser",)}
    assert lockstep.counters("localizer")["tf/key"] == 1


def test_a_watch_that_is_closed_before_it_was_answered_hears_nothing(
    lockstep: Lockstep, listener: Listener
):
    lockstep.publish(topics.POSES, make_places(1))
    heard: list[SavedPoses] = []
    listener.close_watch(listener.watch(topics.POSES, then=heard.append))
    lockstep.run(2.0)
    assert heard == []


def test_a_closed_watch_hears_nothing_more(lockstep: Lockstep, listener: Listener):
    heard: list[Odometry] = []
    odometry = listener.watch(topics.ODOM, then=heard.append)
    lockstep.publish(topics.ODOM, make_odometry(1))
    put_unsettled(lockstep, topics.ODOM, make_odometry(2))
    listener.close_watch(odometry)
    lockstep.publish(topics.ODOM, make_odometry(3))
    assert heard == [make_odometry(1)]


def test_a_name_in_another_form_is_the_same_name(lockstep: Lockstep, listener: Listener):
    """NFD, as macOS types it, and NFC."""
    heard: list[tuple[str, ...]] = []
    listener.watch(topics.SAVED_POSE, then=lambda _pose, *parts: heard.append(parts))
    lockstep.publish(topics.SAVED_POSE, make_place(), "Ku\u0308che")
    assert heard == [("K\u00fcche",)]


def test_a_goal_status_of_an_earlier_run_is_no_measurement(lockstep: Lockstep, listener: Listener):
    """What people asked for outlives a run of base."""
    goals = listener.watch(topics.GOAL)
    lockstep.publish(topics.GOAL, make_goal(1, "a", "paused"))
    lockstep.publish(topics.CLOCK, make_clock(100, epoch=100))
    assert goals.latest == make_goal(1, "a", "paused")


def test_what_a_stranger_says_last_holds_for_a_moment_only(
    lockstep: Lockstep, listener: Listener
) -> None:
    """A flood of maps on a key of the localizer's left the planner on the last of them."""
    speaker = lockstep.add(Speaker())
    own = make_places(1, "kitchen")
    speaker.publish(topics.POSES, own)
    lockstep.run(2.0)
    num_heard = len(listener.places)
    for _ in range(3):
        lockstep.publish(topics.POSES, make_places(2, "elsewhere"))
    lockstep.run(2.0)
    assert listener.places[-1] == own
    assert len(listener.places) == num_heard + 4  # said again once
    assert lockstep.counters("tour")["poses/overwritten"] == 1


def test_what_was_taken_back_is_not_said_again(lockstep: Lockstep, listener: Listener) -> None:
    speaker = lockstep.add(Speaker())
    speaker.publish(topics.POSES, make_places(1, "kitchen"))
    speaker.withdraw(topics.POSES)
    lockstep.publish(topics.POSES, make_places(2, "elsewhere"))
    lockstep.run(2.0)
    assert listener.places[-1] == make_places(2, "elsewhere")
