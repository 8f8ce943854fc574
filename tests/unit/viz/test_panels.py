"""The controls and their markup."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from support.pages import page_of

from trolley import requests, topics
from trolley.geometry import Pose2D
from trolley.messages import MappingStatus
from trolley.messages.request_params import JoinPart, MapNamed, Nothing, PauseMap, SaveMap
from trolley.runtime.service import Service, answers
from trolley_viz.controls.markup import (
    card,
    details,
    note,
    numbered,
    row,
    sentence,
    swatches,
    table,
    title,
)
from trolley_viz.graphics.camera import FIELD_OF_VIEW, stand
from trolley_viz.graphics.icons import icon_names
from trolley_viz.pointing.pointer import Pointed
from trolley_viz.robots.fleet import Robots
from trolley_viz.robots.stop_presses import StopLine, StopPresses
from trolley_viz.scene.scan_and_particles import stroke_colours
from trolley_viz.words.sentences import StatusLine

if TYPE_CHECKING:
    from .conftest import Stage

EVIL = "<img src=x onerror=alert(1)>"


def test_names_from_the_wire_cannot_carry_markup() -> None:
    words = StatusLine(EVIL, "good", EVIL)
    for text in (
        row(words),
        sentence(words),
        details(words, ""),
        note(EVIL),
        title(EVIL),
        card(EVIL, EVIL),
        numbered([EVIL]),
        table([(EVIL, EVIL)]),
        swatches([(EVIL, (0, 0, 0))]),
    ):
        assert "<img" not in text
        assert "&lt;img" in text


def test_every_icon_is_there(stage: "Stage") -> None:
    stage.browse()
    icons = {control.look.icon for control in stage.page().controls.all.values()}
    assert icons - {""} <= icon_names()


def test_nothing_has_a_style_of_its_own(stage: "Stage") -> None:
    """The page's policy forbids it."""
    stage.browse()
    assert "style" not in page_of(stage).html()


def test_colours_of_a_legend_are_for_the_script() -> None:
    assert swatches([("mirror", (0, 170, 205))]) == (
        '<div class="swatch"><i data-colour="#00aacd"></i>mirror</div>'
    )


class Mapper(Service):
    """Begins a map and gives it up."""

    name = "mapper"

    loose, may_discard = 0, True
    extends: str | None = None

    def start(self) -> None:
        self.joined: list[Pose2D] = []
        self.saved: list[str | None] = []
        self.say("idle")

    def say(self, state: Any, name: str | None = None) -> MappingStatus:
        status = MappingStatus(
            stamp_ns=self.stamp_ns,
            state=state,
            name=name,
            extends=self.extends,
            loose=self.loose,
            may_discard=self.may_discard and state != "idle",
        )
        self.publish(topics.MAPPING, status)
        return status

    @answers(requests.MAP_NEW)
    def begin(self, params: MapNamed) -> MappingStatus:
        return self.say("mapping", params.name)

    @answers(requests.MAP_PAUSE)
    def pause(self, params: PauseMap) -> MappingStatus:
        return self.say("paused" if params.on else "mapping", "flat")

    @answers(requests.MAP_SAVE)
    def store(self, params: SaveMap) -> MappingStatus:
        self.saved.append(params.name)
        return self.say("saving", "flat")

    @answers(requests.MAP_JOIN)
    def join(self, params: JoinPart) -> MappingStatus:
        self.joined.append(params.pose)
        return self.say("mapping", "flat")

    @answers(requests.MAP_DROP)
    def drop(self, _: Nothing) -> MappingStatus:
        self.loose = 0
        return self.say("mapping", "flat")

    @answers(requests.MAP_CANCEL)
    def give_up(self, _: Nothing) -> MappingStatus:
        return self.say("idle")


def test_a_map_is_begun_paused_and_given_up_at_the_second_press(stage: "Stage") -> None:
    stage.browse()
    page = page_of(stage).within("Make a map")
    assert "The mapper is not running" in page.text()
    assert page.labels == []
    stage.runtime.add(Mapper())
    stage.runtime.run(0.5)
    assert page.labels == ["Map name", "New map", "Extend this map"]
    page.type("Map name", " flat ")
    page.press("New map")
    stage.runtime.run(0.5)
    assert "Mapping “flat”" in page.text()
    assert not page.is_shown("New map")
    page.press("Pause")
    stage.runtime.run(0.5)
    assert page.is_shown("Continue")
    page.press("Discard")
    stage.runtime.run(0.5)
    assert page.button("Really discard it?").colour == "amber"
    page.press("Really discard it?")
    stage.runtime.run(0.5)
    assert page.is_shown("New map")


def test_an_extended_map_can_be_saved_under_another_name(stage: "Stage") -> None:
    """The map that robot.toml names is never overwritten, so there is no other way to save it."""
    stage.browse()
    page = page_of(stage).within("Make a map")
    mapper = stage.runtime.add(Mapper())
    for mapper.extends, typed in ((None, ""), ("flat", ""), ("flat", "flat 2"), ("flat", "flat-2")):
        mapper.say("mapping", "flat")
        stage.runtime.run(0.5)
        assert page.is_shown("Map name") == bool(mapper.extends)
        if typed:
            page.type("Map name", typed)
        page.press("Save map")
        stage.runtime.run(0.5)
    assert mapper.saved == [None, "flat", "flat-2"]
    mapper.say("mapping", "flat")  # the disk was full
    stage.runtime.run(0.5)
    page.press("Save map")
    stage.runtime.run(0.5)
    assert mapper.saved[3:] == ["flat-2"]  # and not over the old one


def test_what_is_being_saved_is_discarded_only_where_the_mapper_obeys(stage: "Stage") -> None:
    stage.browse()
    page = page_of(stage).within("Make a map")
    mapper = stage.runtime.add(Mapper())
    for mapper.may_discard, shown in ((False, []), (True, ["Discard"])):
        mapper.say("saving", "flat")
        stage.runtime.run(0.5)
        assert page.labels == shown


@pytest.mark.parametrize("state", ["starting", "mapping", "paused"])
def test_a_map_is_discarded_on_a_robot_of_release_0_2_0(stage: "Stage", state: str) -> None:
    """Its mapper never says `may_discard`."""
    stage.browse()
    page = page_of(stage).within("Make a map")
    mapper = stage.runtime.add(Mapper())
    mapper.may_discard = False
    mapper.say(state, "flat")
    stage.runtime.run(0.5)
    assert page.is_shown("Discard")


def test_what_hangs_loose_is_joined_by_pointing_or_removed(stage: "Stage") -> None:
    stage.browse()
    page = page_of(stage).within("Make a map")
    mapper = stage.runtime.add(Mapper())
    mapper.loose = 1
    mapper.say("mapping", "flat")
    stage.runtime.run(0.5)
    assert "1 scan hangs loose." in page.text()
    mapper.loose = 14
    mapper.say("mapping", "flat")
    stage.runtime.run(0.5)
    assert "14 scans hang loose." in page.text()
    page.press("Set pose …")
    stage.runtime.run(0.5)
    assert page.is_shown("Press again to cancel")
    stage.session.aiming.set_pose(Pointed(1.2, 0.4, 0.5))
    stage.runtime.run(0.5)
    assert mapper.joined == [Pose2D(1.2, 0.4, 0.5)]
    assert stage.robot.poses_set == []
    page.press("Remove loose part")
    stage.runtime.run(0.5)
    assert not page.is_shown("Remove loose part")
    assert not page.is_shown("Set pose …")
    assert "loose" not in page.text()


def test_stop_is_one_press_whatever_how_often_it_is_pressed() -> None:
    asked: list[str] = []
    presses = StopPresses(lambda robot, answer: asked.append(robot))
    presses.press("a", 0)
    presses.press("b", 0)
    presses.tick(10**8)
    assert asked == ["a", "b"]
    assert presses.line("a", 10**8) == StopLine("Stopping …", is_alarm=False)
    assert presses.line("a", 10**9) == StopLine("NOT STOPPED: no connection (b)", is_alarm=True)
    presses.release("a")
    presses.release("b")
    assert presses.line("a", 10**9) is None


def test_a_stop_that_is_pressed_before_a_resume_was_answered_is_asked_after_it() -> None:
    asked: list[Callable[[bool], None]] = []
    presses = StopPresses(lambda _, answered: asked.append(answered))
    presses.release("a")
    presses.press("a", 0)
    asked.pop()(True)  # it may have come before the resume
    assert presses.line("a", 0) is not None
    presses.resumed("a")
    presses.tick(1)
    asked.pop()(True)
    assert presses.line("a", 1) is None


def test_the_own_robot_is_listed_before_it_is_heard_of() -> None:
    robots = Robots("trolley")
    assert robots.labels("trolley", lambda _: True) == {"trolley – away": "trolley"}


def test_heavier_particles_are_darker() -> None:
    faint, strong = stroke_colours(np.array([0.1, 1.0], np.float32))[:, 1].sum(axis=1)
    assert strong < faint
    assert len(stroke_colours(np.zeros(3, np.float32))) == 3


@pytest.mark.parametrize("aspect", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("bounds", [(-4.0, -3.0, 4.0, 3.0), (0.0, 0.0, 40.0, 5.0)])
def test_the_whole_map_is_in_the_picture(
    aspect: float, bounds: tuple[float, float, float, float]
) -> None:
    position, look_at = stand(bounds, aspect)
    forward = (look_at - position) / np.linalg.norm(look_at - position)
    right = np.array([1.0, 0.0, 0.0])
    up = np.cross(right, forward)
    x0, y0, x1, y1 = bounds
    tangent = np.tan(0.5 * FIELD_OF_VIEW)
    for corner in ([x0, y0, 0], [x1, y0, 0], [x1, y1, 0], [x0, y1, 0]):
        ray = np.array(corner) - position
        depth = ray @ forward
        assert abs(ray @ up) / depth <= tangent
        assert abs(ray @ right) / depth <= tangent * aspect
