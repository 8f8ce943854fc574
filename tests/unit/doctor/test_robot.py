"""What doctor says of a robot that runs."""

from dataclasses import replace
from typing import Any

import msgspec
import pytest

from trolley import topics
from trolley.doctor import Finding, Level
from trolley.doctor.robot import NEEDED, RobotFacts, check_robot
from trolley.geometry import Pose2D
from trolley.messages import (
    BaseState,
    Battery,
    Clock,
    GoalStatus,
    Health,
    Link,
    PoseEstimate,
    Proposal,
    Robot,
    TourStatus,
)
from trolley.traffic import Flow

RATES = {
    "clock": 10.0,
    "scan": 10.0,
    "odom": 30.0,
    "cmd_vel": 10.0,
    "base": 1.0,
    "pose": 10.0,
    "tf/odom": 10.0,
    "tour": 1.0,
    **{f"health/{name}": 1.0 for name in NEEDED},
}


def flowing(hz: float) -> Flow:
    return Flow(hz, 100.0 * hz, 0.1)


def searching(message: str) -> PoseEstimate:
    return msgspec.structs.replace(pose("searching"), message=message)


def pose(state: Any = "localized") -> PoseEstimate:
    return PoseEstimate(
        stamp_ns=1,
        map="home",
        pose=Pose2D(0.0, 0.0, 0.0),
        covariance=[0.0] * 9,
        state=state,
        match=0.9,
        spread=0.0,
    )


ROBOT = Robot(
    stamp_ns=1,
    name="one",
    title="",
    footprint=[(0.1, 0.1), (-0.1, 0.1), (0.0, -0.1)],
    drive="differential",
    max_speed=0.5,
    max_wz=1.0,
    deceleration=1.0,
)
GOOD = RobotFacts(
    "one",
    3.0,
    runs={name: [f"pi-{i}-1"] for i, name in enumerate(NEEDED)},
    flows={name: flowing(hz) for name, hz in RATES.items()},
    kept=frozenset({"robot", "map", "zones", "poses", "tours"}),
    late_s={"scan": 0.1, "odom": 0.01, "pose": 0.12},
    health={name: Health(stamp_ns=1, state="ok", cpu=0.1, rss=10**8) for name in NEEDED},
    robot=ROBOT,
    clock=Clock(stamp_ns=1, rate=1.0, epoch=0),
    base=BaseState(stamp_ns=1, mode="ok"),
    pose=pose(),
)


def test_of_a_recording_that_is_played_no_service_is_missed() -> None:
    played = msgspec.structs.replace(ROBOT, replayed=True)
    found = check_robot(RobotFacts("one", 3.0, runs={"replay": ["pi-1-1"]}, robot=played))
    assert [(one.level, one.remedy) for one in found] == [(Level.NOTE, "")]


def without(facts: RobotFacts, *names: str) -> RobotFacts:
    return replace(facts, flows={k: v for k, v in facts.flows.items() if k not in names})


def with_flow(name: str, hz: float, facts: RobotFacts = GOOD) -> RobotFacts:
    return replace(facts, flows={**facts.flows, name: flowing(hz)})


def with_health(name: str, **fields: Any) -> RobotFacts:
    return replace(GOOD, health={**GOOD.health, name: Health(stamp_ns=1, **fields)})


def with_base(**fields: Any) -> RobotFacts:
    return replace(GOOD, base=BaseState(stamp_ns=1, **fields))


def bad(facts: RobotFacts) -> list[Finding]:
    """What is not fine; what needs something done says what."""
    found = [one for one in check_robot(facts) if one.level > Level.OK]
    assert all(one.remedy or one.level is Level.NOTE for one in found)
    return found


def test_a_bridge_that_the_settings_need_is_missed() -> None:
    """Who had named a broker, and had not enabled the service, was told that all is fine."""
    (missing,) = bad(replace(GOOD, needs_mqtt=True))
    assert missing.sentence == "mqtt is not running, or hangs."
    assert "enable --now trolley-mqtt" in missing.remedy


def test_a_good_robot_is_fine() -> None:
    assert bad(GOOD) == []
    assert len(check_robot(GOOD)) > 10


MISSING = {k: v for k, v in GOOD.runs.items() if k != "planner"}
CASES: dict[str, tuple[RobotFacts, Level, str]] = {
    "missing": (replace(GOOD, runs=MISSING), Level.PROBLEM, "planner is not running, or hangs"),
    "twins": (
        replace(GOOD, runs={**GOOD.runs, "tour": ["pi-1-1", "pc-2-2"]}),
        Level.PROBLEM,
        "tour runs 2 times (computer-process-start): pc-2-2, pi-1-1",
    ),
    "hangs": (without(GOOD, "health/tour"), Level.PROBLEM, "been silent for 3 s"),
    "failed": (
        with_health("tour", state="failed", message="no."),
        Level.PROBLEM,
        "cannot work: no",
    ),
    "degraded": (with_health("tour", state="degraded"), Level.WARNING, "only partly working"),
    "starting": (with_health("tour", state="starting"), Level.NOTE, "still starting"),
    "busy": (with_health("tour", state="ok", cpu=0.97), Level.WARNING, "whole core busy (97%)"),
    "protocol": (
        replace(
            GOOD,
            robot=msgspec.structs.replace(ROBOT, protocol=2),
        ),
        Level.PROBLEM,
        "version 2 of the protocol",
    ),
    "link": (
        with_base(mode="ok", links=[Link(name="lidar", state="searching", message="unplugged?")]),
        Level.PROBLEM,
        "The lidar is not connected (searching). unplugged?",
    ),
    "fault": (with_base(mode="fault", reason="link_lost"), Level.PROBLEM, "motor board is down"),
    "stopped": (with_base(mode="stopped", reason="button"), Level.WARNING, "button was pressed"),
    "held": (with_base(mode="held", reason="scan_lost"), Level.WARNING, "lidar is silent"),
    "battery": (
        with_base(mode="ok", battery=Battery(fraction=0.1)),
        Level.WARNING,
        "battery is at 10%",
    ),
    "no pose": (replace(GOOD, pose=None), Level.PROBLEM, "There is no pose."),
    "no map any more": (
        replace(GOOD, pose=msgspec.structs.replace(pose("searching"), map=None)),
        Level.PROBLEM,
        "There is no pose.",
    ),
    "lost": (replace(GOOD, pose=pose("lost")), Level.PROBLEM, "is lost"),
    "searching": (
        replace(GOOD, pose=pose("searching")),
        Level.WARNING,
        "is working out where it is",
    ),
    "several places": (
        replace(GOOD, pose=searching("several places look alike")),
        Level.WARNING,
        "is working out where it is. Several places look alike.",
    ),
    "unsure": (replace(GOOD, pose=pose("unsure")), Level.WARNING, "unsure where it is"),
    "tyre": (
        replace(
            GOOD,
            proposals=[
                Proposal(id="wheels", message="The left wheel is 3 % smaller.", settings={"a": 1.0})
            ],
        ),
        Level.WARNING,
        "left wheel is 3 % smaller",
    ),
    "loose": (
        replace(GOOD, proposals=[Proposal(id="odometry", message="They no longer fit.")]),
        Level.WARNING,
        "no longer fit",
    ),
    "no scan": (without(GOOD, "scan", "pose", "tf/odom"), Level.PROBLEM, "scan is not published"),
    "slow odom": (with_flow("odom", 8.0), Level.WARNING, "odom arrives at 8.0 Hz; 20 Hz"),
    "fast scan": (with_flow("scan", 120.0), Level.WARNING, "50 Hz is the maximum"),
    "slow pose": (with_flow("pose", 3.0), Level.WARNING, "pose arrives at 3.0 Hz; 10 Hz"),
    "flood": (with_flow("tf/mine", 500.0), Level.WARNING, "tf/mine arrives at 500.0 Hz"),
    "no map": (replace(GOOD, kept=GOOD.kept - {"map"}), Level.WARNING, "has no map."),
    "late": (replace(GOOD, late_s={"scan": 0.7}), Level.WARNING, "0.7 s old"),
    "too late": (replace(GOOD, late_s={"pose": 2.0}), Level.PROBLEM, "so the robot stops"),
    "dropped": (replace(GOOD, counted={"base": {"scan/x": 90}}), Level.WARNING, "scan/x 90 times"),
    "dropped once": (
        replace(GOOD, counted={"base": {"scan/x": 1}}),
        Level.NOTE,
        "scan/x once in 3 s",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_what_is_wrong_is_said(case: str) -> None:
    facts, level, words = CASES[case]
    found = bad(facts)
    assert [one for one in found if one.level is level and words in one.sentence], found
    assert max(one.level for one in found) is level


def test_who_is_unsure_where_it_is_need_not_be_searched_for_but_driven() -> None:
    (found,) = bad(replace(GOOD, pose=pose("unsure")))
    assert found.remedy.startswith("Drive it a little")
    (found,) = bad(replace(GOOD, pose=pose("searching")))
    assert "`trolley pose find`" in found.remedy


def test_a_fast_simulation_is_measured_by_its_own_clock() -> None:
    twice = {name: flowing(2.0 * flow.hz) for name, flow in GOOD.flows.items()}
    real_s = {"clock": flowing(10.0), "tour": flowing(1.0)}
    healths = {name: flow for name, flow in GOOD.flows.items() if name.startswith("health/")}
    fast = replace(
        GOOD,
        flows={**twice, **real_s, **healths},
        clock=Clock(stamp_ns=1, rate=2.0, epoch=0),
        late_s={"scan": 0.6},
    )
    assert bad(fast) == []
    # Without it cmd_vel comes too often and the scan late.
    assert [one.about for one in bad(replace(fast, clock=GOOD.clock))] == ["rates"] * 2


def test_a_robot_without_a_map_needs_no_localizer() -> None:
    facts = replace(
        without(GOOD, "pose", "tf/odom", "health/localizer"),
        runs={k: v for k, v in GOOD.runs.items() if k != "localizer"},
        health={k: v for k, v in GOOD.health.items() if k != "localizer"},
        kept=GOOD.kept - {"map", "zones"},
        pose=None,
        needs_map=False,
    )
    assert bad(facts) == []


def test_the_goal_is_due_only_while_the_robot_drives() -> None:
    drives = replace(GOOD, goal=GoalStatus(stamp_ns=1, id="a", state="driving"))
    assert ["goal is not published" in one.sentence for one in bad(drives)] == [True]
    assert bad(with_flow("goal", 5.0, drives)) == []
    assert bad(replace(GOOD, goal=GoalStatus(stamp_ns=1, id="a", state="arrived"))) == []


def test_the_trip_is_due_only_while_it_goes_on() -> None:
    trip = TourStatus(stamp_ns=1, name="round", trip="a", state="dwelling")
    goes = replace(without(GOOD, "tour"), trip=trip)
    assert ["tour is not published" in one.sentence for one in bad(goes)] == [True]
    assert bad(with_flow("tour", 1.0, goes)) == []
    assert bad(replace(goes, trip=msgspec.structs.replace(trip, state="paused"))) == []


def test_what_others_publish_may_be_named_freely() -> None:
    names = {f"markers/{i}/x": flowing(50.0) for i in range(5)}
    assert bad(replace(GOOD, flows={**GOOD.flows, **names, "zap/zap": flowing(9.0)})) == []


def test_every_row_of_the_table_can_be_judged() -> None:
    for topic in topics.TOPICS:
        name = topic.key("one", *["x"] * topic.num_parts).split("/", 2)[2]
        check_robot(with_flow(name, 1000.0))
        check_robot(with_flow(name, 0.01))
