"""Changing the map at a browser: what is shown, what the mapper is asked, what is called off."""

import asyncio
import math
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from support.pages import page_of

from trolley import codes, requests
from trolley.codes import Refused
from trolley.geometry import Pose2D
from trolley.messages import (
    Crop,
    DrawWall,
    EditMap,
    EraseStroke,
    MapEdited,
    Merge,
    TakeBack,
    Turn,
)
from trolley.messages.request_params import Nothing
from trolley.runtime.service import Later, Service, answers
from trolley_viz.controls.controls import NotThere

if TYPE_CHECKING:
    from ...conftest import Stage

EYE = np.array([0.0, -4.0, 8.0])


class Mapper(Service):
    """Takes note of what it is asked."""

    name = "mapper"

    def __init__(self) -> None:
        self.asked: list[EditMap] = []
        self.refusal: Refused | None = None
        self.late = 0
        self.holds = False
        self.held: Later[MapEdited] | None = None

    @answers(requests.MAP_LIST)
    def names(self, _: Nothing) -> list[str]:
        return ["attic", "room"]

    @answers(requests.MAP_EDIT)
    def edit(self, params: EditMap) -> MapEdited | Later[MapEdited]:
        self.asked.append(params)
        if self.holds:
            self.held = self.later()
            return self.held
        if self.refusal is not None:
            raise self.refusal
        name = params.as_name or params.name
        if self.late:
            self.late -= 1
            return MapEdited(state="working", name=name, message="Wait.")
        if params.preview:
            pose, walls = Pose2D(1.0, 0.0, 0.0), [(4.0, 0.0), (4.0, 1.0)]
            return MapEdited(state="preview", name=name, message="Fits.", placed=pose, walls=walls)
        return MapEdited(state="saved", name=name, message="Stored.", version=2)


class Hand:
    """The hand of somebody at a browser who changes the map."""

    def __init__(self, stage: "Stage") -> None:
        self.stage = stage
        self.browser = stage.browse()
        self.browser.camera.position = EYE
        stage.runtime.run(0.5)
        self.editor.open()
        self.wait()

    @property
    def editor(self) -> Any:
        return self.stage.session.drawing.map_editor

    @property
    def cells(self) -> np.ndarray:
        return self.editor.drafting.drawn.grid.cells

    def wait(self) -> None:
        self.stage.runtime.run(0.3)

    def tap(self, x: float, y: float) -> None:
        event = SimpleNamespace(
            ray_origin=tuple(EYE),
            ray_direction=tuple(np.array([x, y, 0.0]) - EYE),
            screen_pos=(0.5, 0.5),
        )
        asyncio.run(self.editor.pencil._canvas._floor._impl.click_cb[0].callback(event))
        self.wait()
        self.stage.session.drags.released((0.5, 0.5))
        self.wait()

    def drag(self, *way: tuple[float, float], is_called_off: bool = False) -> None:
        callback = self.editor.pencil._canvas._floor._impl.drag_cb[0].callback
        phases = ["start", *["update"] * (len(way) - 1), "end"]
        for phase, at in zip(phases, [*way, way[-1]], strict=True):
            event = SimpleNamespace(
                phase=phase,
                start_position=(*way[0], 0.0),
                end_position=(*at, 0.0),
                end_screen_pos=(0.5, 0.5),
                instance_index=None,
                client=SimpleNamespace(camera=SimpleNamespace(position=EYE)),
            )
            asyncio.run(callback(event))
            self.wait()
        drags = self.stage.session.drags
        if is_called_off:
            drags.cancelled()
        else:
            drags.released((0.5, 0.5))
        self.wait()


@pytest.fixture
def mapper(stage: "Stage") -> Mapper:
    return stage.runtime.add(Mapper())


@pytest.fixture
def hand(stage: "Stage", mapper: Mapper) -> Hand:
    return Hand(stage)


def test_strokes_are_seen_at_once_and_stored_when_it_is_said(hand: Hand, mapper: Mapper) -> None:
    editor = hand.editor
    assert not editor.hides_map
    editor.choose("erase")
    hand.drag((-1.0, -1.95), (0.0, -1.95), (1.0, -1.95))
    assert editor.hides_map
    assert (hand.cells[0] == 100).sum() < 60  # there the wall is open
    editor.choose("wall")
    hand.tap(0.0, 0.0)
    hand.tap(1.0, 0.5)
    editor.choose("crop")
    hand.drag((-2.0, -1.95), (2.0, 1.5))
    assert [type(op) for op in editor.drafting.draft.ops] == [EraseStroke, DrawWall, Crop]
    assert hand.cells.shape == (35, 40)
    assert mapper.asked == []
    editor.store()
    hand.wait()
    assert mapper.asked[0].name == "room"
    assert mapper.asked[0].as_name is None
    assert [type(op) for op in mapper.asked[0].ops] == [EraseStroke, DrawWall, Crop]
    first = mapper.asked[0].ops[0]
    assert isinstance(first, EraseStroke)
    assert first.points[0] == pytest.approx((-1.0, -1.95))
    assert not editor.is_open
    assert hand.browser.notices[-1] == ("Saved", "Stored.")


def test_the_picture_before_a_stroke_stays_until_the_one_after_it_is_loaded(hand: Hand) -> None:
    def floor() -> Any:
        return hand.editor._preview._map.nodes[0]._impl

    hand.editor.choose("wall")
    hand.tap(0.0, 0.0)
    hand.tap(1.0, 0.5)
    first = floor()
    hand.tap(0.5, 0.0)
    hand.tap(1.0, 1.0)
    assert floor() is not first
    assert not first.removed
    hand.stage.runtime.run(3.0)
    assert first.removed
    second = floor()
    hand.editor.turn_to(20.0)  # beside it, the one before would be seen
    hand.wait()
    assert second.removed


def test_a_drag_that_is_called_off_changes_nothing(hand: Hand) -> None:
    for tool in ("erase", "wall", "crop"):
        hand.editor.choose(tool)
        hand.drag((-1.0, 0.0), (1.0, 1.0), is_called_off=True)
        assert hand.editor.drafting.draft.ops == ()
        assert hand.editor._preview._stroke is None
    hand.editor.choose("erase")  # and the next one counts
    hand.drag((-1.0, -1.95), (1.0, -1.95))
    assert len(hand.editor.drafting.draft.ops) == 1


def test_turning_takes_all_of_the_scene_along(hand: Hand) -> None:
    editor = hand.editor
    for degrees in (10.0, 20.0, 30.0):
        editor.turn_to(degrees)
    hand.wait()
    assert [op.angle for op in editor.drafting.draft.ops] == pytest.approx([math.radians(30.0)])
    root = hand.stage.drawn()._overrides[hand.stage.session.robot][""]
    hand.wait()
    assert root.wxyz[3] == pytest.approx(math.sin(math.radians(15.0)))
    editor.straighten()
    hand.wait()
    draft = editor.drafting.draft
    assert draft.ops == () or abs(draft.last_turn) < math.radians(0.3)
    editor.leave()
    hand.wait()
    assert root.wxyz[3] == pytest.approx(0.0)


def test_what_makes_no_sense_is_said_and_left_out(hand: Hand) -> None:
    hand.editor.choose("erase")
    hand.drag((-1.0, -1.95), (1.0, -1.95))
    hand.editor.choose("crop")
    hand.drag((50.0, 50.0), (60.0, 60.0))
    assert hand.browser.notices[-1][0] == "Not done"
    assert len(hand.editor.drafting.draft.ops) == 1
    hand.editor.take_back()
    hand.wait()
    assert not hand.editor.hides_map


def test_another_map_is_merged_where_the_mapper_finds_it(hand: Hand, mapper: Mapper) -> None:
    assert list(hand.editor.maps) == ["attic"]
    hand.editor.merge("attic")
    hand.wait()
    assert mapper.asked[0].preview
    assert hand.editor.drafting.draft.ops == (Merge(name="attic", pose=Pose2D(1.0, 0.0, 0.0)),)
    hand.editor.turn_to(90.0)
    hand.wait()
    about = hand.editor.drafting.draft.ops[1].about
    turned = Pose2D(about[0], about[1], math.pi / 2) @ Pose2D(-about[0], -about[1], 0.0)
    wanted = turned.transform_points(np.array([(4.0, 0.0), (4.0, 1.0)]))
    np.testing.assert_allclose(hand.editor.drafting.drawn.walls, wanted, atol=1e-9)
    hand.editor.store()
    hand.wait()
    assert [type(op) for op in mapper.asked[1].ops] == [Merge, Turn]


def test_a_taken_name_is_said_and_another_one_offered(hand: Hand, mapper: Mapper) -> None:
    mapper.refusal = Refused(codes.EXISTS, "It is the file that robot.toml names.")
    hand.editor.turn_to(5.0)
    hand.wait()
    hand.editor.store()
    hand.wait()
    assert hand.browser.notices[-1] == ("Not saved", "It is the file that robot.toml names.")
    assert hand.editor.is_open
    assert hand.editor.as_name == "room-2"
    mapper.refusal = None
    hand.editor.store()
    hand.wait()
    assert mapper.asked[-1].as_name == "room-2"


def test_the_version_before_is_asked_for(hand: Hand, mapper: Mapper) -> None:
    hand.editor.leave()
    hand.editor.undo_stored()
    hand.wait()
    assert [(one.name, one.ops) for one in mapper.asked] == [("room", [TakeBack()])]


def test_a_change_that_takes_long_is_waited_for(hand: Hand, mapper: Mapper) -> None:
    hand.editor.leave()
    mapper.late = 2
    hand.editor.undo_stored()
    hand.wait()
    assert [one == mapper.asked[0] for one in mapper.asked] == [True, True, True]
    assert hand.browser.notices[-1][1] == "Stored."


def test_drawing_a_zone_puts_the_draft_aside(hand: Hand) -> None:
    hand.editor.turn_to(5.0)
    hand.wait()
    zones = hand.stage.session.drawing.zone_editor
    zones.start("keepout")
    hand.wait()
    assert not hand.editor.is_open
    zones.leave()
    hand.wait()
    assert hand.editor.is_open
    assert len(hand.editor.drafting.draft.ops) == 1


def test_the_map_is_changed_from_the_page(hand: Hand, mapper: Mapper) -> None:
    page = page_of(hand.stage).within("Edit map")
    assert not page.is_shown("Change this map")
    assert "Look · nothing changed yet" in page.text()
    with pytest.raises(NotThere):
        page.press("Save as new version")
    page.press("Erase")
    hand.wait()
    page.type("Brush (m)", 9.0)
    page.tick("Erase to unknown")
    hand.drag((-1.0, -1.95), (1.0, -1.95))
    assert (hand.editor.pencil.brush_m, hand.editor.pencil.to_unknown) == (2.0, True)
    assert "Erase · 1 step" in page.text()
    page.press("Wall")
    hand.wait()
    assert not page.is_shown("Brush (m)")
    page.type("Wall (m)", 0.1)
    page.type("Turn (°)", 30.0)
    hand.wait()
    assert (hand.editor.pencil.wall_m, len(hand.editor.drafting.draft.ops)) == (0.1, 2)
    page.press("Undo last step")
    hand.wait()
    assert page.value("Turn (°)") == 0.0
    page.choose("Merge with", "attic")
    hand.wait()
    page.type("Save as", "home")
    page.press("Save as new version")
    hand.wait()
    assert (mapper.asked[-1].as_name, len(mapper.asked[-1].ops)) == ("home", 2)
    assert page.is_shown("Change this map")
    page.press("Back to the previous version")
    hand.wait()
    assert mapper.asked[-1].ops == [TakeBack()]


def test_the_steps_so_far_stay_with_their_robot(hand: Hand, mapper: Mapper) -> None:
    hand.stage.runtime.add(type(hand.stage.robot)(), robot="kart")
    hand.editor.choose("wall")
    hand.drag((0.0, 0.0), (1.0, 0.0))
    hand.editor.as_name = "room-2"
    steps = hand.editor.drafting.draft.ops
    assert len(steps) == 1
    hand.stage.session.follow("kart")
    hand.wait()
    assert not hand.editor.is_open
    hand.stage.session.follow("trolley")
    hand.wait()
    assert hand.editor.drafting.draft.ops == steps
    assert (hand.cells == 100).sum() > 60, "the new wall is shown"
    hand.editor.store()
    hand.wait()
    assert mapper.asked[-1] == EditMap(
        id=mapper.asked[-1].id, name="room", ops=list(steps), as_name="room-2"
    )


@pytest.mark.parametrize(
    "answer",
    [
        MapEdited(state="saved", name="room", message="Stored.", version=2),
        Refused(codes.EXISTS, "The disk is full."),
    ],
)
def test_what_comes_of_one_robot_s_map_leaves_the_draft_of_another_s_alone(
    hand: Hand, mapper: Mapper, answer: MapEdited | Refused
) -> None:
    hand.stage.runtime.add(type(hand.stage.robot)(), robot="kart")
    hand.stage.runtime.add(Mapper(), robot="kart")
    hand.editor.turn_to(5.0)
    mapper.holds = True
    hand.editor.store()
    hand.stage.session.follow("kart")
    hand.wait()
    hand.editor.open()
    hand.editor.turn_to(7.0)
    hand.wait()
    assert mapper.held is not None
    if isinstance(answer, Refused):
        mapper.held.refuse(answer)
    else:
        mapper.held.reply(answer)
    hand.wait()
    assert hand.browser.notices[-1][0] in ("Saved", "Not saved")
    assert hand.editor.is_open
    assert len(hand.editor.drafting.draft.ops) == 1
    assert hand.editor.as_name == "room"
