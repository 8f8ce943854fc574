"""What the robot found changed on its map: drawn, offered, and put on the map or not."""

from typing import TYPE_CHECKING, Any

import pytest
from support.pages import PageOf, page_of

from trolley import requests, topics
from trolley.codes import EXISTS, UNKNOWN_NAME, Refused
from trolley.map_editing.proposals import first_that_fit, ops_of
from trolley.messages import EditMap, MapChange, MapChanges, MapEdited
from trolley.messages.request_params import Nothing, WhichChange
from trolley.names import free_name
from trolley.runtime.service import Service, answers
from trolley_viz.features.map_changes.panel import ACCEPT, LATER, NEVER

if TYPE_CHECKING:
    from ...conftest import Stage


def change(name: str, kind: Any, x: float, strokes: int = 2) -> MapChange:
    outline = [(x, 0.0), (x + 0.4, 0.0), (x + 0.4, 0.2), (x, 0.2)]
    lines = [((x + 0.05, 0.1 * k), (x + 0.35, 0.1 * k)) for k in range(strokes)]
    return MapChange(
        id=name, kind=kind, points=outline, strokes=lines, width=0.1, seconds=900, score=0.8,
        message="Something <is> so.",
    )  # fmt: skip


GONE, CAME = change("gone-1", "gone", -1.0), change("appeared-2", "appeared", 1.0)


class MapKeeper(Service):
    """Proposes as the localizer does, and changes maps as the mapper does."""

    name = "localizer"

    def __init__(self) -> None:
        self.changes = [CAME, GONE]
        self.edits: list[EditMap] = []
        self.is_configured = True

    def start(self) -> None:
        self.tell()

    def tell(self) -> None:
        self.publish(topics.CHANGES, MapChanges(stamp_ns=0, map="room", changes=self.changes))

    @answers(requests.CHANGES_DISMISS)
    def dismiss(self, params: WhichChange) -> MapChange:
        found = [one for one in self.changes if one.id == params.id]
        if not found:
            raise Refused(UNKNOWN_NAME)
        self.changes = [one for one in self.changes if one.id != params.id]
        self.tell()
        return found[0]

    @answers(requests.MAP_LIST)
    def list_maps(self, _: Nothing) -> list[str]:
        return ["room", "room-2"]

    @answers(requests.MAP_EDIT)
    def edit(self, params: EditMap) -> MapEdited:
        if self.is_configured and params.as_name is None:
            raise Refused(EXISTS)
        self.edits.append(params)
        return MapEdited(state="saved", name=params.as_name or params.name, message="Done.")


@pytest.fixture
def keeper(stage: "Stage") -> MapKeeper:
    return stage.runtime.add(MapKeeper())


@pytest.fixture
def page(stage: "Stage", keeper: MapKeeper) -> PageOf:
    stage.browse()
    return page_of(stage).within("Map")


def answer(stage: "Stage", page: PageOf, what: str) -> None:
    page.press(what)
    stage.runtime.run(0.5)


def test_changes_are_offered_and_accepted_under_a_name_of_their_own(
    stage: "Stage", keeper: MapKeeper
) -> None:
    browser = stage.browse()
    page = page_of(stage).within("Map")
    assert "2 things have changed" in page.text()
    assert "<is>" not in page.html()
    assert page.options("Which") == ("all 2", "appeared-2", "gone-1")
    assert len(stage.session.change_marks._nodes) == 4
    answer(stage, page, ACCEPT)
    (edit,) = keeper.edits
    assert (edit.name, edit.as_name) == ("room", "room-3")
    assert edit.ops == ops_of([CAME, GONE])
    assert [type(op).__name__ for op in edit.ops] == ["EraseStroke"] * 2 + ["DrawWall"] * 2
    assert browser.notices[-1] == ("The map was changed", "Done.")


def test_what_was_accepted_of_one_robot_does_not_change_the_map_of_the_next(
    stage: "Stage", keeper: MapKeeper, page: PageOf
) -> None:
    stage.runtime.add(type(stage.robot)(), robot="kart")
    other = stage.runtime.add(MapKeeper(), robot="kart")
    page.press(ACCEPT)
    stage.session.follow("kart")  # while a name of its own is looked for
    stage.runtime.run(0.5)
    assert [edit.as_name for edit in keeper.edits] == ["room-3"]
    assert other.edits == []


def test_one_of_them_is_accepted(stage: "Stage", keeper: MapKeeper, page: PageOf) -> None:
    keeper.is_configured = False
    page.choose("Which", "gone-1")
    answer(stage, page, ACCEPT)
    assert [(edit.as_name, edit.ops) for edit in keeper.edits] == [(None, ops_of([GONE]))]


def test_not_now_is_for_this_browser_and_never_for_all(
    stage: "Stage", keeper: MapKeeper, page: PageOf
) -> None:
    page.choose("Which", "gone-1")
    answer(stage, page, LATER)
    assert stage.session.change_marks.offered == [CAME]
    assert "1 thing has changed" in page.text()
    assert not page.is_shown("Which")
    assert keeper.changes == [CAME, GONE]
    answer(stage, page, NEVER)
    assert keeper.changes == [GONE]
    assert stage.session.change_marks.offered == []
    assert not page.is_shown(NEVER)
    assert keeper.edits == []


def test_changes_of_another_map_are_not_offered(stage: "Stage", keeper: MapKeeper) -> None:
    stage.browse()
    keeper.publish(topics.CHANGES, MapChanges(stamp_ns=1, map="attic", changes=[CAME]))
    stage.runtime.run(0.5)
    assert stage.session.change_marks.offered == []


def test_no_more_is_asked_than_a_request_holds() -> None:
    many = [change(f"gone-{k}", "gone", 0.0, 300) for k in range(5)]
    assert first_that_fit(many) == many[:3]


@pytest.mark.parametrize(
    ("name", "taken", "free"),
    [
        ("flat", [], "flat-2"),
        ("flat", ["flat-2", "flat-3"], "flat-4"),
        ("flat-2", ["flat-2"], "flat-3"),
        ("my-flat", [], "my-flat-2"),
        ("x" * 64, [], "x" * 58 + "-2"),
    ],
)
def test_a_changed_map_gets_a_free_name(name: str, taken: list[str], free: str) -> None:
    assert free_name(name, taken) == free
