"""Overlays in the browsers: what is followed and when, what browsers are told, what clicks do."""

import math
from typing import TYPE_CHECKING, Any

import pytest

from trolley import topics
from trolley.geometry import Pose2D
from trolley.messages import Choice, Overlay, OverlayRule, Transform, Twist2D, VelocityCommand
from trolley_tour.service import TourService
from trolley_viz.overlays.pages import Click, OverlayUpdate

if TYPE_CHECKING:
    from .conftest import Stage

DISTANCE = "tf:base_link/map:distance"


class Page:
    """A browser's overlays, as its script keeps them."""

    def __init__(self, stage: "Stage", monkeypatch: pytest.MonkeyPatch) -> None:
        self.stage = stage
        self.cards: dict[str, Any] = {}
        self.last = OverlayUpdate()
        self.num_told = 0
        self.may_act = True
        self.files: list[Any] = []
        sockets = stage.viz.overlays.sockets
        monkeypatch.setattr(sockets, "clients", lambda: {7: 0})
        monkeypatch.setattr(sockets, "send", self._take)
        monkeypatch.setattr(sockets, "may_act", lambda who: self.may_act)

    def _take(self, who: int, told: OverlayUpdate) -> None:
        self.num_told += 1
        if told.csv is not None:
            self.files.append(told.csv)
            return
        self.last = told
        self.cards |= told.cards
        self.cards = {name: self.cards[name] for name in told.order}

    def body(self, name: str) -> str:
        return self.cards[name].body

    def click(self, name: str, index: int) -> None:
        self.stage.viz.overlays._said(7, 0, Click(id=name, index=index))


@pytest.fixture
def page(stage: "Stage", monkeypatch: pytest.MonkeyPatch) -> Page:
    stage.browse()
    return Page(stage, monkeypatch)


def put(stage: "Stage", overlay: Overlay, name: str = "one") -> None:
    stage.runtime.publish(topics.OVERLAY, overlay, name)
    stage.runtime.run(0.5)


def watched(stage: "Stage") -> set[str]:
    return {name for name, _ in stage.scenes["trolley"].overlays._readings._watches}


def test_a_stream_is_followed_only_while_an_overlay_needs_it(stage: "Stage", page: Page) -> None:
    assert watched(stage) == set()
    put(stage, Overlay(kind="gauge", source="imu:angular_velocity[2]"))
    assert watched(stage) == {"imu"}
    put(stage, Overlay(kind="plot", source="imu:angular_velocity[1]"), "two")
    assert watched(stage) == {"imu"}
    stage.runtime.delete(topics.OVERLAY.key("trolley", "one"))
    stage.runtime.run(0.5)
    assert watched(stage) == {"imu"}
    assert list(page.cards) == ["two"]
    overlays = stage.scenes["trolley"].overlays
    stage.viz.close_browser(0)
    assert overlays._readings._watches == {}


def test_overlays_that_are_switched_off_follow_nothing(stage: "Stage", page: Page) -> None:
    stage.runtime.add(TourService(stage.config))
    put(stage, Overlay(kind="gauge", source="imu:angular_velocity[2]"))
    stage.session.switch_layer("overlays", is_on=False)
    stage.runtime.run(0.5)
    assert watched(stage) == set()
    assert page.cards == {}
    stage.session.switch_layer("overlays", is_on=True)
    stage.runtime.run(0.5)
    assert list(page.cards) == ["one"]


def test_every_message_is_kept_and_the_page_is_told_a_few_times(stage: "Stage", page: Page) -> None:
    put(stage, Overlay(kind="plot", source="cmd_vel/own:twist.vx"))
    reading = stage.scenes["trolley"].overlays._readings.of("cmd_vel/own:twist.vx")
    before, told = len(reading.history), page.num_told
    for i in range(200):
        command = VelocityCommand(
            stamp_ns=10**12 + i, twist=Twist2D(0.01 * i, 0.0, 0.0), valid_for=0.2
        )
        stage.runtime.publish(topics.COMMAND, command, "own")
        stage.runtime.run(0.01)
    stage.runtime.run(0.3)
    assert len(reading.history) - before == 200
    assert page.num_told - told <= 13  # five times a second
    assert "1.99" in page.body("one")
    stage.viz.overlays._said(7, 0, Click(id="one", csv=True))
    (file,) = page.files
    assert file.name == "trolley-one.csv"
    assert file.text.splitlines()[-1] == f"{10**12 + 199},1.99"


def test_the_plot_of_a_topic_that_dies_says_so(stage: "Stage", page: Page) -> None:
    put(stage, Overlay(kind="plot", source="odom:twist.vx", unit="m/s"))
    assert "0.00 m/s" in page.body("one")
    assert "No data" not in page.body("one")
    stage.runtime.kill("base")
    stage.runtime.run(5.0)
    assert "No data for 5 s." in page.body("one")


def test_distance_and_bearing_of_two_frames(stage: "Stage", page: Page) -> None:
    rules = [
        OverlayRule(bearing_min=math.pi / 10, bearing_max=-math.pi / 10, text="OtherWayRound"),
        OverlayRule(distance_min=1.0, text="CloseBy"),
    ]
    put(stage, Overlay(kind="text", source=DISTANCE, text="{distance}, {bearing}"), "text")
    menu = Overlay(kind="menu", source=DISTANCE, items=["CloseBy", "OtherWayRound"], rules=rules)
    put(stage, menu, "menu")
    assert "1.50 m, 180°" in page.body("text")
    assert 'aria-pressed="true">OtherWayRound' in page.body("menu")
    put(stage, Overlay(kind="gauge", source="tf:map/place:kitchen:distance"), "kitchen")
    assert ">2.24<" in page.body("kitchen")


def test_a_missing_link_is_named_and_found_later(stage: "Stage", page: Page) -> None:
    put(stage, Overlay(kind="gauge", source="tf:base_link/ball:bearing", unit="°"))
    assert "nothing is known of &#x27;ball&#x27; yet" in page.body("one")
    link = Transform(stamp_ns=0, parent="base_link", child="ball", pose=Pose2D(1.0, -1.0, 0.0))
    stage.runtime.publish(topics.TF, link, "ball")
    stage.runtime.run(0.5)
    assert ">-45.0°<" in page.body("one")
    assert "ball" not in page.body("one")


def test_a_robot_that_is_gone_leaves_its_last_distance_with_its_age(
    stage: "Stage", page: Page
) -> None:
    put(stage, Overlay(kind="text", source=DISTANCE))
    stage.runtime.kill("base")
    stage.runtime.run(6.0)
    assert "1.50" in page.body("one")
    assert "No data for" in page.body("one")


@pytest.mark.parametrize(
    ("source", "says"),
    [
        ("odom:twist.vz", "odom has no field “twist.vz”. It has pose.x"),
        ("nothing:x", "There is no topic “nothing”"),
        ("scan:ranges[99]", "ranges has 4 entries, so there is no [99]."),
        ("", "There is no topic"),
        ("<img src=x onerror=alert(1)>", "&lt;img src=x"),
    ],
)
def test_a_source_that_is_not_there_is_told(
    stage: "Stage", page: Page, source: str, says: str
) -> None:
    put(stage, Overlay(kind="plot", source=source))
    assert says in page.body("one")


def test_a_click_on_a_menu_is_published_under_the_robot(stage: "Stage", page: Page) -> None:
    heard = stage.runtime.record(topics.CHOICE, "mode")
    put(stage, Overlay(kind="menu", items=["Sleep", "Searching"]), "mode")
    page.click("mode", 1)
    stage.runtime.run(0.3)
    (choice,) = heard
    assert (choice.index, choice.item) == (1, "Searching")
    assert choice.stamp_ns > 0
    assert 'aria-pressed="true">Searching' in page.body("mode")


def test_a_click_on_what_is_not_there_is_nothing(stage: "Stage", page: Page) -> None:
    heard: list[Choice] = stage.runtime.record(topics.CHOICE)
    put(stage, Overlay(kind="menu", items=["Sleep"]), "mode")
    put(stage, Overlay(kind="text", text="x"), "text")
    for name, index in (("mode", 1), ("mode", -1), ("text", 0), ("gone", 0)):
        page.click(name, index)
    stage.viz.overlays._said(7, 0, Click(id="text", csv=True))
    stage.viz.overlays._said(7, 99, Click(id="mode", index=0))  # no such browser
    stage.runtime.delete(topics.OVERLAY.key("trolley", "mode"))
    stage.runtime.run(0.3)
    page.click("mode", 0)
    stage.runtime.run(0.3)
    assert heard == []
    assert page.files == []


def test_who_may_only_look_chooses_nothing(stage: "Stage", page: Page) -> None:
    heard: list[Choice] = stage.runtime.record(topics.CHOICE)
    page.may_act = False
    put(stage, Overlay(kind="menu", items=["Sleep"]), "mode")
    assert not page.last.may_choose
    page.click("mode", 0)
    stage.runtime.run(0.3)
    assert heard == []


def test_only_what_changed_is_told(stage: "Stage", page: Page) -> None:
    put(stage, Overlay(kind="text", text="still"), "still")
    put(stage, Overlay(kind="gauge", source="clock:rate"), "other")
    told = page.num_told
    stage.runtime.run(2.0)
    assert page.num_told == told
    put(stage, Overlay(kind="text", text="moved"), "still")
    assert list(page.last.cards) == ["still"]


def test_a_few_dozen_are_shown_and_the_rest_is_counted(stage: "Stage", page: Page) -> None:
    for i in range(100):
        stage.runtime.publish(topics.OVERLAY, Overlay(kind="text", text=str(i)), f"o{i:03}")
    stage.runtime.run(0.5)
    assert len(page.cards) == 24
    assert page.last.note == "76 more overlays are not shown."


def test_who_looks_later_sees_what_is_kept(stage: "Stage", monkeypatch: pytest.MonkeyPatch) -> None:
    stage.runtime.add(TourService(stage.config))
    put(stage, Overlay(kind="text", text="kept"))
    stage.browse()
    page = Page(stage, monkeypatch)
    stage.runtime.run(0.5)
    assert "kept" in page.body("one")


def test_a_new_run_of_base_begins_a_new_history(stage: "Stage", page: Page) -> None:
    stage.runtime.add(TourService(stage.config))
    put(stage, Overlay(kind="plot", source="odom:twist.vx"))
    stage.runtime.run(2.0)
    stage.robot.epoch = 10**18
    stage.runtime.run(1.0)
    reading = stage.scenes["trolley"].overlays._readings.of("odom:twist.vx")
    assert 5 <= len(reading.history) <= 12
