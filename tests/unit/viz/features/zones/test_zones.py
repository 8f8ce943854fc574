"""Drawing, changing and deleting zones: what the robot is asked, and what people are told."""

import asyncio
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import viser
from support.pages import PageOf, page_of

from trolley import requests, topics
from trolley.codes import Refused
from trolley.messages import SuspectLine, Suspects, Zone, Zones
from trolley.messages.mapping import ZoneKind
from trolley.messages.request_params import Named
from trolley.runtime.service import Service, answers
from trolley.zones import check_zone, with_zone, without_zone
from trolley_viz.controls.undo import Change, History
from trolley_viz.features.zones.dismissed import Dismissed
from trolley_viz.server.visitors import Visitor

if TYPE_CHECKING:
    from ...conftest import Stage

MIRROR = Zone(name="hall mirror", kind="mirror", points=[(1.0, 1.0), (2.0, 1.0)])
SUSPECT = SuspectLine(points=[(-1.0, 1.0), (0.0, 1.0)], score=0.8)


class ZoneKeeper(Service):
    """Stores zones as the localizer does."""

    name = "localizer"

    def __init__(self) -> None:
        self.zones = [MIRROR]
        self.refuse = ""

    def start(self) -> None:
        self.tell()
        self.publish(topics.SUSPECTS, Suspects(stamp_ns=0, lines=[SUSPECT]))

    def tell(self) -> None:
        self.publish(topics.ZONES, Zones(stamp_ns=0, map="room", zones=self.zones))

    @answers(requests.ZONES_PUT)
    def put(self, zone: Zone) -> Zone:
        if self.refuse:
            raise Refused("not_saved", self.refuse)
        zone = check_zone(zone, zone.name)
        self.zones = with_zone(self.zones, zone)
        self.tell()
        return zone

    @answers(requests.ZONES_DELETE)
    def delete(self, params: Named) -> Zone:
        self.zones, zone = without_zone(self.zones, params.name)
        self.tell()
        return zone

    def __getitem__(self, name: str) -> Zone:
        return next(zone for zone in self.zones if zone.name == name)

    @property
    def names(self) -> list[str]:
        return [zone.name for zone in self.zones]


class Hand:
    """The hand of somebody at a browser."""

    def __init__(self, stage: "Stage") -> None:
        self.stage = stage
        self.browser = stage.browse()
        self.browser.camera.position = np.array([0.0, -4.0, 8.0])
        stage.runtime.run(0.5)

    @property
    def editor(self) -> Any:
        return self.stage.session.drawing.zone_editor

    @property
    def canvas(self) -> Any:
        return self.editor._canvas

    def tap(self, x: float, y: float) -> None:
        origin = np.array([0.0, -4.0, 8.0])
        ray = np.array([x, y, 0.0]) - origin
        event = SimpleNamespace(ray_origin=tuple(origin), ray_direction=tuple(ray))
        event.screen_pos = (0.5, 0.5)
        asyncio.run(self.canvas._floor._impl.click_cb[0].callback(event))
        self.wait()
        self.stage.session.drags.released((0.5, 0.5))
        self.wait()

    def event(self, phase: str, start: tuple[float, float], end: tuple[float, float]) -> Any:
        return SimpleNamespace(
            phase=phase,
            start_position=(*start, 0.0),
            end_position=(*end, 0.0),
            end_screen_pos=(0.5, 0.5),
            instance_index=None,
            client=SimpleNamespace(camera=SimpleNamespace(position=np.array([0.0, -4.0, 8.0]))),
        )

    def drag(self, start: tuple[float, float], end: tuple[float, float], handle: int = -1) -> None:
        node = self.canvas._handles if self.canvas._floor is None else self.canvas._floor
        drag = node._impl.drag_cb[0].callback
        for phase, at in (("start", start), ("update", end), ("end", end)):
            event = self.event(phase, start, at)
            event.instance_index = handle
            asyncio.run(drag(event))
            self.wait()
        self.stage.session.drags.released((0.5, 0.5))
        self.wait()

    @property
    def history(self) -> History:
        return self.stage.session.actions.history

    @property
    def page(self) -> PageOf:
        return page_of(self.stage).within("Zones")

    def wait(self) -> None:
        self.stage.runtime.run(0.3)


@pytest.fixture
def keeper(stage: "Stage") -> ZoneKeeper:
    return stage.runtime.add(ZoneKeeper())


@pytest.fixture
def hand(stage: "Stage", keeper: ZoneKeeper) -> Hand:
    return Hand(stage)


def test_corner_after_corner_makes_an_area(hand: Hand, keeper: ZoneKeeper) -> None:
    hand.editor.start("keepout")
    for corner in ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.005, 0.005)):
        hand.tap(*corner)
    zone = keeper["no-go area 1"]
    assert zone.kind == "keepout"
    assert zone.speed is None
    np.testing.assert_allclose(zone.points, [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0)], atol=1e-9)
    assert hand.editor.mode == "idle"
    assert hand.canvas._floor is None
    assert hand.canvas._line is None


def test_a_line_is_dragged_and_goes_to_the_wall(hand: Hand, keeper: ZoneKeeper) -> None:
    hand.editor.start("mirror")
    hand.editor.form.name = " wall  mirror "
    hand.drag((-1.0, -1.8), (1.0, -1.85))  # the wall's face is at -1.9; letting go saves it
    hand.wait()
    assert hand.editor.mode == "idle"
    np.testing.assert_allclose(keeper["wall mirror"].points, [(-1.0, -1.9), (1.0, -1.9)], atol=1e-6)
    assert hand.browser.notices[-1] == (
        "Saved",
        "The robot will respect “wall mirror” from now on.",
    )


@pytest.mark.parametrize("kind", ["glass", "keepout"])
def test_a_drag_that_goes_on_from_a_corner_saves_nothing(
    hand: Hand, keeper: ZoneKeeper, kind: ZoneKind
) -> None:
    hand.editor.start(kind)
    if kind == "glass":
        hand.tap(0.0, 0.0)
    hand.drag((0.0, 0.0), (1.0, 0.0))
    hand.wait()
    assert hand.editor.mode == "draw"
    assert keeper.names == ["hall mirror"]


def test_a_corner_is_taken_back_and_all_of_it_is_left(hand: Hand, keeper: ZoneKeeper) -> None:
    hand.editor.start("speed")
    hand.tap(0.0, 0.0)
    hand.tap(1.0, 0.0)
    hand.editor.take_back()
    assert len(hand.editor.sketch.points) == 1
    hand.editor.leave()
    assert hand.editor.sketch is None
    assert keeper.names == ["hall mirror"]


def test_a_crossing_outline_is_red_and_not_sent(hand: Hand, keeper: ZoneKeeper) -> None:
    hand.editor.start("keepout")
    for corner in ((0.0, 0.0), (1.0, 1.0), (1.0, 0.0), (0.0, 1.0)):
        hand.tap(*corner)
    assert tuple(hand.canvas._line.colors) == (214, 30, 30)
    hand.editor.done()
    hand.wait()
    assert hand.browser.notices[-1] == ("Not yet", "The outline crosses itself.")
    assert keeper.names == ["hall mirror"]
    hand.editor.take_back()
    assert tuple(hand.canvas._line.colors) == (0, 140, 40)


def test_a_slow_area_has_the_speed_of_the_form(hand: Hand, keeper: ZoneKeeper) -> None:
    hand.editor.start("speed")
    for corner in ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0)):
        hand.tap(*corner)
    hand.editor.form.speed = 0.25
    hand.editor.done()
    hand.wait()
    assert keeper["slow area 1"].speed == 0.25


def test_a_name_that_is_taken_replaces_nothing(hand: Hand, keeper: ZoneKeeper) -> None:
    hand.editor.start("mirror")
    hand.editor.form.name = "hall mirror"
    hand.drag((0.0, 0.0), (1.0, 0.0))
    hand.wait()
    assert "already" in hand.browser.notices[-1][1]
    assert keeper["hall mirror"] == MIRROR
    assert hand.editor.mode == "draw"  # nothing that was drawn is lost


def test_what_the_localizer_refuses_is_said_in_its_words(hand: Hand, keeper: ZoneKeeper) -> None:
    keeper.refuse = "The disk is full."
    hand.editor.start("mirror")
    hand.drag((0.0, 0.0), (1.0, 0.0))
    hand.wait()
    assert hand.browser.notices[-1] == ("Not saved", "The disk is full.")
    hand.editor.form.name = "<b>"
    keeper.refuse = ""
    hand.editor.done()
    hand.wait()
    assert "may not contain" in hand.browser.notices[-1][1]


def test_a_zone_is_tapped_and_its_corner_dragged(hand: Hand, keeper: ZoneKeeper) -> None:
    hand.editor.pick()
    hand.tap(1.5, 1.02)
    assert hand.editor.selected == MIRROR
    hand.drag((2.0, 1.0), (2.0, 0.5), handle=1)
    np.testing.assert_allclose(keeper["hall mirror"].points, [(1.0, 1.0), (2.0, 0.5)], atol=1e-9)
    hand.drag((1.5, 0.75), (1.0, 0.75), handle=2)
    np.testing.assert_allclose(keeper["hall mirror"].points, [(0.5, 1.0), (1.5, 0.5)], atol=1e-9)
    hand.history.undo()
    hand.wait()
    hand.history.undo()
    hand.wait()
    assert keeper["hall mirror"] == MIRROR
    assert hand.history.last() is None


def test_a_zone_is_saved_while_something_else_is_asked_but_not_while_another_is(
    hand: Hand, keeper: ZoneKeeper
) -> None:
    hand.stage.session.actions.find()
    requests_of = hand.editor.zone_requests
    requests_of.ask(Change(MIRROR, None), lambda _: None)
    told = len(hand.browser.notices)
    requests_of.ask(Change(None, MIRROR), lambda _: None)
    assert hand.browser.notices[told:] == [("Not saved", "The last change has not been saved yet.")]
    hand.wait()
    assert keeper.names == []
    hand.stage.session.actions.find()
    hand.history.undo()
    hand.wait()
    assert keeper.names == ["hall mirror"]


def test_handles_keep_their_size_on_the_screen(hand: Hand) -> None:
    hand.editor.select("hall mirror")
    before = hand.canvas._handles.batched_scales.copy()
    hand.browser.camera.position = np.array([0.0, -2.0, 3.0])
    hand.wait()
    after = hand.canvas._handles.batched_scales
    assert after[0] < 0.6 * before[0]
    assert after[-1] == pytest.approx(1.5 * after[0])


def test_a_refused_move_goes_back(hand: Hand, keeper: ZoneKeeper) -> None:
    hand.editor.select("hall mirror")
    keeper.refuse = "The disk is full."
    hand.drag((1.5, 1.0), (1.0, 0.0), handle=2)
    assert hand.editor.sketch.points == ((1.0, 1.0), (2.0, 1.0))
    assert hand.history.last() is None


def test_a_zone_that_is_renamed_on_one_robot_stays_on_the_next(
    hand: Hand, keeper: ZoneKeeper
) -> None:
    hand.stage.runtime.add(type(hand.stage.robot)(), robot="kart")
    other = hand.stage.runtime.add(ZoneKeeper(), robot="kart")
    hand.editor.select("hall mirror")
    hand.editor.form.name = "big mirror"
    hand.editor.done()
    hand.stage.session.follow("kart")  # before it is answered
    hand.wait()
    assert keeper.names == ["big mirror"]
    assert other.names == ["hall mirror"]


def test_a_zone_that_is_drawn_stays_with_its_robot(hand: Hand, keeper: ZoneKeeper) -> None:
    hand.stage.runtime.add(type(hand.stage.robot)(), robot="kart")
    other = hand.stage.runtime.add(ZoneKeeper(), robot="kart")
    hand.editor.start("keepout")
    for corner in ((0.0, 0.0), (1.0, 0.0), (1.0, 0.5)):
        hand.tap(*corner)
    hand.editor.form.name = "rug"
    drawn = hand.editor.sketch
    hand.stage.session.follow("kart")
    hand.wait()
    assert (hand.editor.mode, hand.editor.sketch) == ("idle", None)
    hand.stage.session.follow("trolley")
    hand.wait()
    assert (hand.editor.mode, hand.editor.sketch) == ("draw", drawn)
    hand.editor.done()
    hand.wait()
    assert "rug" in keeper.names
    assert "rug" not in other.names


def test_a_zone_drawn_on_a_map_that_is_gone_meanwhile_is_left_and_that_is_told(
    hand: Hand, keeper: ZoneKeeper
) -> None:
    hand.stage.runtime.add(type(hand.stage.robot)(), robot="kart")
    hand.editor.start("keepout")
    hand.tap(0.0, 0.0)
    hand.stage.session.follow("kart")
    hand.wait()
    keeper.publish(topics.ZONES, Zones(stamp_ns=0, map="attic", zones=[]))
    hand.stage.session.follow("trolley")
    hand.wait()
    assert hand.editor.mode == "idle"
    assert hand.browser.notices[-1][0] == "Map changed"


def test_rename_delete_and_undo(hand: Hand, keeper: ZoneKeeper) -> None:
    hand.editor.select("hall mirror")
    hand.editor.form.name = "big mirror"
    hand.editor.done()
    hand.wait()
    assert keeper.names == ["big mirror"]
    hand.editor.delete()
    hand.wait()
    assert keeper.names == []
    assert hand.editor.mode == "idle"
    for names in (["big mirror"], ["hall mirror"], ["hall mirror"]):
        hand.history.undo()
        hand.wait()
        assert keeper.names == names
    assert keeper["hall mirror"] == MIRROR


def test_undo_does_not_undo_what_somebody_else_did(hand: Hand, keeper: ZoneKeeper) -> None:
    hand.editor.select("hall mirror")
    hand.drag((1.5, 1.0), (1.0, 0.5), handle=2)
    theirs = Zone(name="hall mirror", kind="mirror", points=[(0.0, 0.0), (0.0, 1.0)])
    keeper.put(theirs)
    hand.wait()
    assert hand.editor.sketch.points == ((0.0, 0.0), (0.0, 1.0))
    hand.history.undo()
    hand.wait()
    assert keeper["hall mirror"] == theirs
    assert hand.browser.notices[-1][0] == "Not undone"


def test_a_zone_that_somebody_deletes_is_let_go(hand: Hand, keeper: ZoneKeeper) -> None:
    hand.editor.select("hall mirror")
    keeper.delete(Named(name="hall mirror"))
    hand.wait()
    assert hand.editor.mode == "idle"
    assert hand.canvas._handles is None


def test_pointing_ends_drawing_and_drawing_ends_pointing(hand: Hand, stage: "Stage") -> None:
    session = stage.session
    session.aiming.point_goal()
    session.drawing.zone_editor.start("mirror")
    assert session.pointing.tool is None
    session.aiming.point_goal()
    hand.wait()
    assert session.drawing.zone_editor.mode == "idle"
    assert session.pointing.tool is not None


def test_a_browser_that_leaves_leaves_nothing(hand: Hand, stage: "Stage", keeper: Any) -> None:
    hand.editor.start("mirror")
    editor, canvas = hand.editor, hand.canvas
    hand.tap(0.0, 0.0)
    stage.leave(stage.browsers[0])
    assert canvas._floor is None
    stage.runtime.run(31.0)
    assert editor.mode == "idle"
    assert keeper.names == ["hall mirror"]


def test_a_suspect_is_offered_and_stored_as_a_mirror(hand: Hand, keeper: ZoneKeeper) -> None:
    assert "There seems to be a mirror" in hand.page.text()
    assert len(hand.stage.session.suspected_mirrors._nodes) == 2
    hand.page.press("Yes, add it")
    hand.wait()
    assert keeper["mirror 1"].points == SUSPECT.points


def test_a_suspect_is_asked_about_in_the_language_of_the_page(hand: Hand) -> None:
    suspects = hand.stage.session.suspected_mirrors

    def labels() -> list[str]:
        return [node.text for node in suspects._nodes if isinstance(node, viser.LabelHandle)]

    assert labels() == ["mirror?"]
    hand.stage.session.preferences.choose_language("de")
    hand.stage.runtime.run(0.5)
    assert labels() == ["Spiegel?"]


def test_a_suspect_that_is_none_is_not_offered_again(stage: "Stage", keeper: ZoneKeeper) -> None:
    stage.browse(0, Visitor("ann"))
    stage.runtime.run(0.5)
    page_of(stage).press("No")
    near = SuspectLine(points=[(0.1, 1.0), (-1.0, 1.1)], score=0.9)
    keeper.publish(topics.SUSPECTS, Suspects(stamp_ns=0, lines=[near]))
    stage.runtime.run(0.5)
    assert stage.session.suspected_mirrors.offered == []
    assert not page_of(stage).is_shown("No")
    dismissed = stage.session.preferences.choices.dismissed
    assert dismissed == [Dismissed(map="room", points=SUSPECT.points)]
    stage.browse(1, Visitor("ben"))
    assert page_of(stage, 1).is_shown("No")


def test_a_page_that_sends_nonsense_changes_nothing(hand: Hand, keeper: ZoneKeeper) -> None:
    hand.editor.start("mirror")
    hand.drag((float("nan"), 0.0), (1.0, float("nan")))
    assert hand.editor.sketch.points == ()
    hand.editor.select("hall mirror")
    for index in (-7, 3, 10**9):
        hand.drag((1.0, 1.0), (0.0, 0.0), handle=index)
    assert keeper.zones == [MIRROR]
    hand.editor.form.speed = float("nan")
    hand.editor.form.name = "x" * 100_000
    hand.editor.done()
    hand.wait()
    assert len(hand.browser.notices[-1][1]) < 200
    assert keeper.zones == [MIRROR]


def test_a_viewer_cannot_draw(stage: "Stage", keeper: ZoneKeeper) -> None:
    stage.browse(0, Visitor("guest", "viewer"))
    assert not page_of(stage).is_shown("Zones")


def test_a_zone_is_drawn_changed_and_deleted_from_the_page(hand: Hand, keeper: ZoneKeeper) -> None:
    page = hand.page
    assert page.options("Change") == ("choose …", "hall mirror")
    page.press("Slow")
    hand.wait()
    assert page.value("Name") == "slow area 1"
    page.type("At most (m/s)", 0.25)
    for corner in ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)):
        hand.tap(*corner)
    page.press_key("backspace")
    page.press_key("enter")
    hand.wait()
    assert (keeper["slow area 1"].speed, len(keeper["slow area 1"].points)) == (0.25, 3)
    assert not page.is_shown("Done")
    with pytest.raises(ValueError, match="unpack"):
        page.press_key("enter")  # means nothing any more
    page.choose("Change", "hall mirror")
    hand.wait()
    assert (page.value("Name"), page.value("Change")) == ("hall mirror", "hall mirror")
    page.type("Name", "big mirror")
    page.press("Save")
    hand.wait()
    assert "big mirror" in keeper.names
    page.press("Delete")
    hand.wait()
    assert keeper.names == ["slow area 1"]
    assert page.value("Change") == "choose …"
