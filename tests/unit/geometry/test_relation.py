"""Where one frame is in another, of what was heard."""

import math

import pytest

from trolley.geometry import FrameTree, MissingLink, Pose2D
from trolley.geometry.relation import Frames, relation

NOW_NS = 100_000_000_000


def frames(pose_age_s: float = 0.1, now_ns: int | None = NOW_NS) -> Frames:
    tree = FrameTree()
    stamp_ns = NOW_NS - int(pose_age_s * 1e9)
    tree.set("map", "odom", Pose2D(1.0, 0.0, math.pi / 2), stamp_ns)
    tree.set("odom", "base_link", Pose2D(2.0, 0.0, 0.0), NOW_NS - 20_000_000)
    tree.set("base_link", "laser", Pose2D(0.0, 0.0, math.pi), None)
    return Frames(tree, {"laser": 0.2}, now_ns)


def test_distance_bearing_rotation_and_age() -> None:
    found = relation(frames(), "map", "laser")
    assert found.distance == pytest.approx(math.hypot(1.0, 2.0))
    assert found.bearing == pytest.approx(math.atan2(2.0, 1.0))
    assert found.translation == pytest.approx([1.0, 2.0, 0.2])
    assert found.yaw == pytest.approx(-math.pi / 2)
    assert found.rotation == pytest.approx([0.0, 0.0, -math.sqrt(0.5), math.sqrt(0.5)])
    assert found.age == pytest.approx(0.1)
    assert found.stale == []


def test_bearings_to_the_right_are_negative() -> None:
    tree = FrameTree()
    tree.set("base_link", "ball", Pose2D(1.0, -1.0, 0.0), NOW_NS)
    found = relation(Frames(tree, {}, NOW_NS), "base_link", "ball")
    assert found.bearing == pytest.approx(-math.pi / 4)


def test_an_old_link_of_the_robot_s_motion_is_named_with_its_age() -> None:
    found = relation(frames(pose_age_s=3.5), "map", "base_link")
    assert found.stale == ["map -> odom is 3.5 s old"]


def test_without_robot_time_nothing_has_an_age() -> None:
    found = relation(frames(now_ns=None), "map", "base_link")
    assert found.age is None
    assert "base is not running" in found.stale[0]


def test_a_mounting_is_never_old() -> None:
    found = relation(frames(pose_age_s=1000.0, now_ns=None), "base_link", "laser")
    assert (found.age, found.stale) == (None, [])


def test_a_missing_link_is_named() -> None:
    tree = frames()
    tree.tree.remove("odom")
    with pytest.raises(MissingLink) as missing:
        relation(tree, "map", "laser")
    assert missing.value.missing == "odom"
