"""What is carried out, and what is not."""

import json
from collections.abc import Callable
from typing import TYPE_CHECKING

import pytest

from trolley import codes, topics
from trolley.codes import Refused
from trolley.messages import BaseState, Battery, GoalStatus, TourStatus

if TYPE_CHECKING:
    from .conftest import Bridge


def test_a_place_and_a_tour_are_driven_by_name(bridge: "Bridge") -> None:
    bridge.do("go", "kitchen")
    bridge.do("tour", "evening")
    assert bridge.robot.asked == [("goal/send", "kitchen"), ("tour/start", "evening")]
    assert bridge.state["answer"] == "Tour evening: on its way."


def test_a_name_in_another_normal_form_is_the_same_place(bridge: "Bridge") -> None:
    bridge.robot.save(["K\u00fcche"])
    bridge.run(1.5)
    bridge.do("go", "Ku\u0308che")
    assert bridge.robot.asked == [("goal/send", "K\u00fcche")]


@pytest.mark.parametrize(
    ("verb", "payload", "why"),
    [
        ("go", "cellar", "There is no place 'cellar' on this map."),
        ("go", "", "There is no place '' on this map."),
        ("go", b"\xff\xfe", "That is not a name."),
        ("go", "k" * 600, "That name is too long."),
        ("tour", "kitchen", "There is no tour 'kitchen'."),
        ("pause", "", "The robot is not going anywhere."),
    ],
)
def test_what_cannot_be_done_moves_nothing_and_says_why(
    bridge: "Bridge", verb: str, payload: bytes | str, why: str
) -> None:
    bridge.do(verb, payload)
    assert bridge.robot.asked == []
    assert bridge.state["answer"] == f"Not done: {why}"
    assert bridge.counters["command/refused"] == 1


def test_a_refusal_of_the_robot_is_told(bridge: "Bridge") -> None:
    bridge.robot.refuse = Refused(codes.STOPPED)
    bridge.do("go", "kitchen")
    assert (
        bridge.state["answer"] == "Go to kitchen: not done: The robot is stopped; resume it first."
    )


def test_pause_is_for_the_trip_that_drives_or_else_for_the_goal(bridge: "Bridge") -> None:
    bridge.robot.goal = GoalStatus(stamp_ns=0, id="abc", state="driving")
    bridge.run(0.5)
    bridge.do("pause")
    bridge.robot.trip = TourStatus(stamp_ns=0, name="evening", trip="t1", state="driving")
    bridge.robot.goal = GoalStatus(stamp_ns=0, id="tour-t1-0-1", state="driving")
    bridge.run(0.5)
    bridge.do("pause")
    assert bridge.robot.asked == [("goal/pause", "abc"), ("tour/pause", None)]


def test_a_retained_command_is_never_carried_out(bridge: "Bridge") -> None:
    bridge.do("go", "kitchen", is_retained=True)
    bridge.do("tour", "evening", is_retained=True)
    assert bridge.robot.asked == []
    assert bridge.counters["command/retained"] == 2
    assert bridge.state["answer"] == "Not done: A command must not be a retained message."
    bridge.do("stop", is_retained=True)  # but a stop is never refused
    assert bridge.robot.asked == [("base/stop", None)]


def test_what_arrives_with_the_connection_keeps_its_order(bridge: "Bridge") -> None:
    bridge.broker.lose()
    bridge.run(3.0)
    bridge.broker.connect()
    bridge.run(1.5)
    for name in ("kitchen", "hall", "kitchen"):
        bridge.broker.send("trolley/robby/do/go", name)
    bridge.run(0.5)
    assert [name for _, name in bridge.robot.asked] == ["kitchen", "hall", "kitchen"]


def test_a_command_that_waited_in_a_stalled_connection_is_dropped(bridge: "Bridge") -> None:
    bridge.broker.is_stalled = True
    bridge.do("go", "kitchen")
    bridge.run(40.0)
    bridge.broker.flow_again()
    bridge.run(0.5)
    assert bridge.robot.asked == []
    assert bridge.counters["command/stale"] == 1
    bridge.run(1.5)
    bridge.do("go", "kitchen")  # now marks come back again
    assert bridge.robot.asked == [("goal/send", "kitchen")]


@pytest.mark.parametrize("seconds", [0.2, 5.0])
def test_a_command_at_the_moment_of_reconnection_is_dropped(
    bridge: "Bridge", seconds: float
) -> None:
    bridge.broker.lose()
    bridge.run(seconds)
    bridge.broker.is_stalled = True  # the broker sends what it has before our first mark
    bridge.broker.connect()
    bridge.broker.send_before_marks("trolley/robby/do/go", b"kitchen")
    bridge.run(0.5)
    assert bridge.robot.asked == []
    assert bridge.counters["command/stale"] == 1


def test_marks_of_others_prove_nothing(bridge: "Bridge") -> None:
    bridge.broker.is_stalled = True
    bridge.run(10.0)
    bridge.broker.is_stalled = False
    bridge.broker.waiting.clear()
    bridge.broker.send("trolley/robby/echo", "made-up-1")
    bridge.broker.send("trolley/robby/do/go", "kitchen")
    bridge.lockstep.run(0.1)
    assert bridge.robot.asked == []


def test_a_stop_is_carried_out_however_late(bridge: "Bridge") -> None:
    bridge.broker.is_stalled = True
    bridge.do("stop")
    bridge.run(40.0)
    assert bridge.robot.asked == []
    bridge.broker.flow_again()
    bridge.run(0.5)
    assert bridge.robot.asked == [("base/stop", None)]
    assert bridge.state["activity"] == "stopped"


def test_a_stop_that_nobody_answers_is_repeated_and_shown(bridge: "Bridge") -> None:
    bridge.robot.is_deaf = True
    bridge.do("stop")
    bridge.run(2.0)
    assert bridge.state["message"] == "NOT STOPPED: no connection to the robot."
    assert bridge.state["problem"] is True
    bridge.broker.published.clear()
    bridge.do("go", "cellar")  # the answer to another command does not hide it
    said = [data for name, data in bridge.broker.published if name == "trolley/robby/state"]
    assert said
    assert all(b"NOT STOPPED: no connection" in data for data in said)
    bridge.robot.is_deaf = False
    bridge.run(1.0)
    assert bridge.robot.asked == [("base/stop", None)]
    assert bridge.state["answer"] == "Stop: done."
    assert bridge.state["message"] != "NOT STOPPED: no connection to the robot."


def test_the_robot_cannot_be_released_from_afar(bridge: "Bridge") -> None:
    bridge.do("stop")
    bridge.do("resume")
    bridge.do("base_resume")
    assert bridge.robot.asked == [("base/stop", None)]
    assert bridge.counters["command/unknown"] == 1


def test_a_flood_is_counted_and_soon_over(bridge: "Bridge") -> None:
    for _ in range(100):
        bridge.broker.send("trolley/robby/do/go", "kitchen")
    bridge.broker.dropped = 9000
    bridge.run(0.4)
    assert len(bridge.robot.asked) == 8
    bridge.run(1.1)
    assert bridge.counters["command/flood"] == 92 + 9000
    bridge.do("go", "hall")
    assert bridge.robot.asked[-1] == ("goal/send", "hall")


@pytest.mark.parametrize(("verb", "name"), [("dance", "x"), ("go", "cellar"), ("vacuum", "beep")])
def test_junk_does_not_stand_in_the_way_of_a_command(
    bridge: "Bridge", verb: str, name: str
) -> None:
    bridge.run(1.0)
    bridge.broker.published.clear()
    for index in range(100):
        bridge.broker.send(f"trolley/robby/do/{verb}", f"{name} {index}")
    bridge.broker.send("trolley/robby/do/go", "kitchen")
    bridge.run(0.3)
    assert bridge.robot.asked == [("goal/send", "kitchen")]
    told = [name for name, _ in bridge.broker.published if name == "trolley/robby/state"]
    assert len(told) < 15  # a flood is not answered


def test_the_state_says_what_the_robot_does(bridge: "Bridge") -> None:
    assert bridge.state["activity"] == "ready"
    assert (bridge.state["battery"], bridge.state["problem"]) == (None, False)
    bridge.robot.base = BaseState(
        stamp_ns=0, mode="ok", battery=Battery(fraction=0.42, charging=True)
    )
    bridge.robot.position = bridge.robot.position.__class__(0.3, 2.0, 0.0)
    bridge.run(1.5)
    assert (bridge.state["battery"], bridge.state["charging"]) == (42, True)
    assert bridge.state["place"] == "kitchen"
    bridge.do("go", "hall")
    bridge.run(1.5)
    assert bridge.state["activity"] == "driving"


def test_a_planner_that_does_not_run_is_told_of_and_one_that_is_restarted_is_not(
    bridge: "Bridge",
) -> None:
    bridge.robot.has_planner = False
    bridge.run(20.0)
    assert bridge.state["activity"] == "ready"
    bridge.run(20.0)
    message = "The robot cannot drive by itself: the planner is not running."
    assert bridge.state["activity"] == "fault"
    assert (bridge.state["message"], bridge.state["problem"]) == (message, True)
    events = [data for name, data in bridge.broker.published if name == "trolley/robby/event"]
    assert [json.loads(one)["event_type"] for one in events] == ["fault"]
    bridge.robot.has_planner = True
    bridge.run(2.0)
    assert bridge.state["activity"] == "ready"


def test_a_robot_that_is_away_is_unavailable(bridge: "Bridge") -> None:
    assert bridge.broker.kept["trolley/robby/robot"] == b"online"
    bridge.lockstep.kill("base")
    bridge.run(2.5)
    assert bridge.broker.kept["trolley/robby/robot"] == b"offline"
    assert bridge.broker.kept["trolley/robby/bridge"] == b"online"
    assert bridge.state["activity"] == "away"


def test_a_broker_that_loses_power_with_the_robot_forgets_that_it_was_there(
    bridge: "Bridge",
) -> None:
    valid_s = bridge.broker.valid_s["trolley/robby/bridge"]
    assert 0 < valid_s <= 60
    bridge.broker.published.clear()
    bridge.run(0.5 * valid_s)  # while it is there it says so in time, again and again
    assert bridge.broker.published.count(("trolley/robby/bridge", b"online")) >= 1
    bridge.broker.lose()
    bridge.broker.published.clear()
    bridge.run(2.0 * valid_s)
    assert ("trolley/robby/bridge", b"online") not in bridge.broker.published


def test_a_lost_broker_is_reported_and_found_again(make_bridge: "Callable[..., Bridge]") -> None:
    bridge = make_bridge(is_up=False)
    health = bridge.lockstep.record(topics.HEALTH, "mqtt")
    bridge.run(1.5)
    assert health[-1].state == "degraded"
    assert bridge.broker.published == []
    bridge.broker.connect()
    bridge.run(1.5)
    assert health[-1].state == "ok"
    assert bridge.broker.kept["trolley/robby/bridge"] == b"online"
    bridge.broker.lose()
    bridge.run(1.5)
    assert health[-1].message == "The connection was lost."
    bridge.broker.kept.clear()  # a broker that keeps nothing over its restart
    bridge.broker.connect()
    bridge.run(1.5)
    assert bridge.announced
    assert bridge.state["activity"] == "ready"


def test_a_broker_that_passes_no_commands_on_is_reported(bridge: "Bridge") -> None:
    health = bridge.lockstep.record(topics.HEALTH, "mqtt")
    bridge.broker.is_stalled = True
    bridge.run(7.0)
    assert health[-1].state == "degraded"
    assert "may this account read and write trolley/robby/#?" in health[-1].message
    bridge.broker.flow_again()
    bridge.run(1.5)
    assert health[-1].state == "ok"
