"""The panels for engineers: two frames, and a plot of any number."""

import re
from typing import TYPE_CHECKING, Any

import pytest
from support.pages import PageOf, page_of

from trolley.geometry.frames import BASE, MAP
from trolley_viz.overlays.readings import Readings
from trolley_viz.session.session import Session

if TYPE_CHECKING:
    from ...conftest import Stage


@pytest.fixture
def frames(stage: "Stage") -> PageOf:
    stage.browse()
    return page_of(stage).within("Distance and angle")


@pytest.fixture
def plot(stage: "Stage") -> PageOf:
    stage.browse()
    return page_of(stage).within("Plot")


def test_distance_bearing_and_age_of_two_frames(stage: "Stage", frames: PageOf) -> None:
    said = frames.text()
    for word in ("1.500 m", "180.0° (left is positive)", "-1.500, 0.000, 0.000 m", "Age"):
        assert word in said
    frames.choose("To", "laser")
    stage.runtime.run(0.3)
    assert "0.100 m" in frames.text()


def test_frames_and_places_of_this_map_are_offered(frames: PageOf) -> None:
    options = frames.options("To")
    assert {BASE, MAP, "laser", "odom", "place:kitchen"} <= set(options)
    assert "place:attic" not in options


def test_a_place_is_a_frame(stage: "Stage", frames: PageOf) -> None:
    frames.choose("From", MAP)
    frames.choose("To", "place:kitchen")
    stage.runtime.run(0.3)
    assert "2.236 m" in frames.text()


def test_the_missing_link_is_named(stage: "Stage", frames: PageOf) -> None:
    frames.choose("To", "laser")
    stage.session.follow("kart")  # of which nothing is known
    stage.runtime.run(0.5)
    assert "tf/laser" in frames.text()
    assert frames.value("To") == "laser"


def test_links_that_are_too_old_are_told(stage: "Stage", frames: PageOf) -> None:
    stage.runtime.kill("base")
    stage.runtime.run(3.0)
    assert "has no age: base is not running" in frames.text()


@pytest.fixture
def followed(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The topics that plots follow."""
    topics = list[str]()

    def open_watch(topic: Any, *_: Any) -> Any:
        topics.append(topic.name)
        return topic.name

    readings = lambda *_: Readings(open_watch, topics.remove, lambda: 0)  # type: ignore[arg-type] # noqa: E731
    monkeypatch.setattr("trolley_viz.tabs.more_tab.follow_values", readings)
    return topics


def test_a_plot_follows_its_topic_only_while_it_is_asked_for(
    followed: list[str], stage: "Stage", plot: PageOf
) -> None:
    assert followed == []
    plot.type("Value", "odom:pose.x")
    stage.runtime.run(0.5)
    assert followed == ["odom"]
    plot.type("Value", "")
    stage.runtime.run(0.5)
    assert followed == []


def test_a_browser_that_leaves_follows_nothing(
    followed: list[str], stage: "Stage", plot: PageOf
) -> None:
    plot.type("Value", "odom:pose.x")
    stage.runtime.run(0.5)
    stage.leave(stage.browsers[0])
    stage.runtime.run(29.0)
    assert followed == ["odom"]  # it may come back
    stage.runtime.run(2.0)
    assert followed == []


def test_a_topic_and_its_field_are_chosen(stage: "Stage", plot: PageOf) -> None:
    assert plot.options("Field") == ("choose",)
    plot.choose("Topic", "odom")
    assert "twist.vx" in plot.options("Field")
    assert plot.value("Value") == "odom:pose.x"
    plot.choose("Field", "pose.y")
    assert plot.value("Value") == "odom:pose.y"
    stage.runtime.run(2.0)
    assert "<polyline" in plot.html()
    plot.type("Value", "")
    stage.runtime.run(0.3)
    assert plot.html() == ""
    plot.choose("Topic", "choose")
    assert plot.options("Field") == ("choose",)


def test_a_fixed_range_is_kept_to(stage: "Stage", plot: PageOf) -> None:
    plot.type("Value", "odom:pose.x")
    plot.tick("Fixed range")
    plot.type("From", -4.0)
    plot.type("Up to", 4.0)
    stage.runtime.run(1.0)
    written = re.findall(r">(-?[\d.]+)</text>", plot.html())
    assert written == ["-4", "-2", "0", "2", "4"]


@pytest.mark.parametrize(
    ("source", "says"),
    [("odom:twist.vz", "no field"), ("tour:lap", "No data yet."), ("nonsense", "no topic")],
)
def test_what_cannot_be_plotted_is_told(
    stage: "Stage", plot: PageOf, source: str, says: str
) -> None:
    plot.type("Value", source)
    stage.runtime.run(0.5)
    assert says in plot.text()


def test_what_is_kept_is_saved_as_a_file(stage: "Stage", monkeypatch: pytest.MonkeyPatch) -> None:
    files: list[tuple[str, str]] = []
    monkeypatch.setattr(Session, "save_file", lambda _, name, text: files.append((name, text)))
    stage.browse()
    plot = page_of(stage).within("Plot")
    plot.press("Save as CSV")
    assert files == []
    plot.type("Value", "tf:base_link/map:distance")
    stage.runtime.run(1.0)
    plot.press("Save as CSV")
    ((name, text),) = files
    assert name == "tf-base-link-map-distance.csv"
    assert text.startswith("stamp_ns,value\n")
    assert text.endswith(",1.5\n")


def test_another_robot_s_values_are_not_mixed_in(stage: "Stage", plot: PageOf) -> None:
    plot.type("Value", "odom:pose.x")
    stage.runtime.run(1.0)
    stage.session.follow("kart")
    stage.runtime.run(1.0)
    assert "No data yet." in plot.text()
