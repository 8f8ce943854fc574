"""What one browser asks of a robot, and how it is taken back."""

import re
from typing import TYPE_CHECKING, Any

import pytest
from support.pages import page_of

from trolley import topics
from trolley.geometry import Pose2D
from trolley.messages import (
    GoalStatus,
    SavedPose,
    SavedPoses,
    Stop,
    Tour,
    Tours,
    TourStatus,
    Zone,
    Zones,
)
from trolley.messages.mapping import PoseState
from trolley_viz.controls.tiles import MAX_TILES
from trolley_viz.features.driving.aiming import GO_TO, QUEUE_GOALS
from trolley_viz.features.driving.robot_actions import what_is_under_way
from trolley_viz.features.driving.search import ADVICE
from trolley_viz.pages.known import robot_state, state_lines
from trolley_viz.pointing.pointer import Pointed
from trolley_viz.robots.silence import SILENT_NS, SilentServices
from trolley_viz.robots.situation import situation
from trolley_viz.session.session import Session

if TYPE_CHECKING:
    from ...conftest import Stage


@pytest.fixture
def session(stage: "Stage") -> Session:
    stage.browse()
    return stage.session


def undo(stage: "Stage", session: Session) -> None:
    session.actions.history.undo()
    stage.runtime.run(0.3)


def go(stage: "Stage", session: Session, x: float) -> None:
    session.aiming._go_to(Pointed(x, 1.0, 0.5))
    stage.runtime.run(0.3)


def test_a_goal_is_taken_back_by_canceling_it(stage: "Stage", session: Session) -> None:
    go(stage, session, 1.0)
    assert session.actions.history.last() is not None
    undo(stage, session)
    goal = session.view.streams.latest(topics.GOAL)
    assert goal is not None
    assert (goal.id, goal.state) == (stage.robot.goals[0].id, "canceled")


def test_a_goal_in_place_of_another_is_taken_back_to_it(stage: "Stage", session: Session) -> None:
    go(stage, session, 1.0)
    go(stage, session, 2.0)
    undo(stage, session)
    first, second, again = stage.robot.goals
    assert again.pose == first.pose
    assert len({first.id, second.id, again.id}) == 3


def test_what_one_robot_was_sent_is_not_taken_back_with_the_next(
    stage: "Stage", session: Session
) -> None:
    kart = stage.runtime.add(type(stage.robot)(), robot="kart")
    go(stage, session, 1.0)
    session.aiming._go_to(Pointed(2.0, 1.0, 0.5))
    session.follow("kart")  # before it is answered
    stage.runtime.run(0.5)
    assert len(stage.robot.goals) == 2
    undo(stage, session)
    assert kart.goals == []


def test_a_goal_that_is_over_is_not_taken_back(stage: "Stage", session: Session) -> None:
    go(stage, session, 1.0)
    stage.robot._say_goal("another", "driving", Pose2D.identity())
    stage.runtime.run(0.3)
    assert session.actions.history.last() is None


def test_a_pose_is_set_back_to_where_the_robot_has_come_to(
    stage: "Stage", session: Session
) -> None:
    session.aiming.set_pose(Pointed(-1.0, -1.0, 0.0))
    stage.runtime.run(0.3)
    stage.robot.driven_m = 0.25
    stage.runtime.run(0.3)
    undo(stage, session)
    there, back = stage.robot.poses_set
    assert (there.pose.x, there.pose.y) == (-1.0, -1.0)
    assert back.pose.x == pytest.approx(1.75)  # 1.5 before, and 0.25 driven since then
    assert back.pose.y == pytest.approx(0.0)


def test_how_a_pose_was_corrected_is_told_once(stage: "Stage") -> None:
    browser, session = stage.browse(), stage.session
    stage.runtime.run(0.5)
    session.aiming.set_pose(Pointed(1.2, 0.4, 0.0))
    stage.robot.driven_m = 0.5  # it drives on meanwhile
    stage.runtime.run(1.5)
    ((title, text),) = browser.notices
    assert title == "It knows where it is"
    assert re.fullmatch(r"It took 0\.\d s\. It is 50 cm and 0° from where you set it\.", text)


FOUND = r"It took 0\.\d s\. It is 1\.1 m from kitchen\."


@pytest.mark.parametrize(
    ("state", "title", "text"),
    [
        ("localized", "It knows where it is", FOUND),
        ("lost", "Not found", re.escape(ADVICE)),
        ("searching", "Not sure yet", re.escape(ADVICE)),
    ],
)
def test_it_is_told_that_a_search_has_begun_and_once_what_came_of_it(
    stage: "Stage", state: PoseState, title: str, text: str
) -> None:
    browser = stage.browse()
    stage.session.actions.find()
    stage.runtime.run(0.5)
    assert [one for one, _ in browser.notices] == ["Searching"]
    stage.robot.pose_state = state
    stage.runtime.run(25.0)
    _, (said_title, said_text) = browser.notices
    assert said_title == title
    assert re.fullmatch(text, said_text)


def test_a_search_is_given_up_on_although_no_estimate_comes(
    stage: "Stage", monkeypatch: pytest.MonkeyPatch
) -> None:
    browser = stage.browse()
    stage.robot.pose_state = "searching"
    last = stage.robot.estimate()
    with monkeypatch.context() as scanless:
        scanless.setattr(stage.robot, "estimate", lambda: last)
        stage.session.actions.find()
        stage.runtime.run(25.0)
        assert browser.notices[1:] == [("Not sure yet", ADVICE)]
    stage.robot.pose_state = "localized"
    stage.runtime.run(1.0)
    assert len(browser.notices) == 2


def test_a_robot_found_at_a_place_or_in_a_room_is_said_to_be_there(stage: "Stage") -> None:
    browser = stage.browse()
    here = SavedPose(name="dock", map="room", pose=Pose2D(1.6, 0.1, 0.0))
    stage.robot.publish(topics.POSES, SavedPoses(stamp_ns=1, poses=[here]))
    stage.session.actions.find()
    stage.runtime.run(0.3)
    stage.robot.pose_state = "localized"
    stage.runtime.run(0.5)
    assert browser.notices[-1][1].endswith("It is at dock.")
    corners = [(-3.0, -2.0), (3.0, -2.0), (3.0, 2.0), (-3.0, 2.0)]
    hall = Zone(name="hall", kind="room", points=corners)
    stage.robot.publish(topics.ZONES, Zones(stamp_ns=0, map="room", zones=[hall]))
    stage.session.actions.find()
    stage.runtime.run(0.3)
    stage.robot.pose_state = "localized"
    stage.runtime.run(0.5)
    assert browser.notices[-1][1].endswith("It is in “hall”.")


def test_after_a_restart_of_the_base_there_is_no_way_back(stage: "Stage", session: Session) -> None:
    session.aiming.set_pose(Pointed(-1.0, -1.0, 0.0))
    stage.runtime.run(0.3)
    assert session.actions.history.last() is not None
    stage.robot.epoch = 10**18
    stage.runtime.run(1.0)
    assert session.actions.history.last() is None


def test_several_places_are_driven_as_one_tour(stage: "Stage", session: Session) -> None:
    actions = session.actions
    actions.goal_queue.collect(is_on=True)
    session.aiming.point_queue()
    actions.choose_place("kitchen")
    session.aiming._line_up(Pointed(1.0, 1.0, 0.5))
    assert session.aiming.armed == QUEUE_GOALS  # for the next one
    stage.runtime.run(0.3)
    assert stage.robot.goals == []
    assert len(stage.drawn()._goal_pins._nodes) == 4  # an arrow and a number each
    actions.start_goal_queue()
    stage.runtime.run(0.3)
    (started,) = stage.robot.tours
    assert started.tour is not None
    assert [stop.name for stop in started.tour.stops] == ["kitchen", None]
    assert not actions.goal_queue.is_collecting
    over = TourStatus(stamp_ns=stage.viz.monotonic_ns, name=None, trip="t1", state="done")
    stage.robot.publish(topics.TOUR, over)
    stage.runtime.run(0.3)
    assert actions.goal_queue.items == ()
    assert stage.drawn()._goal_pins._nodes == []


def test_who_follows_another_robot_leaves_all_behind(stage: "Stage", session: Session) -> None:
    go(stage, session, 1.0)
    session.actions.goal_queue.collect(is_on=True)
    session.actions.choose_place("kitchen")
    session.aiming.point_goal()
    session.follow("kart")
    assert session.actions.history.last() is None
    assert session.actions.goal_queue.items == ()
    assert session.aiming.armed == ""


def test_the_way_is_looked_for_where_the_pointer_came_to_rest(
    stage: "Stage", session: Session
) -> None:
    asked: list[Any] = []
    session.aiming._service = AccessRequest(session.aiming._service, asked)  # type: ignore[assignment]
    for x in (1.0, 1.1, 1.2, 1.3):
        session.aiming._preview_moved(Pointed(x, 0.0, 0.0))
    stage.runtime.run(1.0)
    assert [one.pose.x for one in asked] == [1.0, 1.3]


class AccessRequest:
    """Answers what it is asked at once."""

    def __init__(self, service: Any, asked: list[Any]) -> None:
        self._service, self._asked = service, asked

    def __getattr__(self, name: str) -> Any:
        return getattr(self._service, name)

    def request(self, request: Any, params: Any, then: Any, **_: Any) -> None:
        from trolley.codes import Refused

        self._asked.append(params)
        then(Refused("no_path"))


def goal(state: str, goal_id: str = "a") -> GoalStatus:
    return GoalStatus(stamp_ns=1, id=goal_id, state=state)  # type: ignore[arg-type]


def trip(state: str) -> TourStatus:
    return TourStatus(stamp_ns=1, name="t", trip="t1", state=state)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("now", "tour", "what"),
    [
        (None, None, ""),
        (goal("idle"), trip("done"), ""),
        (goal("driving"), None, "goal"),
        (goal("paused"), trip("idle"), "goal"),
        (goal("driving", "tour-t1-0-0"), trip("driving"), "trip"),
        (goal("arrived", "tour-t1-0-0"), trip("dwelling"), "trip"),
        (goal("driving"), trip("paused"), "goal"),
        (goal("arrived"), trip("paused"), "trip"),
    ],
)
def test_the_buttons_are_for_what_is_under_way(
    now: GoalStatus | None, tour: TourStatus | None, what: str
) -> None:
    assert what_is_under_way(now, tour) == what


def test_each_key_does_one_thing(stage: "Stage", session: Session) -> None:
    keys = page_of(stage).keys
    assert len(keys) == len(set(keys))
    assert not {" ", "s", "j"} & set(keys)  # Stop and the joystick have them
    page_of(stage).press_key("g")
    assert session.aiming.armed == GO_TO
    page_of(stage).press_key("escape")
    assert session.aiming.armed == ""


def test_nothing_under_way_is_nothing_to_pause(stage: "Stage") -> None:
    browser = stage.browse()
    for action in ("Pause", "Continue", "Cancel"):
        stage.session.actions.steer(action)
    assert [title for title, _ in browser.notices] == [
        "Pause: not done",
        "Continue: not done",
        "Cancel: not done",
    ]


def test_a_service_that_falls_silent_is_missed(stage: "Stage", session: Session) -> None:
    here = session.view.placement.world_T_base
    assert here is not None
    stage.robot._say_goal("a", "driving", here)
    stage.runtime.run(0.5)
    tile = page_of(stage).within("Go")

    def said() -> str:
        return situation(robot_state(session.view)).headline

    assert "on its way" in said()
    assert not tile.button("kitchen").is_disabled
    stage.robot.alive.remove("planner")
    stage.runtime.run(6.0)
    assert "the planner is not running" in said()
    lines = [line.headline for line in state_lines(robot_state(session.view))]
    assert "No planner" in lines
    assert lines[-1].startswith("Driving to the place on the map · ")
    assert tile.button("kitchen").is_disabled


def test_while_it_is_stopped_nothing_sets_it_off_but_drive_on(
    stage: "Stage", session: Session
) -> None:
    page, here = page_of(stage), session.view.placement.world_T_base
    assert here is not None
    tour = Tour(name="round", stops=[Stop(name="kitchen")])
    stage.robot.publish(topics.TOURS, Tours(stamp_ns=1, tours=[tour]))
    stage.robot.alive.append("tour")
    stage.robot._say_goal("a", "paused", here)
    stage.robot.mode = "stopped"
    stage.runtime.run(1.0)
    assert page.within("Go").button("Continue").is_disabled
    for label in ("kitchen", "round", "Go to …", "Follow somebody"):
        assert page.within("Go").button(label).is_disabled, label
    assert page.within("Tours").button("Start").off == ("Start",)
    assert not page.within("Go").button("Cancel").is_disabled
    stage.robot.mode = "ok"
    stage.runtime.run(0.5)
    assert not page.within("Go").button("Continue").is_disabled
    assert not page.within("Go").button("kitchen").is_disabled
    assert page.within("Tours").button("Start").off == ()


def test_a_service_that_was_never_heard_is_missed_after_a_while() -> None:
    services = SilentServices()
    assert not services.update({}, 0)
    assert not services.update({}, SILENT_NS)
    assert services.update({}, SILENT_NS + 1) == {"localizer", "planner"}


def test_tours_of_another_map_are_not_offered(stage: "Stage", session: Session) -> None:
    stops = [Stop(name="kitchen")]
    tours = [Tour(name="upstairs", stops=stops, map="loft"), Tour(name="round", stops=stops)]
    stage.robot.publish(topics.TOURS, Tours(stamp_ns=1, tours=tours))
    stage.runtime.run(0.5)
    page = page_of(stage).within("Go")
    assert "round" in page.labels
    assert "upstairs" not in page.labels


def put_places(stage: "Stage", names: list[str], icon: str = "") -> None:
    here = Pose2D(0.0, 0.0, 0.0)
    poses = [SavedPose(name=name, map="room", pose=here, icon=icon) for name in names]
    stage.robot.publish(topics.POSES, SavedPoses(stamp_ns=1, poses=poses))
    stage.runtime.run(0.5)


def test_there_is_a_button_for_each_place(stage: "Stage", session: Session) -> None:
    page = page_of(stage).within("Go")
    assert page.button("kitchen").icon == "map-pin"
    put_places(stage, ["kitchen"], icon="coffee")
    assert page.button("kitchen").icon == "coffee"
    put_places(stage, ["<b>bed</b>", "Äpfel", "kitchen"], icon="no such icon")
    assert page.labels[2:5] == ["<b>bed</b>", "kitchen", "Äpfel"]
    put_places(stage, [f"place {i:03}" for i in range(MAX_TILES + 7)])
    assert sum(one.startswith("place ") for one in page.labels) == MAX_TILES
    assert "and 7 more" in page.text()
    put_places(stage, [])
    assert "No places saved yet." in page.text()


def test_nothing_is_asked_of_a_robot_that_is_away(stage: "Stage", session: Session) -> None:
    page = page_of(stage).within("Go")
    asking = ("Go to …", "Set pose …", "Find position", "Follow somebody")
    assert not any(page.button(label).is_disabled for label in asking)
    put_places(stage, [])
    stage.runtime.kill("base")
    stage.runtime.run(1.5)
    assert all(page.button(label).is_disabled for label in asking)
    assert "No places saved yet." not in page.text()  # nobody knows


def test_the_place_that_it_drives_to_stands_out(stage: "Stage", session: Session) -> None:
    page = page_of(stage).within("Go")
    page.press("kitchen")
    stage.runtime.run(0.3)
    assert stage.robot.goals[-1].name == "kitchen"
    stage.robot._say_goal("a", "driving", Pose2D(2.0, 1.0, 0.0))
    stage.runtime.run(0.5)
    assert page.button("kitchen").colour == "green"
    page.press("Cancel")
    stage.runtime.run(0.5)
    assert page.button("kitchen").colour == "purple"
    assert page.button("Cancel").is_disabled


def test_the_form_shows_what_others_change(stage: "Stage", session: Session) -> None:
    form = page_of(stage).within("Places")
    form.choose("Place", "kitchen")
    stage.runtime.run(0.3)
    assert (form.value("Name"), form.value("Icon")) == ("kitchen", "pin")
    put_places(stage, ["kitchen"], icon="tools-kitchen-2")
    assert form.value("Icon") == "kitchen"
    put_places(stage, ["kitchen"], icon="pizza")
    assert form.value("Icon") == "pizza"  # not among those that are offered
    put_places(stage, ["door"])
    assert form.value("Name") == ""
    assert not form.is_shown("Delete")


def test_several_places_are_chosen_and_started_from_the_page(
    stage: "Stage", session: Session
) -> None:
    page = page_of(stage)
    queue = page.within("Several places in a row")
    assert queue.button("Start").is_disabled
    queue.press("Choose places …")
    page.within("Go").press("kitchen")
    stage.runtime.run(0.3)
    assert "Press places here or on the map, then press Start. kitchen" in queue.text()
    queue.press("Start")
    stage.runtime.run(0.3)
    (started,) = stage.robot.tours
    assert started.tour is not None
    assert [stop.name for stop in started.tour.stops] == ["kitchen"]
    assert session.aiming.armed == ""
