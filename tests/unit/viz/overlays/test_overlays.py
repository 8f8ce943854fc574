"""Overlays in the browsers: what is followed and when, what browsers are told, what clicks do."""

import math
from typing import TYPE_CHECKING

import pytest

from trolley import topics
from trolley.geometry import Pose2D
from trolley.messages import Choice, Overlay, OverlayRule, Transform, Twist2D, VelocityCommand
from trolley_tour.service import TourService
from trolley_viz.overlays.cards import Card
from trolley_viz.overlays.pages import Click, File, OverlayUpdate
from trolley_viz.server.messages import Said
from trolley_viz.server.visitors import NOBODY, Visitor

if TYPE_CHECKING:
    from ..conftest import Stage

DISTANCE = "tf:base_link/map:distance"


class Page:
    """A browser's overlays, as its script keeps them."""

    def __init__(self, stage: "Stage", client_id: int = 0, visitor: Visitor = NOBODY) -> None:
        self.stage = stage
        self.browser = stage.browse(client_id, visitor)

    @property
    def told(self) -> list[OverlayUpdate]:
        """All that it was told."""
        updates = [one.overlays for one in self.browser.line.told]
        return [one for one in updates if one is not None]

    @property
    def cards(self) -> dict[str, Card]:
        """What it shows now."""
        cards: dict[str, Card] = {}
        for told in self.told:
            cards |= told.cards
            cards = {name: cards[name] for name in told.order}
        return cards

    @property
    def files(self) -> list[File]:
        """What it was given to save."""
        files = [one.file for one in self.browser.line.told]
        return [one for one in files if one is not None]

    def body(self, name: str) -> str:
        return self.cards[name].body

    def click(self, name: str, index: int) -> None:
        self.stage.say(self.browser, Said(overlay=Click(id=name, index=index)))

    def ask_csv(self, name: str) -> None:
        self.stage.say(self.browser, Said(overlay=Click(id=name, csv=True)))


@pytest.fixture
def page(stage: "Stage") -> Page:
    return Page(stage)


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
    stage.leave(page.browser)
    stage.runtime.run(0.1)
    assert overlays._readings._watches == {}


def test_overlays_that_are_switched_off_follow_nothing(stage: "Stage", page: Page) -> None:
    stage.runtime.add(TourService(stage.config))
    put(stage, Overlay(kind="gauge", source="imu:angular_velocity[2]"))
    stage.session.preferences.switch_layer("overlays", is_on=False)
    stage.runtime.run(0.5)
    assert watched(stage) == set()
    assert page.cards == {}
    stage.session.preferences.switch_layer("overlays", is_on=True)
    stage.runtime.run(0.5)
    assert list(page.cards) == ["one"]


def test_every_message_is_kept_and_the_page_is_told_a_few_times(stage: "Stage", page: Page) -> None:
    put(stage, Overlay(kind="plot", source="cmd_vel/own:twist.vx"))
    reading = stage.scenes["trolley"].overlays._readings.of("cmd_vel/own:twist.vx")
    before, told = len(reading.history), len(page.told)
    for i in range(200):
        command = VelocityCommand(
            stamp_ns=10**12 + i, twist=Twist2D(0.01 * i, 0.0, 0.0), valid_for=0.2
        )
        stage.runtime.publish(topics.COMMAND, command, "own")
        stage.runtime.run(0.01)
    stage.runtime.run(0.3)
    assert len(reading.history) - before == 200
    assert len(page.told) - told <= 13  # five times a second
    assert "1.99" in page.body("one")
    page.ask_csv("one")
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
    page.ask_csv("text")
    stage.runtime.delete(topics.OVERLAY.key("trolley", "mode"))
    stage.runtime.run(0.3)
    page.click("mode", 0)
    stage.runtime.run(0.3)
    assert heard == []
    assert page.files == []


def test_who_may_only_look_chooses_nothing(stage: "Stage", page: Page) -> None:
    heard: list[Choice] = stage.runtime.record(topics.CHOICE)
    guest = Page(stage, 1, Visitor("guest", "viewer"))
    put(stage, Overlay(kind="menu", items=["Sleep"]), "mode")
    put(stage, Overlay(kind="plot", source="odom:twist.vx"), "speed")
    assert page.told[-1].may_choose
    assert not guest.told[-1].may_choose
    guest.click("mode", 0)
    stage.runtime.run(0.3)
    assert heard == []
    guest.ask_csv("speed")
    assert [file.name for file in guest.files] == ["trolley-speed.csv"]
    assert page.files == []


def test_only_what_changed_is_told(stage: "Stage", page: Page) -> None:
    put(stage, Overlay(kind="text", text="still"), "still")
    put(stage, Overlay(kind="gauge", source="clock:rate"), "other")
    told = len(page.told)
    stage.runtime.run(2.0)
    assert len(page.told) == told
    put(stage, Overlay(kind="text", text="moved"), "still")
    assert list(page.told[-1].cards) == ["still"]


def test_a_few_dozen_are_shown_and_the_rest_is_counted(stage: "Stage", page: Page) -> None:
    for i in range(100):
        stage.runtime.publish(topics.OVERLAY, Overlay(kind="text", text=str(i)), f"o{i:03}")
    stage.runtime.run(0.5)
    assert len(page.cards) == 24
    assert page.told[-1].note == "76 more overlays are not shown."


def test_who_looks_later_sees_what_is_kept(stage: "Stage") -> None:
    stage.runtime.add(TourService(stage.config))
    put(stage, Overlay(kind="text", text="kept"))
    assert "kept" in Page(stage).body("one")


def test_a_page_that_comes_back_is_told_all_of_them_again(stage: "Stage", page: Page) -> None:
    put(stage, Overlay(kind="text", text="one"), "one")
    page.browser.line.close()
    stage.runtime.run(0.5)
    put(stage, Overlay(kind="text", text="two"), "two")
    page.browser.line = stage.connect()
    stage.runtime.run(0.5)
    assert list(page.told[0].cards) == ["one", "two"]


def test_a_new_run_of_base_begins_a_new_history(stage: "Stage", page: Page) -> None:
    stage.runtime.add(TourService(stage.config))
    put(stage, Overlay(kind="plot", source="odom:twist.vx"))
    stage.runtime.run(2.0)
    stage.robot.epoch = 10**18
    stage.runtime.run(1.0)
    reading = stage.scenes["trolley"].overlays._readings.of("odom:twist.vx")
    assert 5 <= len(reading.history) <= 12
