"""Who may only look: whatever their page says, nothing but Stop does anything."""

import copy
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from support.pages import page_of

from trolley import requests, topics
from trolley.messages import GoalStatus, Overlay, Tour, Tours, TourStatus
from trolley.messages import Stop as TourStop
from trolley_viz.controls.messages import Value
from trolley_viz.joystick.joystick import Grip
from trolley_viz.overlays.pages import Click
from trolley_viz.pointing.pointer import Pointed
from trolley_viz.server.messages import Gesture, Hold, Press, Resume, Said, Stop
from trolley_viz.server.visitors import Visitor
from trolley_viz.session.browser_choices import FILE, ViewerSettings

if TYPE_CHECKING:
    from ..conftest import Stage

GUEST, OWNER = Visitor("c" * 16, "viewer"), Visitor("a" * 16)
READING = {requests.TOUR_HISTORY.name}
"""What may be asked for to be shown."""
OWN_TOPICS = {topics.HEALTH.name}


class Watched:
    """A viewer with an operator's page and a guest's, and what it does to robots and files."""

    def __init__(self, stage: "Stage", monkeypatch: pytest.MonkeyPatch) -> None:
        self.stage = stage
        self.owner, self.guest = stage.browse(0, OWNER), stage.browse(1, GUEST)
        stage.page(0).session.preferences.switch_layer("costmap", is_on=True)
        self.deeds: list[tuple[str, str]] = []
        self.saved: list[tuple[str, Any]] = []
        for what in ("request", "publish", "put_wish", "save"):
            monkeypatch.setattr(stage.viz, what, self._watch(what))

    def _watch(self, what: str) -> Any:
        whole = getattr(self.stage.viz, what)

        def call(one: Any, *args: Any, **more: Any) -> Any:
            name = one if isinstance(one, str) else one.name
            if what == "save":
                self.saved.append((name, copy.deepcopy(args[0])))
            elif name not in READING | OWN_TOPICS:
                self.deeds.append((what, name))
            return whole(one, *args, **more)

        return call

    def say(self, said: Said) -> None:
        """Say something as the guest's page, and see what comes of it."""
        self.stage.say(self.guest, said)
        self.stage.runtime.run(0.3)

    def press(self, control: int, value: Value = None) -> None:
        """Press something as the guest's page."""
        now_ms = self.stage.now_ms
        press = Press(id=1, at_ms=now_ms, control=control, value=value)
        self.stage.say(self.guest, Said(press=press))


@pytest.fixture
def watched(stage: "Stage", monkeypatch: pytest.MonkeyPatch) -> Watched:
    tour = Tour(name="round", stops=[TourStop(name="kitchen")])
    stage.robot.publish(topics.TOURS, Tours(stamp_ns=1, tours=[tour]))
    trip = TourStatus(stamp_ns=1, name="round", trip="t1", state="driving", stop=0)
    stage.robot.publish(topics.TOUR, trip)
    goal = GoalStatus(stamp_ns=10**9, id="tour-t1-0-1", state="driving")
    stage.robot.publish(topics.GOAL, goal)
    stage.runtime.add(type(stage.robot)(), robot="kart")
    watched = Watched(stage, monkeypatch)
    menu = Overlay(kind="menu", items=["tea", "coffee"])
    stage.runtime.publish(topics.OVERLAY, menu, "menu")
    stage.runtime.run(1.0)
    watched.deeds.clear()
    return watched


def words(stage: "Stage") -> dict[str, list[Said]]:
    """What a page can say, by the field of `Said`."""
    now_ms, pad = stage.now_ms, {"x": 0.0, "y": 1.0, "speed": 0.3}
    return {
        "beat_ms": [Said(beat_ms=now_ms)],
        "press": [],  # all of them below
        "stop": [],  # below, too
        "resume": [Said(resume=Resume(id=1, at_ms=now_ms, robot="trolley"))],
        "scene": [Said(scene=secret) for secret in ("", "x", stage.browsers[0].secret)],
        "prefers_dark": [Said(prefers_dark=True), Said(prefers_dark=False)],
        "language": [Said(language="de"), Said(language="xx")],
        "time_zone": [Said(time_zone="Asia/Kolkata"), Said(time_zone="x")],
        "gesture": [
            Said(gesture=Gesture(at_ms=now_ms, released=(0.5, 0.5))),
            Said(gesture=Gesture(at_ms=now_ms, cancelled=True)),
            Said(gesture=Gesture(at_ms=now_ms, size=(390.0, 844.0))),
        ],
        "grip": [Said(grip=Grip(held=held, sent_ms=now_ms, **pad)) for held in (True, True, False)],
        "hold": [
            Said(hold=Hold(at_ms=now_ms, control=id_)) for id_ in (*stage.page(0).controls.all, -1)
        ],
        "overlay": [
            Said(overlay=Click(id="menu", index=1)),
            Said(overlay=Click(id="menu", csv=True)),
            Said(overlay=Click(id="no such", index=-(10**9))),
        ],
    }


def test_no_word_of_a_page_is_forgotten_here(watched: Watched) -> None:
    assert words(watched.stage).keys() == set(Said.__struct_fields__)


@pytest.mark.parametrize("word", Said.__struct_fields__)
def test_no_word_but_stop_does_anything_to_a_robot_or_is_saved(watched: Watched, word: str) -> None:
    stage = watched.stage
    stage.page(0).session.aiming.point_goal()  # what the owner points out is the owner's
    for said in words(stage)[word]:
        watched.say(said)
    assert watched.deeds == []
    assert watched.saved == []
    assert (stage.robot.mode, stage.robot.goals, stage.robot.tours) == ("ok", [], [])
    assert stage.page(0).session.aiming.armed == "go_to"
    assert watched.owner.pad.can


VALUES: list[Value] = [None, True, False, "", "x", 0, 1.0, -1e300]


def test_nothing_that_is_offered_does_more_than_show_and_stop(watched: Watched) -> None:
    stage = watched.stage
    controls = stage.page(1).controls
    before = stage.page(0).session.preferences.choices
    for _ in range(2):  # a press may bring more to press
        for id_, control in list(controls.all.items()):
            for value in [*VALUES, *control.look.options]:
                watched.press(id_, value)
        stage.runtime.run(0.5)
    assert set(watched.deeds) <= {("request", requests.BASE_STOP.name)}
    assert watched.deeds  # of “Stop all robots”
    assert {name for name, _ in watched.saved} <= {FILE}
    for _, settings in watched.saved:
        assert isinstance(settings, ViewerSettings)
        assert settings.browsers.keys() <= {GUEST.browser, OWNER.browser}
        assert settings.browsers.get(OWNER.browser) in (None, before)
        assert settings.names.keys() <= {GUEST.browser}
    assert (stage.robot.goals, stage.robot.tours, stage.robot.poses_set) == ([], [], [])


def test_what_the_operator_has_cannot_be_pressed(watched: Watched) -> None:
    stage = watched.stage
    theirs = stage.page(0).controls.all.keys() - stage.page(1).controls.all.keys()
    commands = {one.id for one in stage.page(0).controls.commands}
    assert theirs
    for control in [*theirs, *commands, -1, 10**6, 2**53]:
        watched.press(control)
    stage.runtime.run(0.5)
    assert watched.deeds == []


def test_neither_tool_nor_undo_is_within_reach(watched: Watched) -> None:
    session = watched.stage.page(1).session
    assert session.pointing.tool is None
    assert watched.stage.page(1).controls.commands == []
    assert session.actions.history.last() is None
    watched.stage.page(0).session.aiming._go_to(Pointed(2.0, 1.0))
    watched.stage.runtime.run(0.5)
    assert session.actions.history.last() is None


def test_stop_works(watched: Watched) -> None:
    watched.say(Said(stop=Stop(id=9, robots=["trolley"])))
    assert watched.guest.answers[9].is_done
    assert watched.deeds == [("request", requests.BASE_STOP.name)]
    assert watched.stage.robot.mode == "stopped"
    watched.say(Said(resume=Resume(id=10, at_ms=watched.stage.now_ms, robot="trolley")))
    assert not watched.guest.answers[10].is_done
    assert watched.stage.robot.mode == "stopped"
    assert watched.saved == []


def test_a_page_says_plainly_what_it_may_do_and_offers_no_more(watched: Watched) -> None:
    page = page_of(watched.stage, 1)
    assert "You may look, but not drive. STOP works." in page.text()
    for label in ("Go to …", "Set pose …", "Find position", "Undo", "Pause", "End", "Map", "Go"):
        assert not page.is_shown(label), label
    for label in ("New map", "Let somebody in", "kitchen", "round", "New tour …"):
        assert not page.is_shown(label), label
    hellos = [told.hello for told in watched.guest.line.told if told.hello is not None]
    assert [one.may_drive for one in hellos] == [False]
    assert all(told.pad is None for told in watched.guest.line.told)
    updates = [told.overlays for told in watched.guest.line.told if told.overlays is not None]
    assert updates
    assert not any(one.may_choose for one in updates)


def test_the_owner_does_what_a_guest_cannot(watched: Watched) -> None:
    """What is watched here is really seen."""
    stage = watched.stage
    stage.say(watched.owner, Said(overlay=Click(id="menu", index=1)))
    stage.page(0).session.aiming._go_to(Pointed(2.0, 1.0))
    grip = Grip(x=0.0, y=1.0, held=True, speed=0.3, sent_ms=stage.now_ms)
    stage.say(watched.owner, Said(grip=grip))
    stage.runtime.run(0.3)
    names = {name for _, name in watched.deeds}
    assert {topics.CHOICE.name, topics.COMMAND.name, requests.GOAL_SEND.name} <= names


@pytest.mark.parametrize("role", ["viewer", "operator"])
def test_a_page_decides_nothing_about_its_own_role(role: str) -> None:
    said = {"role": role, "may_drive": True, "hello": {"may_drive": True}, "visitor": role}
    assert msgspec.convert(said, Said) == Said()
