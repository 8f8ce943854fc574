"""What Foxglove is shown of Trolley's messages, read back from its own bytes."""

import json
import math
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs
from support.cases import cases
from support.foxglove_client import fields
from support.samples import make_odometry, make_place, make_robot, make_transform
from support.strategies import instances_of

from trolley import topics
from trolley.foxglove.views import CHANNELS, MARKERS, Views, plain_schema
from trolley.geometry import Pose2D
from trolley.messages import (
    Health,
    Marker,
    OccupancyGrid,
    Path,
    PoseEstimate,
    SavedPoses,
    Scan,
    Transform,
    floats_to_bytes,
)
from trolley.topics import Kind, Topic

STAMP_NS = 1_700_000_000_250_000_000
SHOWN: list[Topic[Any]] = [
    topic
    for topic in topics.TOPICS
    if topic.kind is Kind.STREAM or topic in (topics.MARKER, topics.OVERLAY)
]


def seen(topic: Topic[Any], message: Any, *parts: str) -> dict[str, bytes]:
    return dict(Views("one").of(topic, parts, message, STAMP_NS))


def double(data: bytes) -> float:
    return struct.unpack("<d", data)[0]


def doubles(data: bytes) -> list[float]:
    return list(struct.unpack(f"<{len(data) // 8}d", data))


def numbers(data: bytes) -> dict[int, float]:
    """The double fields of a message; one that is zero is not sent."""
    return {number: double(values[0]) for number, values in fields(data).items()}


def check_stamp(data: bytes) -> None:
    assert fields(data) == {1: [1_700_000_000], 2: [250_000_000]}


def check_pose(data: bytes, x: float, y: float, yaw: float) -> None:
    position, orientation = fields(data)[1][0], fields(data)[2][0]
    assert numbers(position).get(1, 0.0) == pytest.approx(x)
    assert numbers(position).get(2, 0.0) == pytest.approx(y)
    found = numbers(orientation)
    assert 2.0 * math.atan2(found.get(3, 0.0), found.get(4, 0.0)) == pytest.approx(yaw)


def test_a_scan_keeps_its_angles_and_what_is_no_echo() -> None:
    ranges = np.array([1.5, np.inf, 0.0, 2.5], dtype=np.float32)
    scan = Scan(
        stamp_ns=STAMP_NS,
        frame="laser",
        angle_min=-1.0,
        angle_increment=0.5,
        time_increment=0.001,
        range_min=0.1,
        range_max=8.0,
        ranges=floats_to_bytes(ranges),
    )
    found = fields(seen(topics.SCAN, scan)["scan"])
    check_stamp(found[1][0])
    assert found[2] == [b"one/laser"]
    assert (double(found[4][0]), double(found[5][0])) == (-1.0, 0.5)
    back = doubles(found[6][0])
    assert back[:2] == [1.5, math.inf]
    assert math.isnan(back[2])
    assert back[3] == 2.5


def test_bytes_that_are_no_numbers_are_no_trouble() -> None:
    scan = Scan(
        stamp_ns=STAMP_NS,
        frame="laser",
        angle_min=0.0,
        angle_increment=0.5,
        time_increment=0.0,
        range_min=0.1,
        range_max=8.0,
        ranges=memoryview(struct.pack("<I", 0x7F800001)),  # a signalling NaN
    )
    (value,) = doubles(fields(seen(topics.SCAN, scan)["scan"])[6][0])
    assert math.isnan(value)


def test_a_grid_lies_where_the_map_lies() -> None:
    cells = np.array([[0, 100, -1], [50, 99, 0]], dtype=np.int8)
    grid = OccupancyGrid(
        stamp_ns=STAMP_NS,
        name="home",
        frame="map",
        resolution=0.05,
        width=3,
        height=2,
        origin=Pose2D(-1.0, -2.0, 0.3),
        cells=memoryview(cells.tobytes()),
    )
    for topic, name in ((topics.MAP, "map"), (topics.COSTMAP_GLOBAL, "costmap/global")):
        found = fields(seen(topic, grid)[name])
        assert found[2] == [b"one/map"]
        check_pose(found[3][0], -1.0, -2.0, 0.3)
        assert int.from_bytes(found[4][0], "little") == 3
        assert numbers(found[5][0]) == {1: 0.05, 2: 0.05}
        assert int.from_bytes(found[6][0], "little") == 3
        assert int.from_bytes(found[7][0], "little") == 1
        assert found[9] == [cells.tobytes()]


def test_a_path_is_its_poses() -> None:
    poses = np.array([[1.0, 2.0, 0.5], [1.5, 2.0, -0.5]])
    path = Path(stamp_ns=STAMP_NS, frame="map", poses=floats_to_bytes(poses))
    for topic, name in ((topics.PATH, "path"), (topics.TRAJECTORY, "trajectory")):
        found = fields(seen(topic, path)[name])
        check_stamp(found[1][0])
        for data, row in zip(found[3], poses, strict=True):
            check_pose(data, *row)


def test_frames_are_told_from_transforms_and_from_odometry() -> None:
    laser = Transform(
        stamp_ns=STAMP_NS, parent="base_link", child="laser", pose=Pose2D(0.1, 0.0, 1.0), z=0.2
    )
    (data,) = fields(seen(topics.TF, laser, "laser")["tf"])[1]
    found = fields(data)
    assert (found[2], found[3]) == ([b"one/base_link"], [b"one/laser"])
    assert numbers(found[4][0]) == {1: 0.1, 3: 0.2}
    odometry = make_odometry(STAMP_NS, 2.0)
    (data,) = fields(seen(topics.ODOM, odometry)["tf"])[1]
    found = fields(data)
    assert (found[2], found[3]) == ([b"one/odom"], [b"one/base_link"])
    assert numbers(found[4][0]) == {1: 2.0}
    # What base answers to `get tf/base_link` may be old: the odometry says it.
    assert seen(topics.TF, make_transform(1, "base_link", "odom"), "base_link") == {}


def test_a_pose_is_shown_once_it_is_known() -> None:
    known = PoseEstimate(
        stamp_ns=STAMP_NS,
        map="home",
        pose=Pose2D(1.0, 2.0, 0.5),
        covariance=[0.0] * 9,
        state="localized",
        match=0.9,
        spread=0.0,
    )
    found = seen(topics.POSE, known)
    check_pose(fields(found["pose"])[3][0], 1.0, 2.0, 0.5)
    assert json.loads(found["pose/estimate"])["match"] == 0.9
    unknown = PoseEstimate(
        stamp_ns=1, map=None, pose=None, covariance=None, state="searching", match=0, spread=0
    )
    assert list(seen(topics.POSE, unknown)) == ["pose/estimate"]


def test_plots_find_the_varying_part_of_the_key() -> None:
    found = seen(topics.HEALTH, Health(stamp_ns=1, state="ok", cpu=0.5), "base")
    assert json.loads(found["health"])["service"] == "base"
    assert json.loads(found["health"])["cpu"] == 0.5
    assert plain_schema(topics.HEALTH)["properties"]["service"] == {"type": "string"}


def test_places_of_other_maps_are_not_shown() -> None:
    views = Views("one")
    places = SavedPoses(stamp_ns=1, poses=[make_place("a"), make_place("b")])
    (name, data), _ = views.of(topics.POSES, (), places, 1)
    assert name == "scene/places"
    assert len(fields(fields(data)[2][0])[13]) == 2
    grid = OccupancyGrid(
        stamp_ns=1,
        name="other",
        frame="map",
        resolution=0.1,
        width=1,
        height=1,
        origin=Pose2D.identity(),
        cells=memoryview(b"\0"),
    )
    for data in (
        dict(views.of(topics.MAP, (), grid, 1))["scene/places"],  # nobody sends the places again
        dict(views.of(topics.POSES, (), places, 1))["scene/places"],
    ):
        assert 13 not in fields(fields(data)[2][0])
    assert "scene/places" not in dict(views.of(topics.MAP, (), grid, 1))


def test_deleted_markers_go() -> None:
    views = Views("one")
    for name in ("a", "b", "c"):
        list(views.of(topics.MARKER, ("ns", name), Marker(kind="cube"), 1))
    ((channel, data),) = views.without("trolley/one/markers/ns/a", 2)
    assert channel == MARKERS
    assert [fields(one)[3] for one in fields(data)[1]] == [[b"one/ns/a"]]
    assert list(views.without("trolley/one/markers/ns/a", 3)) == []
    ((_, data),) = views.without("trolley/one/markers/**", 4)
    assert [fields(one)[3] for one in fields(data)[1]] == [[b"one/ns/b"], [b"one/ns/c"]]


def test_a_mesh_is_nothing_to_plot() -> None:
    robot = structs.replace(make_robot(), mesh=bytes(1 << 20))
    assert len(seen(topics.ROBOT, robot)["robot"]) < 500


@pytest.mark.parametrize("topic", SHOWN, ids=lambda topic: topic.name)
@settings(max_examples=cases(40), deadline=None)
@given(data=st.data())
def test_whatever_is_valid_can_be_shown(topic: Topic[Any], data: st.DataObject) -> None:
    message = data.draw(instances_of(topic.message))
    parts = ("one", "two")[: topic.num_parts]
    for name, shown in seen(topic, message, *parts).items():
        assert topic in CHANNELS[name].topics
        if CHANNELS[name].encoding == "json":
            plain = json.loads(shown)
            schema = json.loads(CHANNELS[name].schema.data)
            check_schema(plain, schema)
        else:
            fields(shown)


def check_schema(value: Any, schema: dict[str, Any]) -> None:
    """That a value is what its schema says, or null; the schema has no word for null."""
    kinds: dict[str, Any] = {
        "object": dict,
        "array": list,
        "string": str,
        "boolean": bool,
        "integer": int,
        "number": int | float,
    }
    if value is None:
        return
    assert isinstance(value, kinds[schema["type"]])
    if isinstance(value, dict) and "properties" in schema:
        assert value.keys() <= schema["properties"].keys()
        for name, inner in value.items():
            check_schema(inner, schema["properties"][name])
    if isinstance(value, list):
        for inner in value:
            check_schema(inner, schema["items"])
