"""An open page: its presses, its line, its scene, and what becomes of them when it is gone."""

import asyncio
import re
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from support.pages import page_of

from trolley import codes, topics
from trolley.geometry import Twist2D
from trolley.messages import GoalStatus
from trolley_viz.features.driving.aiming import GO_TO
from trolley_viz.joystick.joystick import Grip
from trolley_viz.pages.page import AHEAD_MS, LATE_MS, MAX_AWAITED, SILENCE_S
from trolley_viz.pointing.pointer import Pointed
from trolley_viz.server.messages import Answer, Gesture, Press, Resume, Said, Stop, Told
from trolley_viz.server.visitors import Visitor
from trolley_viz.server.web_server import BUILD, PAGE
from trolley_viz.service import BEAT_PERIOD_NS, TICK_S

if TYPE_CHECKING:
    from ..conftest import Stage

ANN, GUEST = Visitor("ann"), Visitor("guest", "viewer")


def id_of(stage: "Stage", label: str, client_id: int = 0) -> int:
    """The number of the first that is shown with this label on a page."""
    controls = stage.page(client_id).controls.all.items()
    return next(id_ for id_, one in controls if one.label == label and one.visible)


def press(
    stage: "Stage", browser: Any, label: str, late_ms: float = 0.0, value: Any = None
) -> Answer:
    """Press something at a page, or when it was pressed some time ago."""
    said = Press(id=7, at_ms=stage.now_ms - late_ms, control=id_of(stage, label), value=value)
    stage.say(browser, Said(press=said))
    return browser.answers[7]


def point(stage: "Stage") -> None:
    """Do what viser does when a press on the floor ends in the middle of the picture."""
    plane: Any = stage.session.pointing._plane
    click = SimpleNamespace(ray_origin=(0, 0, 2), ray_direction=(1, 0, -1), screen_pos=(0.5, 0.5))
    asyncio.run(plane._impl.click_cb[0].callback(click))
    stage.runtime.run(0.0)


def let_go(stage: "Stage", late_ms: float = 0.0) -> Said:
    """What the page says when that press is let go."""
    return Said(gesture=Gesture(at_ms=stage.now_ms - late_ms, released=(0.5, 0.5)))


# Presses.
@pytest.mark.parametrize("late_ms", [LATE_MS - 1.0, 0.0, 1.0 - AHEAD_MS])
def test_what_is_pressed_in_time_is_done_and_answered(stage: "Stage", late_ms: float) -> None:
    browser = stage.browse()
    stage.runtime.run(2.0)
    assert press(stage, browser, "Go to …", late_ms) == Answer(id=7, is_done=True)
    assert stage.session.aiming.armed == GO_TO


@pytest.mark.parametrize("late_ms", [LATE_MS + 1.0, 1e9, -AHEAD_MS - 1.0, -1e9])
def test_what_was_pressed_long_ago_or_is_yet_to_be_is_not_done(
    stage: "Stage", late_ms: float
) -> None:
    browser = stage.browse()
    stage.runtime.run(2.0)
    answer = press(stage, browser, "Go to …", late_ms)
    assert not answer.is_done
    assert ("ago" in answer.text) == (late_ms > 0.0)
    assert stage.session.aiming.armed == ""
    stage.robot.mode = "stopped"
    resume = Resume(id=8, at_ms=stage.now_ms - late_ms, robot="trolley")
    stage.say(browser, Said(resume=resume))
    stage.runtime.run(0.5)
    assert not browser.answers[8].is_done
    assert stage.robot.mode == "stopped"


def test_what_cannot_be_pressed_is_answered_so(stage: "Stage") -> None:
    browser = stage.browse()
    stage.say(browser, Said(press=Press(id=1, at_ms=stage.now_ms, control=10**6)))
    assert browser.answers[1] == Answer(id=1, is_done=False, text="This can no longer be pressed.")
    answer = press(stage, browser, "Look", value="very")
    assert answer.text == "Not understood: not in the list."


@pytest.mark.parametrize("prefers_dark", [True, False])
def test_the_look_is_the_devices_unless_another_is_chosen(
    stage: "Stage", *, prefers_dark: bool
) -> None:
    browser = stage.browse(0, ANN)
    stage.say(browser, Said(prefers_dark=prefers_dark))
    for look, is_dark in [
        ("as this device", prefers_dark),
        ("dark", True),
        ("light", False),
        ("as this device", prefers_dark),
    ]:
        assert press(stage, browser, "Look", value=look).is_done
        stage.runtime.run(0.5)
        assert browser.state.dark == is_dark


def test_folders_stay_as_they_were_left(stage: "Stage") -> None:
    browser = stage.browse(0, ANN)
    assert press(stage, browser, "Keys", value=True).is_done
    stage.leave(browser)
    stage.browse(1, ANN)
    assert stage.page(1).controls.all[id_of(stage, "Keys", 1)].look.is_open


def test_letter_keys_can_be_switched_off_and_stay_so(stage: "Stage") -> None:
    browser = stage.browse(0, ANN)
    assert browser.state.has_letters
    assert press(stage, browser, "Letter keys", value=False).is_done
    stage.runtime.run(0.5)
    assert not browser.state.has_letters
    stage.leave(browser)
    assert not stage.browse(1, ANN).state.has_letters


# Stop and Resume.
@pytest.mark.parametrize("visitor", [ANN, GUEST])
def test_stop_is_done_whoever_presses_it_and_however_late(stage: "Stage", visitor: Visitor) -> None:
    browser = stage.browse(0, visitor)
    stage.say(browser, Said(stop=Stop(id=1, robots=["trolley"])))
    stage.runtime.run(0.5)
    assert stage.robot.mode == "stopped"
    assert browser.answers[1].is_done
    assert browser.state.is_stopped
    assert browser.state.stop is None


def test_stop_without_a_name_stops_all(stage: "Stage") -> None:
    browser = stage.browse()
    kart = stage.runtime.add(type(stage.robot)(), robot="kart")
    stage.runtime.run(0.5)
    stage.say(browser, Said(stop=Stop(id=1, robots=[])))
    stage.runtime.run(0.5)
    assert (stage.robot.mode, kart.mode) == ("stopped", "stopped")


def test_stop_waits_for_a_robot_that_was_not_heard_of_yet(stage: "Stage") -> None:
    browser = stage.browse()
    stage.say(browser, Said(stop=Stop(id=1, robots=["kart"])))
    stage.runtime.run(1.0)
    assert browser.state.stop is not None
    assert browser.state.stop.text == "NOT STOPPED: no connection (kart)"
    kart = stage.runtime.add(type(stage.robot)(), robot="kart")
    stage.runtime.run(1.0)
    assert (kart.mode, stage.robot.mode) == ("stopped", "ok")


@pytest.mark.parametrize("name", ["", "a#b", "*", "**", "a/b", "x" * 40, "a?b", "Ä"])
def test_stop_with_a_name_that_is_none_stops_all(stage: "Stage", name: str) -> None:
    """With such a name in its key a request breaks the service down."""
    browser = stage.browse(0, GUEST)
    stage.say(browser, Said(stop=Stop(id=1, robots=[name])))
    assert set(stage.hub.stops._presses) == {"trolley"}
    stage.runtime.run(0.5)
    assert stage.robot.mode == "stopped"


def test_names_that_a_page_makes_up_are_not_asked_for_ever(stage: "Stage") -> None:
    browser, guest = stage.browse(0, ANN), stage.browse(1, GUEST)
    for i in range(20):
        names = [f"made-up-{i}-{j}" for j in range(100)]
        stage.say(guest, Said(stop=Stop(id=i, robots=names)))
    assert len(stage.hub.stops._presses) <= MAX_AWAITED
    assert 19 not in guest.answers  # its page goes on saying that nothing has stopped
    stage.say(browser, Said(stop=Stop(id=1, robots=["made-up", "trolley"])))
    stage.runtime.run(0.5)
    assert stage.robot.mode == "stopped"


def test_who_drives_may_resume(stage: "Stage") -> None:
    browser = stage.browse()
    stage.robot.mode = "stopped"
    stage.say(browser, Said(resume=Resume(id=1, at_ms=stage.now_ms, robot="kart")))
    stage.runtime.run(0.5)
    assert not browser.answers[1].is_done  # another robot than the one that is seen
    assert stage.robot.mode == "stopped"
    stage.say(browser, Said(resume=Resume(id=2, at_ms=stage.now_ms, robot="trolley")))
    stage.runtime.run(0.5)
    assert browser.answers[2].is_done
    assert stage.robot.mode == "ok"


def test_a_resume_that_nobody_answers_is_not_done(stage: "Stage") -> None:
    browser = stage.browse()
    stage.runtime.kill("base")
    stage.say(browser, Said(resume=Resume(id=1, at_ms=stage.now_ms, robot="trolley")))
    stage.runtime.run(2.5)
    assert not browser.answers[1].is_done
    assert browser.answers[1].text != ""


def test_who_may_only_look_does_not_resume_nor_press_what_others_have(stage: "Stage") -> None:
    guest = stage.browse(0, GUEST)
    stage.browse(1)
    stage.robot.mode = "stopped"
    stage.say(guest, Said(resume=Resume(id=1, at_ms=stage.now_ms, robot="trolley")))
    assert guest.answers[1] == Answer(id=1, is_done=False, text="You may look, but not drive.")
    theirs = stage.page(1).controls.all.keys() - stage.page(0).controls.all.keys()
    assert theirs
    for control in theirs:
        stage.say(guest, Said(press=Press(id=2, at_ms=stage.now_ms, control=control)))
        assert not guest.answers[2].is_done
    stage.runtime.run(0.5)
    assert stage.robot.mode == "stopped"


@pytest.mark.parametrize(
    ("reason", "goes_on"), [(codes.STOPPED, True), (codes.PAUSED, False), ("", False)]
)
def test_drive_on_continues_what_the_stop_has_paused(
    stage: "Stage", reason: str, *, goes_on: bool
) -> None:
    browser = stage.browse()
    asked: list[str] = []
    stage.session.actions.steer = asked.append  # type: ignore[method-assign]
    goal = GoalStatus(stamp_ns=stage.robot.stamp_ns, id="a", state="paused", reason=reason)
    stage.robot.publish(topics.GOAL, goal)
    stage.say(browser, Said(stop=Stop(id=1, robots=["trolley"])))
    stage.runtime.run(1.0)
    assert ("go on" in browser.state.sentence.headline) == goes_on
    assert asked == []
    stage.say(browser, Said(resume=Resume(id=2, at_ms=stage.now_ms, robot="trolley")))
    stage.runtime.run(1.0)
    assert stage.robot.mode == "ok"
    assert asked == (["Continue"] if goes_on else [])


@pytest.mark.parametrize("late", ["the page", "the robot"])
def test_nothing_sets_off_long_after_drive_on(stage: "Stage", late: str) -> None:
    browser = stage.browse()
    asked: list[str] = []
    stage.session.actions.steer = asked.append  # type: ignore[method-assign]
    stamp_ns = stage.robot.stamp_ns
    goal = GoalStatus(stamp_ns=stamp_ns, id="a", state="paused", reason=codes.STOPPED)
    stage.robot.publish(topics.GOAL, goal)
    stage.say(browser, Said(stop=Stop(id=1, robots=["trolley"])))
    stage.runtime.run(1.0)
    browser.line.is_clear = late != "the page"
    stage.say(browser, Said(resume=Resume(id=2, at_ms=stage.now_ms, robot="trolley")))
    while 2 not in browser.answers:
        stage.runtime.run(0.01)
    if late == "the robot":
        stage.robot.mode = "stopped"
    stage.runtime.run(5.0)
    assert asked == (["Continue"] if late == "the page" else [])
    stage.robot.mode, browser.line.is_clear = "ok", True
    stage.runtime.run(5.0)
    assert asked == (["Continue"] if late == "the page" else [])


def test_drive_on_continues_nothing_of_the_robot_that_is_followed_next(stage: "Stage") -> None:
    kart = stage.runtime.add(type(stage.robot)(), robot="kart")
    browser = stage.browse()
    asked: list[str] = []
    stage.session.actions.steer = asked.append  # type: ignore[method-assign]
    for robot, reason in ((stage.robot, codes.STOPPED), (kart, codes.PAUSED)):
        goal = GoalStatus(stamp_ns=robot.stamp_ns, id="a", state="paused", reason=reason)
        robot.publish(topics.GOAL, goal)
    stage.say(browser, Said(stop=Stop(id=1, robots=["trolley"])))
    stage.runtime.run(1.0)
    stage.say(browser, Said(resume=Resume(id=2, at_ms=stage.now_ms, robot="trolley")))
    stage.session.follow("kart")
    stage.runtime.run(1.0)
    assert browser.answers[2].is_done
    assert asked == []


# The line.
def test_a_page_that_answers_stays(stage: "Stage") -> None:
    browser = stage.browse()
    stage.runtime.run(15.0)  # ten times as long as one that is gone may stay
    assert not browser.line.is_closed
    assert browser.state.has_scene


def test_a_page_that_does_not_answer_is_given_up_and_has_let_go(stage: "Stage") -> None:
    browser = stage.browse()
    browser.line.is_heard = False
    stage.runtime.run(1.0)
    grip = Grip(x=0.0, y=1.0, held=True, speed=0.2, sent_ms=stage.now_ms)
    sent = stage.runtime.record(topics.COMMAND, "teleop")
    stage.say(browser, Said(grip=grip))  # which is the last that is heard
    stage.runtime.run(1.0)
    assert not browser.line.is_closed
    assert sent[-1].twist == Twist2D.zero()
    stage.runtime.run(1.0)
    assert browser.line.is_closed
    assert stage.viz.joystick._driven["trolley"].joystick.holder is None
    grip = msgspec.structs.replace(grip, sent_ms=stage.now_ms)
    num_sent, num_told = len(sent), len(browser.line.told)
    stage.say(browser, Said(grip=grip))
    stage.runtime.run(0.5)
    assert len(sent) == num_sent
    assert len(browser.line.told) == num_told


@pytest.mark.parametrize("later_s", [0.0, 0.1, 0.2, 0.3])
def test_a_page_that_is_gone_is_known_to_be_within_a_second_and_a_half(
    stage: "Stage", later_s: float
) -> None:
    browser = stage.browse()
    stage.runtime.run(1.0)
    browser.line.is_heard = False
    stage.runtime.run(later_s)
    stage.say(browser, Said(beat_ms=0.0))  # which is the last that is heard
    stage.runtime.run(1.25)
    assert not browser.line.is_closed
    stage.runtime.run(0.25)
    assert browser.line.is_closed


def test_a_page_whose_words_wait_to_be_handled_is_not_gone(stage: "Stage") -> None:
    browser = stage.browse()
    browser.line.is_heard = False
    browser.line.silence_s = 0.3
    stage.runtime.run(5.0)
    assert not browser.line.is_closed
    browser.line.silence_s = 1.45
    stage.runtime.run(0.1)
    assert browser.line.is_closed


def number_in(script: str, name: str) -> float:
    """A constant of a script of the page."""
    found = re.search(rf"\b{name} = (\d+)", (PAGE / script).read_text())
    assert found is not None
    return float(found[1])


def test_page_and_viewer_know_of_each_other_within_a_second_and_a_half() -> None:
    silence_ms, look_ms, speak_ms = (
        number_in("line-worker.js", name) for name in ("SILENCE_MS", "LOOK_MS", "SPEAK_MS")
    )
    assert silence_ms + look_ms <= 1500.0
    assert silence_ms >= 4 * BEAT_PERIOD_NS * 1e-6
    assert SILENCE_S + TICK_S <= 1.5
    assert 3 * (speak_ms + look_ms) <= SILENCE_S * 1e3


def test_whoever_comes_back_is_told_everything_and_goes_on(stage: "Stage") -> None:
    browser = stage.browse()
    session, controls = stage.session, stage.page().controls
    session.preferences.switch_layer("costmap", is_on=True)
    session.aiming._go_to(Pointed(2.0, 1.0))
    stage.runtime.run(0.5)
    assert page_of(stage).is_shown("Undo: Go to a place on the map")
    line = stage.connect()
    assert browser.line.is_closed
    num_told = len(browser.line.told)
    stage.runtime.run(0.5)
    assert len(browser.line.told) == num_told
    first, second = line.told[:2]
    assert first.hello is not None
    assert (first.hello.build, first.hello.may_drive) == (BUILD, True)
    assert first.beat_ms is not None
    assert second.state is not None
    assert second.state.has_scene
    assert second.controls is not None
    assert second.controls.looks == {id_: one.look for id_, one in controls.all.items()}
    assert second.controls.commands == controls.commands
    assert second.pad is not None
    assert stage.session is session
    assert session.preferences.layers["costmap"]
    browser.line = line
    assert press(stage, browser, "Undo: Go to a place on the map").is_done
    stage.runtime.run(0.5)
    assert not page_of(stage).is_shown("Undo: Go to a place on the map")


def test_a_line_that_was_taken_over_says_and_ends_nothing(stage: "Stage") -> None:
    browser = stage.browse()
    old, browser.line = browser.line, stage.connect()
    stage.runtime.run(0.1)
    late = SimpleNamespace(line=old)
    stage.say(late, Said(stop=Stop(id=1, robots=[])))
    stage.say(late, Said(scene="x"))
    old.close()
    stage.runtime.run(2.0)
    assert stage.robot.mode == "ok"
    assert press(stage, browser, "Go to …").is_done


@pytest.mark.parametrize("visitor", [GUEST, Visitor("ben")])
def test_with_its_key_alone_nobody_gets_at_anothers_page(stage: "Stage", visitor: Visitor) -> None:
    browser = stage.browse(0, ANN)
    page, session = stage.page(), stage.session
    session.aiming.point_goal()
    stranger = SimpleNamespace(line=stage.connect(0, visitor))
    stage.runtime.run(0.5)
    told = stranger.line.told
    assert told[0].hello.may_drive == (visitor.role == "operator")
    assert not any(one.state.has_scene for one in told if one.state is not None)
    for control in page.controls.all:
        stage.say(stranger, Said(press=Press(id=1, at_ms=stage.now_ms, control=control)))
    stage.say(stranger, let_go(stage))
    point(stage)
    stage.runtime.run(0.5)
    assert stage.robot.goals == []
    # And whose it is keeps it.
    assert not browser.line.is_closed
    assert page.session is session
    stage.say(browser, let_go(stage))
    stage.runtime.run(0.5)
    assert len(stage.robot.goals) == 1


def is_only_beat_or_answer(told: Told) -> bool:
    return told in (Told(beat_ms=told.beat_ms), Told(answer=told.answer))


def test_a_slow_line_gets_beats_and_answers_and_later_the_newest_state(stage: "Stage") -> None:
    browser = stage.browse()
    line = browser.line
    line.is_clear = False
    line.told.clear()
    for mode in ("stopped", "ok", "stopped"):
        stage.robot.mode = mode
        stage.runtime.run(1.0)
    assert press(stage, browser, "Set pose …").is_done
    stage.runtime.run(1.0)
    assert all(map(is_only_beat_or_answer, line.told))
    assert sum(told.beat_ms is not None for told in line.told) >= 9
    line.is_clear = True
    line.told.clear()
    stage.runtime.run(0.4)
    (news,) = [told for told in line.told if told.state is not None]
    assert news.state is not None
    assert news.state.is_stopped
    assert news.state.hint != ""


def test_while_nothing_changes_nothing_but_beats_is_told(stage: "Stage") -> None:
    line = stage.connect()
    stage.runtime.run(7.5)
    line.told.clear()
    stage.runtime.run(5.0)
    assert all(map(is_only_beat_or_answer, line.told))


# The scene.
def test_without_a_scene_a_page_knows_the_robot_and_can_stop_it(stage: "Stage") -> None:
    line = stage.connect()
    stage.runtime.run(1.0)
    state = [told.state for told in line.told if told.state is not None][-1]
    assert not state.has_scene
    assert (state.robot, state.title) == ("trolley", "Trolley")
    assert state.sentence.headline == "Ready."
    assert "93 %" in state.lines[0].headline
    bare = SimpleNamespace(line=line)
    stage.say(bare, Said(resume=Resume(id=1, at_ms=stage.now_ms, robot="trolley")))
    stage.say(bare, Said(gesture=Gesture(at_ms=stage.now_ms, released=(0.5, 0.5))))
    stage.say(bare, Said(stop=Stop(id=2, robots=["trolley"])))
    stage.runtime.run(0.5)
    assert stage.robot.mode == "stopped"
    assert {told.answer.id: told.answer.is_done for told in line.told if told.answer} == {
        1: True,
        2: True,
    }


def test_a_scene_is_claimed_once_and_by_its_own_secret_only(stage: "Stage") -> None:
    browser = stage.browse()
    session = stage.session
    thief = SimpleNamespace(line=stage.connect(1))
    for secret in (browser.secret, "", "0" * 32, browser.secret[:-1]):
        stage.say(thief, Said(scene=secret))
        stage.say(browser, Said(scene=secret))
    stage.runtime.run(0.5)
    assert stage.page(1).session.window.picture.client is None
    assert session.window.picture.client is browser


def test_secrets_are_not_to_be_guessed(stage: "Stage") -> None:
    secrets = {stage.browse(i).secret for i in range(5)}
    assert len(secrets) == 5
    assert all(len(secret) == 32 for secret in secrets)


def test_a_scene_that_went_before_it_was_claimed_cannot_be(stage: "Stage") -> None:
    browser = stage.browse()
    other = stage.browse(1)
    stage.leave(other)
    stage.viz.pages.open_scene(other)
    stage.viz.pages.close_scene(1)
    stage.say(browser, Said(scene=other.secret))
    assert stage.session.window.picture.client is browser
    assert stage.viz.pages._unclaimed == {}


def test_a_page_whose_scene_is_lost_goes_on_without_and_finds_another(stage: "Stage") -> None:
    browser = stage.browse()
    stage.session.preferences.switch_layer("costmap", is_on=True)
    assert press(stage, browser, "Go to …").is_done
    stage.runtime.run(0.5)
    controls = set(stage.page().controls.all)
    stage.viz.pages.close_scene(0)
    stage.runtime.run(0.5)
    assert not browser.line.is_closed
    assert not browser.state.has_scene
    assert stage.streams().isdisjoint({"scan", "costmap"})  # nobody sees them
    assert press(stage, browser, "Press again to cancel").is_done
    stage.runtime.run(0.5)
    assert press(stage, browser, "Go to …").is_done
    assert stage.session.pointing._plane is None
    stage.show(browser)
    stage.runtime.run(0.5)
    assert browser.state.has_scene
    assert {"scan", "costmap"} <= stage.streams()
    assert controls <= set(stage.page().controls.all)
    assert stage.session.pointing._plane is not None  # what was begun goes on
    point(stage)
    stage.say(browser, let_go(stage))
    stage.runtime.run(0.5)
    assert len(stage.robot.goals) == 1


def test_a_page_may_change_its_scene(stage: "Stage") -> None:
    """As when viser's page is loaded anew before the old connection is seen to be gone."""
    browser = stage.browse()
    old = stage.session.window.scene
    stage.show(browser)
    stage.runtime.run(0.5)
    assert stage.session.window.scene is not old


@pytest.mark.parametrize("begun", ["zone", "erase"])
def test_what_is_drawn_is_drawn_again_in_another_scene(stage: "Stage", begun: str) -> None:
    browser, session = stage.browse(), stage.session
    canvas: Any
    if begun == "zone":
        session.drawing.zone_editor.start("keepout")
        canvas = session.drawing.zone_editor._canvas
        session.drawing.zone_editor._tapped((0.0, 0.0), 0.1)
        assert canvas._dots is not None
    else:
        session.drawing.map_editor.open()
        session.drawing.map_editor.choose("erase")
        canvas = session.drawing.map_editor.pencil._canvas
        session.drawing.map_editor.pencil._tapped((0.0, 0.0), 0.1)
        stage.runtime.run(0.5)
        assert session.drawing.map_editor.hides_map
    floor = canvas._floor
    stage.viz.pages.close_scene(0)
    assert canvas._floor is None
    assert canvas._dots is None
    assert not session.drawing.map_editor.hides_map
    stage.show(browser)
    stage.runtime.run(0.5)
    assert canvas._floor is not None
    assert canvas._floor is not floor
    assert (canvas._dots is not None) == (begun == "zone")
    assert session.drawing.map_editor.hides_map == (begun == "erase")


# Gone.
def test_a_page_is_kept_for_half_a_minute_and_then_forgotten(stage: "Stage") -> None:
    browser = stage.browse()
    page = stage.page()
    streams = stage.scenes["trolley"].streams
    browser.line.close()
    stage.runtime.run(29.0)
    browser.line = stage.connect()
    stage.runtime.run(0.5)
    assert stage.page() is page
    assert browser.state.has_scene
    assert "scan" in streams.names()
    browser.line.close()
    stage.runtime.run(31.0)
    assert stage.viz.pages.all == []
    assert stage.scenes == {}
    assert streams.names() == []
    browser.line = stage.connect()
    stage.runtime.run(0.5)
    assert stage.page() is not page
    assert not browser.state.has_scene


def test_what_was_begun_at_a_page_ends_when_it_is_forgotten(stage: "Stage") -> None:
    browser, session = stage.browse(), stage.session
    session.drawing.zone_editor.start("keepout")
    browser.line.close()
    stage.runtime.run(29.0)
    assert session.drawing.zone_editor.mode != "idle"
    stage.runtime.run(2.0)
    assert session.drawing.zone_editor.mode == "idle"


def test_one_that_is_forgotten_takes_nothing_from_the_others(stage: "Stage") -> None:
    one, other = stage.browse(0), stage.browse(1)
    stage.leave(one)
    stage.runtime.run(31.0)
    assert len(stage.viz.pages.all) == 1
    assert "scan" in stage.streams()
    assert other.state.has_scene


# Gestures.
@pytest.mark.parametrize("is_word_first", [True, False])
@pytest.mark.parametrize(
    ("late_ms", "is_meant"),
    [(0.0, True), (LATE_MS - 1.0, True), (LATE_MS + 1.0, False), (-AHEAD_MS - 1.0, False)],
)
def test_what_was_let_go_long_ago_points_at_nothing(
    stage: "Stage", late_ms: float, *, is_meant: bool, is_word_first: bool
) -> None:
    browser = stage.browse()
    stage.runtime.run(2.0)
    stage.session.aiming.point_goal()
    if is_word_first:
        stage.say(browser, let_go(stage, late_ms))
        point(stage)
    else:
        point(stage)
        stage.say(browser, let_go(stage, late_ms))
    stage.runtime.run(3.0)
    assert bool(stage.robot.goals) == is_meant
    assert (stage.session.aiming.armed == "") == is_meant
    told = [title for title, _ in browser.notices if title == "Nothing was done"]
    assert len(told) == (not is_meant)


def test_only_the_page_itself_says_that_something_was_let_go(stage: "Stage") -> None:
    stage.browse(0)
    other, guest = stage.browse(1), stage.browse(2, GUEST)
    stage.session.aiming.point_goal()
    for somebody in (other, guest):
        stage.say(somebody, let_go(stage))
    point(stage)
    for somebody in (other, guest):
        stage.say(somebody, let_go(stage))
    stage.runtime.run(3.0)
    assert stage.robot.goals == []


def test_what_is_let_go_while_the_line_is_lost_points_at_nothing(stage: "Stage") -> None:
    browser = stage.browse()
    stage.session.aiming.point_goal()
    browser.line.close()
    stage.runtime.run(0.1)
    point(stage)
    stage.say(browser, let_go(stage))
    stage.runtime.run(3.0)
    assert stage.robot.goals == []
