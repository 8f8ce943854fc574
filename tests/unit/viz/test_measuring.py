"""The panels for engineers: two frames, and a plot of any number."""

import re
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest

from trolley.geometry.frames import BASE, MAP

if TYPE_CHECKING:
    from .conftest import Stage


@pytest.fixture
def panels(stage: "Stage") -> Any:
    stage.browse()
    more = stage.console._more
    return SimpleNamespace(frames=more._relation, plot=more._plot)


def test_distance_bearing_and_age_of_two_frames(stage: "Stage", panels: Any) -> None:
    said = panels.frames._said.content
    for word in ("1.500 m", "180.0° (left is positive)", "-1.500, 0.000, 0.000 m", "Age"):
        assert word in said
    panels.frames._child.value = "laser"
    stage.runtime.run(0.3)
    assert "0.100 m" in panels.frames._said.content


def test_frames_and_places_of_this_map_are_offered(panels: Any) -> None:
    options = panels.frames._child.options
    assert {BASE, MAP, "laser", "odom", "place:kitchen"} <= set(options)
    assert "place:attic" not in options


def test_a_place_is_a_frame(stage: "Stage", panels: Any) -> None:
    panels.frames._parent.value, panels.frames._child.value = MAP, "place:kitchen"
    stage.runtime.run(0.3)
    assert "2.236 m" in panels.frames._said.content


def test_the_missing_link_is_named(stage: "Stage", panels: Any) -> None:
    panels.frames._child.options = ("gripper",)
    stage.runtime.run(0.3)
    assert "tf/gripper" in panels.frames._said.content


def test_links_that_are_too_old_are_told(stage: "Stage", panels: Any) -> None:
    stage.runtime.kill("base")
    stage.runtime.run(3.0)
    assert "has no age: base is not running" in panels.frames._said.content


def test_a_plot_follows_its_topic_only_while_it_is_asked_for(stage: "Stage", panels: Any) -> None:
    plot: Any = panels.plot
    assert plot._readings is None
    plot._choose_topic("odom")
    assert "twist.vx" in plot._fields.options
    assert plot._source.value == "odom:pose.x"
    stage.runtime.run(2.0)
    assert "<polyline" in plot._picture.content
    readings: Any = plot._readings
    assert len(readings._watches) == 1
    plot._source.value = ""
    stage.runtime.run(0.3)
    assert plot._readings is None
    assert plot._picture.content == ""


def test_a_fixed_range_is_kept_to(stage: "Stage", panels: Any) -> None:
    panels.plot._source.value = "odom:pose.x"
    panels.plot._is_fixed.value = True
    panels.plot._low.value, panels.plot._high.value = -4.0, 4.0
    stage.runtime.run(1.0)
    written = re.findall(r">(-?[\d.]+)</text>", panels.plot._picture.content)
    assert written == ["-4", "-2", "0", "2", "4"]


@pytest.mark.parametrize(
    ("source", "says"),
    [("odom:twist.vz", "no field"), ("goal:eta", "No data yet."), ("nonsense", "no topic")],
)
def test_what_cannot_be_plotted_is_told(
    stage: "Stage", panels: Any, source: str, says: str
) -> None:
    panels.plot._source.value = source
    stage.runtime.run(0.5)
    assert says in panels.plot._picture.content


def test_what_is_kept_is_saved_as_a_file(stage: "Stage", panels: Any) -> None:
    files: list[tuple[str, bytes]] = []
    client = SimpleNamespace(
        send_file_download=lambda name, content, **_: files.append((name, content))
    )
    panels.plot._save(client)
    assert files == []
    panels.plot._source.value = "tf:base_link/map:distance"
    stage.runtime.run(1.0)
    panels.plot._save(client)
    ((name, content),) = files
    assert name == "tf-base-link-map-distance.csv"
    assert content.startswith(b"stamp_ns,value\n")
    assert content.endswith(b",1.5\n")


def test_another_robot_s_values_are_not_mixed_in(stage: "Stage", panels: Any) -> None:
    panels.plot._source.value = "odom:pose.x"
    stage.runtime.run(1.0)
    before = panels.plot._readings
    stage.session.follow("kart")
    stage.runtime.run(1.0)
    assert panels.plot._readings is not before
    assert "No data yet." in panels.plot._picture.content


def test_a_browser_that_leaves_follows_nothing(stage: "Stage", panels: Any) -> None:
    panels.plot._source.value = "odom:pose.x"
    stage.runtime.run(0.5)
    stage.viz.close_browser(0)
    assert panels.plot._readings is None
