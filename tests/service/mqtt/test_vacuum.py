"""The robot as a vacuum cleaner: what Home Assistant's own card for one can do."""

import json
from typing import TYPE_CHECKING

import pytest

from trolley import codes
from trolley.geometry import Pose2D
from trolley.messages import BaseState, Battery, GoalStatus, Stop, Tour, TourStatus

from .conftest import BASE

if TYPE_CHECKING:
    from collections.abc import Callable

    from .conftest import Bridge


def word(bridge: "Bridge") -> str:
    return json.loads(bridge.broker.kept[f"{BASE}/vacuum"])["state"]


def press(bridge: "Bridge", what: str) -> None:
    """Send what Home Assistant sends, as it was announced."""
    entity = bridge.announced["vacuum/vacuum"]
    bridge.broker.send(entity["command_topic"].replace("~", entity["~"]), entity[f"payload_{what}"])
    bridge.run(0.3)


def test_start_begins_the_only_tour(bridge: "Bridge") -> None:
    press(bridge, "start")
    assert bridge.robot.asked == [("tour/start", "evening")]


def test_of_several_tours_it_begins_the_one_that_is_set(
    bridge: "Bridge", make_bridge: "Callable[..., Bridge]"
) -> None:
    for one in (bridge, make_bridge(start_tour="morning")):
        one.robot.save(["kitchen"], ["evening", "morning"])
        one.run(1.5)
        press(one, "start")
        if one is bridge:
            assert one.robot.asked == []
            assert "[mqtt] start_tour" in one.state["answer"]
        else:
            assert one.robot.asked == [("tour/start", "morning")]


def test_the_tour_that_is_set_may_be_written_as_macos_writes_accents(
    make_bridge: "Callable[..., Bridge]",
) -> None:
    bridge = make_bridge(start_tour="soire\u0301e")
    bridge.robot.save(["kitchen"], ["evening", "soir\u00e9e"])
    bridge.run(1.5)
    press(bridge, "start")
    assert bridge.robot.asked == [("tour/start", "soir\u00e9e")]


def test_start_goes_on_after_a_pause(bridge: "Bridge") -> None:
    bridge.robot.trip = TourStatus(stamp_ns=0, name="evening", trip="t1", state="paused")
    bridge.run(1.5)
    assert word(bridge) == "paused"
    press(bridge, "start")
    assert bridge.robot.asked == [("tour/resume", None)]


@pytest.mark.parametrize(
    ("goal", "trip"),
    [
        (GoalStatus(stamp_ns=0, id="a", state="driving"), None),
        (
            GoalStatus(stamp_ns=0, id="tour-t1-1-1", state="driving"),
            TourStatus(stamp_ns=0, name="evening", trip="t1", state="driving"),
        ),
    ],
)
def test_start_pressed_again_begins_nothing_anew(
    bridge: "Bridge", goal: GoalStatus, trip: TourStatus | None
) -> None:
    bridge.robot.goal, bridge.robot.trip = goal, trip or bridge.robot.trip
    bridge.run(1.5)
    press(bridge, "start")
    assert bridge.robot.asked == []
    assert bridge.state["answer"] == "Not done: A tour or drive is under way already."


def test_it_returns_to_the_place_home(bridge: "Bridge") -> None:
    press(bridge, "return_to_base")
    assert bridge.state["answer"] == "Not done: There is no place 'home' on this map."
    bridge.robot.save(["kitchen", "home"])
    bridge.run(1.5)
    press(bridge, "return_to_base")
    assert bridge.robot.asked == [("goal/send", "home")]


def test_it_says_where_it_is(bridge: "Bridge") -> None:
    bridge.robot.save(["kitchen", "hall"])
    press(bridge, "locate")
    happened = [
        json.loads(data) for name, data in bridge.broker.published if name == f"{BASE}/event"
    ]
    assert [one["event_type"] for one in happened] == ["located"]
    assert (
        happened[0]["message"]
        == bridge.state["answer"]
        == "The robot is at x 1.0 m, y 2.0 m on the map."
    )
    assert bridge.robot.asked == []


@pytest.mark.parametrize("payload", ["stop", "go", "locate\n", "", b"\xff" * 300])
def test_what_a_vacuum_cleaner_cannot_do_is_dropped(bridge: "Bridge", payload: str | bytes) -> None:
    bridge.do("vacuum", payload)
    assert bridge.robot.asked == []
    assert bridge.counters["command/unknown"] == 1


def test_an_old_press_moves_nothing(bridge: "Bridge") -> None:
    bridge.do("vacuum", "start", is_retained=True)
    assert bridge.robot.asked == []


def test_its_state_is_in_the_words_for_vacuum_cleaners(bridge: "Bridge") -> None:
    seen = [word(bridge)]
    robot = bridge.robot
    home = Tour(stops=[Stop(name="home")])
    steps = (
        {"goal": GoalStatus(stamp_ns=0, id="a", state="driving")},
        {
            "goal": GoalStatus(stamp_ns=0, id="tour-t-0-1", state="driving"),
            "trip": TourStatus(stamp_ns=0, name="", trip="t", state="driving", stop=0, tour=home),
        },
        {"base": BaseState(stamp_ns=0, mode="fault", reason=codes.LINK_LOST)},
        {
            "base": BaseState(stamp_ns=0, mode="ok", battery=Battery(charging=True)),
            "goal": GoalStatus(stamp_ns=0, id=None, state="idle"),
            "trip": TourStatus(stamp_ns=0, name=None, trip=None, state="idle"),
        },
    )
    for step in steps:
        for name, value in step.items():
            setattr(robot, name, value)
        bridge.run(1.5)
        seen.append(word(bridge))
    assert seen == ["idle", "cleaning", "returning", "error", "docked"]


def test_a_robot_at_home_is_docked_also_where_nobody_measures_its_battery(
    bridge: "Bridge",
) -> None:
    bridge.robot.position = Pose2D(5.2, 2.0, 0.0)
    bridge.robot.save(["kitchen", "home"])
    bridge.run(1.5)
    assert word(bridge) == "docked"
