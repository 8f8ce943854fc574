"""Sources of overlays: what is understood, what is refused in words, what is read."""

import numpy as np
import pytest
from msgspec import structs
from support.samples import make_odometry, make_scan

from trolley import topics
from trolley.messages import GoalStatus, Health, floats_to_bytes
from trolley.topics import Kind
from trolley_viz.overlays.source import (
    BadSource,
    FieldSource,
    FrameSource,
    fields_of,
    parse_source,
    read_field,
)


def field(text: str) -> FieldSource:
    source = parse_source(text)
    assert isinstance(source, FieldSource)
    return source


@pytest.mark.parametrize(
    ("text", "name", "parts", "path"),
    [
        ("odom:twist.vx", "odom", (), ("twist", "vx")),
        (" /odom:twist.vx ", "odom", (), ("twist", "vx")),
        ("scan:ranges[12]", "scan", (), ("ranges", 12)),
        ("pose:covariance[8]", "pose", (), ("covariance", 8)),
        ("costmap:cells[3][4]", "costmap", (), ("cells", 3, 4)),
        ("particles:poses[0][2]", "particles", (), ("poses", 0, 2)),
        ("tf/laser:pose.x", "tf/{child}", ("laser",), ("pose", "x")),
        ("health/base:counters.a/b", "health/{service}", ("base",), ("counters", "a/b")),
        ("goal:state", "goal", (), ("state",)),
        ("base:battery.fraction", "base", (), ("battery", "fraction")),
        ("zones:zones[0].points[1][0]", "zones", (), ("zones", 0, "points", 1, 0)),
    ],
)  # fmt: skip
def test_fields_are_found(
    text: str, name: str, parts: tuple[str, ...], path: tuple[str | int, ...]
) -> None:
    source = field(text)
    assert (source.topic.name, source.parts, source.path) == (name, parts, path)


@pytest.mark.parametrize(
    ("text", "source"),
    [
        ("tf:base_link/map:distance", FrameSource("base_link", "map", "distance")),
        ("tf:/base_link//map:bearing", FrameSource("base_link", "map", "bearing")),
        ("tf:map/place:kitchen:distance", FrameSource("map", "place:kitchen", "distance")),
    ],
)
def test_two_frames_are_understood(text: str, source: FrameSource) -> None:
    assert parse_source(text) == source


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "There is no topic"),
        ("odom", "Which field of odom? It has pose.x"),
        ("odom:", "Which field of odom?"),
        ("odom:twist.vz", "no field “twist.vz”. It has pose.x, pose.y, pose.yaw, twist.vx"),
        ("odom:pose", "not a single value"),
        ("odom:pose[0]", "no field"),
        ("odom:pose..x", "is not a field"),
        ("odom:.x", "is not a field"),
        ("odom:[0]", "is not a field"),
        ("odom:pose.x[0]", "no field"),
        ("scan:ranges", "not a single value"),
        ("scan:ranges[-1]", "is not a field"),
        ("speed:value", "There is no topic “speed”; there are robot"),
        ("poses/kitchen:pose.x", "There is no topic"),
        ("markers/a/b:z", "There is no topic"),
        ("health/*:cpu", "There is no topic"),
        ("tf:map:distance", "Two frames are written"),
        ("tf:map/:distance", "Two frames are written"),
        ("tf:map/base_link:speed", "Two frames are written"),
        ("x" * 301, "at most 300"),
    ],
)
def test_what_is_not_understood_is_told_in_a_sentence(text: str, says: str) -> None:
    with pytest.raises(BadSource) as problem:
        parse_source(text)
    assert says in str(problem.value)


def test_values_are_read() -> None:
    odometry = make_odometry(1, x=2.5)
    assert read_field(field("odom:pose.x"), odometry) == 2.5
    goal = GoalStatus(stamp_ns=1, id=None, state="driving")
    assert read_field(field("goal:state"), goal) == "driving"
    assert read_field(field("goal:pose.x"), goal) is None
    assert read_field(field("goal:eta"), goal) is None


def test_an_echo_that_did_not_come_back_is_unknown() -> None:
    values = floats_to_bytes(np.array([1.5, np.inf, np.nan]))
    scan = structs.replace(make_scan(1, beams=2), ranges=values)
    read = [read_field(field(f"scan:ranges[{i}]"), scan) for i in range(3)]
    assert read == [1.5, None, None]


def test_what_this_message_does_not_hold_is_named() -> None:
    with pytest.raises(BadSource, match=r"ranges has 4 entries, so there is no \[9\]"):
        read_field(field("scan:ranges[9]"), make_scan(1))
    health = Health(stamp_ns=1, state="ok", message="", counters={"a/b": 3}, cpu=0.1, rss=1)
    assert read_field(field("health/base:counters.a/b"), health) == 3.0
    with pytest.raises(BadSource, match="no “c” now; it has a/b"):
        read_field(field("health/base:counters.c"), health)


@pytest.mark.parametrize("topic", [t for t in topics.TOPICS if t.kind is Kind.STREAM], ids=str)
def test_every_field_that_is_offered_is_understood(topic: topics.Topic) -> None:
    name = topic.name.replace("{", "").replace("}", "")
    for path in fields_of(topic):
        assert field(f"{name}:{path}").topic is topic


@pytest.mark.parametrize(
    ("text", "is_periodic"),
    [
        ("odom:pose.x", True),
        ("pose:match", True),
        ("health/base:cpu", True),
        ("goal:state", False),
        ("particles:weights[0]", False),
        ("tf/ball:pose.x", False),
        ("robot:max_speed", False),
    ],
)
def test_only_what_goes_on_coming_can_fall_silent(text: str, is_periodic: bool) -> None:
    assert field(text).is_periodic == is_periodic
