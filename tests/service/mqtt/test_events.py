"""What is told of what has just happened, and the picture of the map."""

import io
import json
import sys
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from msgspec import structs
from PIL import Image

from trolley import codes, topics
from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley.gridmap.wire import map_message
from trolley.messages import (
    BaseState,
    Battery,
    GoalStatus,
    OccupancyGrid,
    SavedPose,
    SavedPoses,
    TourStatus,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from .conftest import Bridge

BASE = "trolley/robby"


def events(bridge: "Bridge") -> list[dict[str, Any]]:
    topic = f"{BASE}/event"
    return [json.loads(payload) for name, payload in bridge.broker.published if name == topic]


def kinds(bridge: "Bridge") -> list[str]:
    return [one["event_type"] for one in events(bridge)]


def test_each_end_is_told_once_with_its_reason(bridge: "Bridge") -> None:
    assert events(bridge) == []
    bridge.robot.goal = GoalStatus(stamp_ns=0, id="a", state="driving")
    bridge.run(1.5)
    bridge.robot.goal = GoalStatus(stamp_ns=0, id="a", state="arrived")
    bridge.run(3.0)
    bridge.robot.goal = GoalStatus(
        stamp_ns=0, id="b", state="failed", reason=codes.NO_PATH, message="The door is closed."
    )
    bridge.run(3.0)
    assert kinds(bridge) == ["arrived", "failed"]
    assert events(bridge)[1]["reason"] == codes.NO_PATH
    assert events(bridge)[1]["message"] == "The door is closed."


def test_what_lasts_less_than_a_second_is_told_as_well(bridge: "Bridge") -> None:
    """A tour whose stops are not stayed at goes on within half a second."""
    for number in range(5):
        goal = GoalStatus(stamp_ns=0, id=f"tour-t-{number}-1", state="driving")
        bridge.robot.goal = goal
        bridge.run(3.3)
        end = "failed" if number == 3 else "arrived"
        bridge.robot.goal = structs.replace(goal, state=end, reason=codes.BLOCKED)
        bridge.run(0.2)
    bridge.run(1.0)
    assert kinds(bridge) == ["arrived", "arrived", "arrived", "failed", "arrived"]


def test_a_tour_that_waits_for_somebody_or_is_done_is_told(bridge: "Bridge") -> None:
    for state in ("driving", "waiting", "driving", "done"):
        bridge.robot.trip = TourStatus(stamp_ns=0, name="evening", trip="t", state=state)
        bridge.run(1.5)
    assert kinds(bridge) == ["waiting", "tour_done"]
    assert {one["tour"] for one in events(bridge)} == {"evening"}


def test_a_planner_that_is_missing_is_told_of_once_and_hides_no_other_alarm(
    bridge: "Bridge",
) -> None:
    bridge.robot.has_planner = False
    bridge.run(40.0)
    for base in (
        BaseState(stamp_ns=0, mode="ok", source="teleop"),
        BaseState(stamp_ns=0, mode="ok"),
        BaseState(stamp_ns=0, mode="fault", reason=codes.LINK_LOST),
        BaseState(stamp_ns=0, mode="ok"),
    ):
        bridge.robot.base = base
        bridge.run(2.0)
    assert [(one["event_type"], one["reason"]) for one in events(bridge)] == [
        ("fault", codes.NO_PLANNER),
        ("fault", codes.LINK_LOST),
    ]


def test_a_recording_that_is_played_needs_no_planner(bridge: "Bridge") -> None:
    bridge.robot.be_replayed()
    bridge.robot.has_planner = False
    bridge.run(40.0)
    assert (events(bridge), bridge.state["activity"]) == ([], "ready")


def test_a_robot_that_is_only_driven_by_hand_needs_no_planner(
    make_bridge: "Callable[..., Bridge]",
) -> None:
    bridge = make_bridge(drives_itself=False)
    bridge.run(40.0)
    assert (events(bridge), bridge.state["activity"]) == ([], "waiting")
    assert bridge.state["message"] == ("The robot has no map yet, or its localizer is not running.")


def test_a_stop_and_a_low_battery_are_told(bridge: "Bridge") -> None:
    bridge.robot.base = BaseState(stamp_ns=0, mode="stopped", reason=codes.BUMPER)
    bridge.run(2.0)
    for share in (0.25, 0.19, 0.22, 0.19, 0.35, 0.1):
        bridge.robot.base = BaseState(stamp_ns=0, mode="ok", battery=Battery(fraction=share))
        bridge.run(1.5)
    assert kinds(bridge) == ["stopped", "battery_low", "battery_low"]
    assert events(bridge)[0]["reason"] == codes.BUMPER
    assert events(bridge)[1]["message"] == "The battery is at 19 %."


def test_what_was_before_the_bridge_came_or_came_back_is_not_told(bridge: "Bridge") -> None:
    bridge.robot.goal = GoalStatus(stamp_ns=0, id="a", state="arrived")
    bridge.broker.lose()
    bridge.run(3.0)
    bridge.broker.connect()
    bridge.run(3.0)
    assert events(bridge) == []


def test_home_assistant_learns_which_events_there_are(bridge: "Bridge") -> None:
    (entity,) = (one for one in bridge.announced.values() if one["name"] == "Event")
    assert entity["state_topic"] == "~/event"
    assert {"arrived", "failed", "waiting", "battery_low"} <= set(entity["event_types"])


def recovering(bridge: "Bridge", goal: str, reason: str, *, again: bool = False) -> None:
    for state in ("driving", "recovering"):
        bridge.robot.goal = GoalStatus(stamp_ns=0, id=goal, state=state, reason=reason)
        bridge.run(8.0 if state == "recovering" else 2.0)


def test_a_robot_that_gets_no_further_is_told_of_once_for_each_goal(bridge: "Bridge") -> None:
    recovering(bridge, "a", codes.BLOCKED)
    recovering(bridge, "a", codes.BLOCKED)
    recovering(bridge, "b", codes.SLIP)
    assert kinds(bridge) == ["stuck", "stuck"]
    assert [one["reason"] for one in events(bridge)] == [codes.BLOCKED, codes.SLIP]
    assert events(bridge)[0]["message"] == "Something is in the way and does not move."


def test_neither_a_moment_nor_waiting_for_another_robot_is_being_stuck(bridge: "Bridge") -> None:
    recovering(bridge, "a", codes.WAITING)
    for state in ("recovering", "driving") * 4:
        bridge.robot.goal = GoalStatus(stamp_ns=0, id="b", state=state, reason=codes.BLOCKED)
        bridge.run(3.0)
    assert events(bridge) == []


def pictures(bridge: "Bridge") -> list[bytes]:
    topic = f"{BASE}/map"
    return [payload for name, payload in bridge.broker.published if name == topic]


def room() -> OccupancyGrid:
    cells = np.zeros((80, 100), dtype=np.int8)
    cells[[0, -1]] = cells[:, [0, -1]] = 100
    return map_message(1, GridMap("home", 0.05, Pose2D(0.0, 0.0, 0.0), cells))


@pytest.mark.parametrize("x", [1e7, 1e18, 1e300, sys.float_info.max])
def test_a_place_on_the_moon_is_not_drawn_and_ends_nobody(bridge: "Bridge", x: float) -> None:
    far = SavedPose(name="moon", map="home", pose=Pose2D(x, -x, 0.0))
    bridge.robot.publish(topics.POSES, SavedPoses(stamp_ns=1, poses=[far]))
    bridge.robot.publish(topics.MAP, room())
    bridge.run(2.0)
    assert len(pictures(bridge)) == 1


def test_the_map_is_a_picture_that_follows_the_robot(bridge: "Bridge") -> None:
    assert pictures(bridge) == []
    bridge.robot.publish(topics.MAP, room())
    bridge.run(2.0)
    (first,) = pictures(bridge)
    image = Image.open(io.BytesIO(first))
    assert (image.format, max(image.size)) == ("PNG", 640)
    assert len(first) < 60_000
    bridge.run(60.0)
    assert len(pictures(bridge)) == 1, "nothing has moved"
    bridge.robot.position = Pose2D(2.0, 2.0, 0.0)
    bridge.run(11.0)
    assert len(pictures(bridge)) == 2
    for step in range(100):
        bridge.robot.position = Pose2D(2.0 + 0.02 * step, 2.0, 0.0)
        bridge.run(0.5)
    assert 3 <= len(pictures(bridge)) - 2 <= 6, "at most one in ten seconds"
    (entity,) = (one for one in bridge.announced.values() if one["name"] == "Map")
    assert (entity["image_topic"], entity["content_type"]) == ("~/map", "image/png")
