"""Markers and overlays, kept for viewers that come later."""

import json
from typing import TYPE_CHECKING

import pytest

from trolley import topics
from trolley.messages import Marker, Overlay

if TYPE_CHECKING:
    from .conftest import Home


def keys(home: "Home", pattern: str) -> list[str]:
    replies = home.lockstep.get(f"trolley/trolley/{pattern}")
    return sorted(one.key.removeprefix("trolley/trolley/") for one in replies if not one.is_error)


@pytest.fixture
def drawn(make_home) -> "Home":
    home = make_home()
    for ns, marker_id in [("start", "0"), ("start", "1"), ("goal", "0")]:
        home.lockstep.publish(topics.MARKER, Marker(kind="sphere"), ns, marker_id)
    home.lockstep.publish(topics.OVERLAY, Overlay(kind="text", text="hello"), "greeting")
    return home


def test_late_joiner_gets_all(drawn: "Home"):
    assert keys(drawn, "markers/**") == ["markers/goal/0", "markers/start/0", "markers/start/1"]
    assert keys(drawn, "overlays/*") == ["overlays/greeting"]


@pytest.mark.parametrize(
    ("pattern", "left"),
    [
        ("markers/start/0", ["markers/goal/0", "markers/start/1"]),
        ("markers/start/**", ["markers/goal/0"]),
        ("markers/start/*", ["markers/goal/0"]),
        ("markers/*/0", ["markers/start/1"]),
        ("markers/**", []),
    ],
)
def test_delete_clears_what_it_covers(drawn: "Home", pattern: str, left: list[str]):
    drawn.lockstep.delete(f"trolley/trolley/{pattern}")
    assert keys(drawn, "markers/**") == left
    assert keys(drawn, "overlays/**") == ["overlays/greeting"]


@pytest.mark.parametrize("pattern", ["**", "*/start/0", "*/**", "$*/*", "markers/**", "*/greeting"])
def test_who_draws_and_who_keeps_agree_on_what_is_deleted(drawn: "Home", pattern: str):
    seen = drawn.planner.watch(topics.MARKER), drawn.planner.watch(topics.OVERLAY)
    drawn.lockstep.run(0.1)
    drawn.lockstep.delete(f"trolley/trolley/{pattern}")
    markers, overlays = [sorted("/".join(parts) for parts in one.by_parts) for one in seen]
    assert [f"markers/{one}" for one in markers] == keys(drawn, "markers/**")
    assert [f"overlays/{one}" for one in overlays] == keys(drawn, "overlays/**")


def test_overlays_are_deleted_too(drawn: "Home"):
    drawn.lockstep.delete("trolley/trolley/overlays/**")
    assert keys(drawn, "overlays/**") == []


def test_marker_from_ros_loses_the_slash_of_its_frame(drawn: "Home"):
    drawn.lockstep.publish(topics.MARKER, Marker(kind="cube", frame="/map"), "start", "0")
    (reply,) = drawn.lockstep.get("trolley/trolley/markers/start/0")
    body = json.loads(reply.payload)
    assert (body["frame"], body["kind"]) == ("map", "cube")


def test_marker_ends_after_its_lifetime(drawn: "Home"):
    drawn.lockstep.publish(topics.MARKER, Marker(kind="cube", lifetime=5.0), "brief", "0")
    drawn.lockstep.run(3.0)
    (reply,) = drawn.lockstep.get("trolley/trolley/markers/brief/0")
    assert json.loads(reply.payload)["lifetime"] == pytest.approx(2.0)
    drawn.lockstep.run(2.5)
    assert keys(drawn, "markers/brief/*") == []


def test_bad_drawing_is_counted_and_dropped(drawn: "Home"):
    drawn.lockstep.put("trolley/trolley/markers/start/.x", b'{"kind": "cube"}')
    drawn.lockstep.put("trolley/trolley/markers/start/2", b'{"kind": "pyramid"}')
    drawn.lockstep.put("trolley/trolley/markers/start/3", b'{"kind": "cube", "frame": "/"}')
    counters = drawn.lockstep.counters("tour")
    assert counters["markers/bad_request"] == 2
    assert counters["markers/invalid"] == 1
    assert len(keys(drawn, "markers/**")) == 3


def test_restart_forgets_drawings(drawn: "Home"):
    drawn.restart_tour()
    assert keys(drawn, "markers/**") == []
