"""Touching the map: what is found there, and what its card does."""

import asyncio
import math
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from support.pages import PageOf, page_of

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.geometry import Pose2D
from trolley.messages import Path, SavedPose, SavedPoses, Zone, Zones
from trolley.messages.request_params import SendGoal
from trolley.runtime.service import Service, answers
from trolley_viz.features.touch.touched import touched
from trolley_viz.graphics import camera
from trolley_viz.scene.place_labels import Eye
from trolley_viz.server.messages import Gesture, Press, Said, Stop
from trolley_viz.server.visitors import Visitor

if TYPE_CHECKING:
    from ...conftest import Stage

SIZE = (1200.0, 800.0)
KITCHEN = (2.0, 1.0)
"""Where the pretended robot's only place is on this map [m]."""
ROBOT = (1.5, 0.0)


class Refusing(Service):
    """Finds a way to nowhere."""

    name = "planner"

    @answers(requests.GOAL_PREVIEW)
    def preview(self, _: SendGoal) -> Path:
        raise Refused(codes.NO_PATH)


def eye_over(x: float, y: float, height: float = 6.0) -> Eye:
    """A camera that looks straight down, north up."""
    position = np.array([x, y, height])
    return Eye(position, np.array([0.0, 1.0, 0.0, 0.0]), camera.FIELD_OF_VIEW, SIZE)


def seen_at(eye: Eye, x: float, y: float) -> tuple[float, float]:
    """Where a camera that looks straight down sees a point of the floor."""
    half = float(eye.position[2]) * math.tan(0.5 * eye.fov)
    right, up = x - float(eye.position[0]), y - float(eye.position[1])
    return 0.5 + 0.5 * right / (half * SIZE[0] / SIZE[1]), 0.5 - 0.5 * up / half


@pytest.fixture
def page(stage: "Stage") -> PageOf:
    browser = stage.browse()
    stage.say(browser, Said(gesture=Gesture(at_ms=stage.now_ms, size=SIZE)))
    browser.camera.fov = camera.FIELD_OF_VIEW
    browser.camera.position = eye_over(0.0, 0.0).position
    return page_of(stage)


def tap(stage: "Stage", x: float, y: float, **how: Any) -> None:
    """Tap on a point of the floor, as the browser's camera sees it."""
    browser = stage.browsers[0]
    at = seen_at(eye_over(0.0, 0.0), x, y)
    gesture = Gesture(at_ms=stage.now_ms, released=at, is_tap=how.pop("is_tap", True))
    stage.say(browser, Said(gesture=gesture))
    stage.runtime.run(0.5)


@pytest.mark.parametrize(
    ("at", "what", "name"),
    [
        (KITCHEN, "place", "kitchen"),
        ((KITCHEN[0] + 0.3, KITCHEN[1]), "place", "kitchen"),
        ((KITCHEN[0] + 0.6, KITCHEN[1]), "floor", ""),
        (ROBOT, "robot", "trolley"),
        ((-1.5, -1.0), "zone", "carpet"),
        ((-2.05, 1.0), "zone", "mirror"),
        ((-2.6, 1.0), "floor", ""),
    ],
)
def test_what_lies_under_the_finger_is_found(
    stage: "Stage", page: PageOf, at: tuple[float, float], what: str, name: str
) -> None:
    zones = [
        Zone(name="carpet", kind="speed", points=[(-2, -1.5), (-1, -1.5), (-1, -0.5), (-2, -0.5)]),
        Zone(name="mirror", kind="mirror", points=[(-2.0, 0.5), (-2.0, 1.5)]),
    ]
    stage.robot.publish(topics.ZONES, Zones(stamp_ns=0, map="room", zones=zones))
    stage.runtime.run(0.5)
    eye = eye_over(0.0, 0.0)
    found = touched(stage.session.view, eye, seen_at(eye, *at))
    assert found is not None
    assert (found.what, found.name) == (what, name)
    assert (found.x, found.y) == pytest.approx(at, abs=1e-6)


def test_a_place_can_be_touched_while_the_robot_stands_on_it(stage: "Stage", page: PageOf) -> None:
    """It is to be edited or added to a tour; of its robot the card has less to offer."""
    here = SavedPose(name="dock", map="room", pose=Pose2D(*ROBOT, 0.0))
    stage.robot.publish(topics.POSES, SavedPoses(stamp_ns=1, poses=[here]))
    stage.runtime.run(0.5)
    eye = eye_over(0.0, 0.0)
    found = touched(stage.session.view, eye, seen_at(eye, *ROBOT))
    assert found is not None
    assert (found.what, found.name) == ("place", "dock")


def test_a_finger_reaches_as_far_on_the_screen_from_wherever_one_looks(
    stage: "Stage", page: PageOf
) -> None:
    for height in (3.0, 6.0, 30.0):
        eye = eye_over(0.0, 0.0, height)
        u, v = seen_at(eye, KITCHEN[0] + 0.21, KITCHEN[1])  # the edge of its icon
        near = touched(stage.session.view, eye, (u + 20.0 / SIZE[0], v))
        far = touched(stage.session.view, eye, (u + 24.0 / SIZE[0], v))
        assert near is not None
        assert far is not None
        assert (near.what, far.what) == ("place", "floor")


def test_above_the_horizon_there_is_nothing(stage: "Stage", page: PageOf) -> None:
    flat = Eye(np.array([0.0, -5.0, 1.0]), np.array([0.707, -0.707, 0.0, 0.0]), 0.7, SIZE)
    assert touched(stage.session.view, flat, (0.5, 0.1)) is None
    assert touched(stage.session.view, flat, (0.5, 0.9)) is not None


def test_a_place_is_driven_to(stage: "Stage", page: PageOf) -> None:
    tap(stage, *KITCHEN)
    card = page.within("kitchen")
    assert not card.is_shown("Save place")
    card.press("Go")
    stage.runtime.run(0.5)
    assert stage.robot.goals[-1].name == "kitchen"
    assert not page.is_shown("Look closer")


def test_what_the_robot_cannot_reach_is_not_offered_to_go_to(stage: "Stage", page: PageOf) -> None:
    tap(stage, -1.0, 0.5)
    assert not page.within("Here").button("Go").is_disabled
    stage.runtime.add(Refusing())
    tap(stage, -1.2, 0.5)
    assert "There is no path there" in page.within("Here").text()
    assert page.within("Here").button("Go").is_disabled
    tap(stage, *ROBOT)
    assert page.within("Trolley").text() == "This robot."


def test_the_floor_is_driven_to_and_saved_and_is_where_the_robot_is(
    stage: "Stage", page: PageOf
) -> None:
    tap(stage, -1.0, 0.5)
    page.within("Here").press("Go")
    stage.runtime.run(0.5)
    goal = stage.robot.goals[-1]
    assert goal.pose is not None
    assert (goal.pose.x, goal.pose.y) == pytest.approx((-1.0, 0.5), abs=1e-6)
    assert goal.yaw_tolerance >= math.pi
    tap(stage, -1.0, -0.5)
    page.within("Here").press("The robot is here")
    stage.runtime.run(0.5)
    pose = stage.robot.poses_set[-1].pose
    assert (pose.x, pose.y, pose.yaw) == pytest.approx((-1.0, -0.5, 0.0), abs=1e-6)


def test_the_floor_of_a_room_is_called_after_it(stage: "Stage", page: PageOf) -> None:
    corners = [(-3.0, -2.0), (3.0, -2.0), (3.0, 2.0), (-3.0, 2.0)]
    rooms = [
        Zone(name="hall", kind="room", points=corners),
        Zone(name="corner", kind="room", points=[(-3, 0), (-0.5, 0), (-0.5, 2), (-3, 2)]),
    ]
    stage.robot.publish(topics.ZONES, Zones(stamp_ns=0, map="room", zones=rooms))
    stage.runtime.run(0.5)
    tap(stage, -1.0, 0.5)
    assert page.within("corner").is_shown("Edit")
    page.within("corner").press("Go")
    stage.runtime.run(0.5)
    goal = stage.robot.goals[-1]
    assert goal.pose is not None
    assert (goal.pose.x, goal.pose.y) == pytest.approx((-1.0, 0.5), abs=1e-6)
    tap(stage, *KITCHEN)
    assert page.within("kitchen").is_shown("Go")
    tap(stage, 1.0, -1.5)
    page.within("hall").press("Edit")
    stage.runtime.run(0.5)
    assert stage.session.drawing.zone_editor.selected is not None
    assert stage.session.drawing.zone_editor.selected.name == "hall"


def test_whoever_stands_on_the_floor_is_followed(stage: "Stage", page: PageOf) -> None:
    tap(stage, -1.0, 0.5)
    page.within("Here").press("Follow who is here")
    stage.runtime.run(0.5)
    page.press("Follow somebody")
    stage.runtime.run(0.5)
    there, anybody = stage.robot.followed
    assert there.point == pytest.approx((-1.0, 0.5), abs=1e-6)
    assert there.frame == "map"
    assert anybody.point is None
    state = stage.browse(1).state
    assert state.sentence.headline == "It is following the person."


def test_a_press_that_is_no_tap_touches_nothing(stage: "Stage", page: PageOf) -> None:
    tap(stage, *KITCHEN, is_tap=False)
    assert not page.is_shown("Look closer")


def test_while_a_tool_waits_the_tap_is_the_tools(stage: "Stage", page: PageOf) -> None:
    page.press("Go to …")
    tap(stage, *KITCHEN)
    assert not page.is_shown("Look closer")


def clicked(plane: Any, x: float, y: float, at: tuple[float, float]) -> None:
    """Do what viser does when a press on an unseen floor ends there."""
    event = SimpleNamespace(ray_origin=(x, y, 6.0), ray_direction=(0, 0, -1), screen_pos=at)
    asyncio.run(plane._impl.click_cb[0].callback(event))


def test_a_tap_that_the_scene_has_missed_counts_for_the_tool_once(
    stage: "Stage", page: PageOf
) -> None:
    """A slow browser shows the hint of a tool before its scene has the floor that takes the tap."""
    page.press("Go to …")
    plane = stage.session.pointing._plane
    tap(stage, -1.0, 0.5)
    stage.runtime.run(0.5)
    (goal,) = stage.robot.goals
    assert goal.pose is not None
    assert (goal.pose.x, goal.pose.y) == pytest.approx((-1.0, 0.5), abs=1e-6)
    assert not page.is_shown("Look closer")
    page.press("Go to …")
    clicked(plane, -1.0, 0.5, seen_at(eye_over(0.0, 0.0), -1.0, 0.5))  # it tells of it late
    stage.runtime.run(3.0)
    assert len(stage.robot.goals) == 1
    assert stage.session.aiming.armed


def test_a_tap_of_which_the_scene_tells_is_taken_from_there(stage: "Stage", page: PageOf) -> None:
    page.press("Go to …")
    at = seen_at(eye_over(0.0, 0.0), -1.0, 0.5)
    clicked(stage.session.pointing._plane, -1.1, 0.5, at)  # it knows best where its camera is
    stage.runtime.run(0.1)
    tap(stage, -1.0, 0.5)
    stage.runtime.run(1.0)
    (goal,) = stage.robot.goals
    assert goal.pose is not None
    assert goal.pose.x == pytest.approx(-1.1)
    assert not page.is_shown("Look closer")


def test_what_is_pressed_after_a_tap_is_done_after_it(stage: "Stage", page: PageOf) -> None:
    page.press("Choose places …")
    at = seen_at(eye_over(0.0, 0.0), -1.0, 0.5)
    browser = stage.browsers[0]
    gesture = Gesture(at_ms=stage.now_ms, released=at, is_tap=True)
    stage.say(browser, Said(gesture=gesture))
    (kitchen,) = [id_ for id_, one in stage.page().controls.all.items() if one.label == "kitchen"]
    stage.say(browser, Said(press=Press(id=1, at_ms=stage.now_ms, control=kitchen)))
    stage.runtime.run(1.0)
    titles = [one.title for one in stage.session.actions.goal_queue.items]
    assert titles == ["x -1.0 m, y 0.5 m", "kitchen"]


def test_places_that_are_pressed_in_a_row_keep_their_names(stage: "Stage", page: PageOf) -> None:
    page.press("Choose places …")
    for at in (KITCHEN, (-1.0, 0.5), (KITCHEN[0] + 0.3, KITCHEN[1])):
        tap(stage, *at)
        stage.runtime.run(1.0)
    tour = stage.session.actions.goal_queue.tour()
    assert tour is not None
    assert [stop.name for stop in tour.stops] == ["kitchen", None, "kitchen"]


def test_choosing_several_places_has_a_hint_of_its_own(stage: "Stage", page: PageOf) -> None:
    page.press("Choose places …")
    stage.runtime.run(0.5)
    assert page.is_shown("Go to …")
    assert stage.session.hint == "Press the places in order, then press Start."
    page.press("Done choosing")
    stage.runtime.run(0.5)
    assert stage.session.hint == ""


def test_a_tap_before_stop_is_forgotten(stage: "Stage", page: PageOf) -> None:
    page.press("Go to …")
    at = seen_at(eye_over(0.0, 0.0), -1.0, 0.5)
    browser = stage.browsers[0]
    gesture = Gesture(at_ms=stage.now_ms, released=at, is_tap=True)
    stage.say(browser, Said(gesture=gesture))
    stage.say(browser, Said(stop=Stop(id=1, robots=["trolley"])))
    stage.runtime.run(3.0)
    assert stage.robot.goals == []


def test_a_corner_that_the_scene_has_missed_is_drawn(stage: "Stage", page: PageOf) -> None:
    stage.session.drawing.zone_editor.start("keepout")
    tap(stage, -1.0, 0.5)
    tap(stage, 0.5, 0.5)
    stage.runtime.run(1.0)
    sketch = stage.session.drawing.zone_editor.sketch
    assert sketch is not None
    assert np.array(sketch.points) == pytest.approx(np.array([(-1.0, 0.5), (0.5, 0.5)]), abs=1e-6)


def test_who_only_looks_gets_no_card(stage: "Stage") -> None:
    browser = stage.browse(0, Visitor("guest", "viewer"))
    browser.camera.fov = camera.FIELD_OF_VIEW
    tap(stage, *KITCHEN)
    assert stage.session.touching.touched is None


def test_another_touch_and_escape_and_the_cross_close_it(stage: "Stage", page: PageOf) -> None:
    tap(stage, *KITCHEN)
    tap(stage, -1.0, 0.5)
    assert page.within("Here").is_shown("Save place")
    page.press_key("escape")
    stage.runtime.run(0.5)
    assert not page.is_shown("Look closer")
    tap(stage, *KITCHEN)
    cards = [one for one in stage.page().controls.all.values() if one.look.kind == "card"]
    (card,) = [one for one in cards if one.visible]
    stage.page().controls.handle(card.id, None)
    stage.runtime.run(0.5)
    assert not page.is_shown("Look closer")


def test_another_tab_closes_it(stage: "Stage", page: PageOf) -> None:
    tap(stage, *KITCHEN)
    assert page.is_shown("Look closer")
    page.within("More")
    assert not page.is_shown("Look closer")


def test_a_tour_is_made_by_touching_places_in_order(stage: "Stage", page: PageOf) -> None:
    bath = SavedPose(name="bath", map="room", pose=Pose2D(-1.0, 1.0, 0.0))
    kitchen = SavedPose(name="kitchen", map="room", pose=Pose2D(*KITCHEN, 0.0))
    stage.robot.publish(topics.POSES, SavedPoses(stamp_ns=0, poses=[kitchen, bath]))
    stage.runtime.run(0.5)
    tap(stage, *KITCHEN)
    page.within("kitchen").press("Add to tour")
    stage.runtime.run(0.5)
    tap(stage, -1.0, 1.0)
    tap(stage, -2.0, -0.5)
    assert not page.is_shown("Look closer")  # they were added at once
    assert list(dict.fromkeys(one for one in page.labels if one[:1] in "123")) == [
        "1  kitchen",
        "2  bath",
        "3  a point on the map",
    ]


def test_the_card_leads_to_where_a_place_is_changed(stage: "Stage", page: PageOf) -> None:
    tap(stage, *KITCHEN)
    page.within("kitchen").press("Edit")
    stage.runtime.run(0.5)
    assert page.value("Place") == "kitchen"
    (tabs,) = [one for one in stage.page().controls.all.values() if one.look.kind == "tabs"]
    opened = stage.page().controls.all[int(tabs.look.value)]  # type: ignore[arg-type]
    assert opened.label == "Map"


# The camera.
def stands_at(stage: "Stage") -> Any:
    at = stage.browsers[0].camera
    return SimpleNamespace(position=np.array(at.position), look_at=np.array(at.look_at))


def test_the_camera_follows_the_robot_and_turns_with_it(stage: "Stage", page: PageOf) -> None:
    page.press("Follow the robot")
    stage.runtime.run(0.5)
    first = stands_at(stage)
    assert first.look_at[:2].tolist() == pytest.approx(ROBOT)
    stage.browsers[0].camera.position = first.position + np.array(
        [0.0, -1.0, 1.0]
    )  # as a person turns it
    stage.robot.driven_m = 1.0
    stage.runtime.run(0.5)
    second = stands_at(stage)
    assert (second.look_at - first.look_at).tolist() == pytest.approx([1.0, 0.0, 0.0])
    assert (second.position - first.position).tolist() == pytest.approx([1.0, -1.0, 1.0])
    page.press("Turn with the robot")
    stage.runtime.run(0.5)
    third = stands_at(stage)
    behind = third.look_at - third.position
    assert math.atan2(behind[1], behind[0]) == pytest.approx(0.0, abs=1e-6)  # as it faces
    page.press("Stop following the robot")
    stage.robot.driven_m = 3.0
    stage.runtime.run(0.5)
    assert stands_at(stage).position.tolist() == third.position.tolist()


def test_the_map_is_seen_from_above_with_north_up(stage: "Stage", page: PageOf) -> None:
    page.press("Look from above")
    stage.runtime.run(0.5)
    at = stands_at(stage)
    down = at.look_at - at.position
    assert math.hypot(down[0], down[1]) < 0.01 * abs(down[2])
    assert down[1] > 0.0
    page.press("Look from the side")
    stage.runtime.run(0.5)
    at = stands_at(stage)
    down = at.look_at - at.position
    assert down[1] > 0.2 * abs(down[2])
