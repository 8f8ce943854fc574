"""What is said and published of the robot."""

from typing import Any

import pytest
from msgspec import structs

from trolley import codes
from trolley.geometry import Pose2D
from trolley.messages import (
    BaseState,
    GoalStatus,
    PoseEstimate,
    SavedPose,
    Stop,
    Tour,
    TourStatus,
    Zone,
    Zones,
)
from trolley_mqtt.robot_view import RobotView
from trolley_mqtt.sentences import ACTIVITIES
from trolley_mqtt.state import MAX_TEXT, state_of, vacuum_of

DISOBEYS = BaseState(
    stamp_ns=0,
    mode="fault",
    reason=codes.DOES_NOT_OBEY,
    message="NOT STOPPED: the motor board does not obey: it drives by itself at 0.30 m/s.",
    not_stopped=True,
)
KITCHEN = SavedPose(name="kitchen", map="home", pose=Pose2D(1.0, 1.0, 0.0))


LOCALIZED = PoseEstimate(
    stamp_ns=0,
    map="home",
    pose=Pose2D(1.2, 1.0, 0.0),
    covariance=[0.0] * 9,
    state="localized",
    match=1.0,
    spread=0.0,
)


BY_ODOMETRY = GoalStatus(
    stamp_ns=0, id="a", state="driving", frame="odom", pose=Pose2D(1.0, 0.0, 0.0)
)
"""What a robot without a map can drive, too."""


def known(**changes: Any) -> RobotView:
    base = BaseState(stamp_ns=0, mode="ok")
    facts: dict[str, Any] = {"base": base, "estimate": LOCALIZED, "age_s": 0.1, "places": [KITCHEN]}
    return RobotView(**(facts | changes))


TRIP = TourStatus(
    stamp_ns=0,
    name="evening",
    trip="t1",
    state="driving",
    message="Driving to stop 1 (kitchen).",
    stop=0,
    tour=Tour(stops=[Stop(name="kitchen")]),
)


@pytest.mark.parametrize(
    ("changes", "activity", "words"),
    [
        ({}, "ready", "ready"),
        ({"is_away": True}, "away", "out of reach"),
        ({"base": BaseState(stamp_ns=0, mode="fault", reason=codes.LINK_LOST)}, "fault", "board"),
        ({"base": DISOBEYS}, "fault", "NOT STOPPED"),
        ({"base": BaseState(stamp_ns=0, mode="stopped", reason=codes.BUTTON)}, "stopped", "button"),
        ({"base": BaseState(stamp_ns=0, mode="ok", source="teleop")}, "by_hand", "by hand"),
        ({"age_s": 5.0}, "lost", "where it is"),
        ({"age_s": None}, "lost", "where it is"),
        ({"estimate": None, "age_s": None}, "waiting", "no map yet, or its localizer"),
        ({"estimate": None, "age_s": None, "goal": BY_ODOMETRY}, "driving", "Driving to"),
        ({"trip": TRIP}, "driving", "stop 1 (kitchen)"),
        (
            {"goal": GoalStatus(stamp_ns=0, id="a", state="driving", pose=KITCHEN.pose)},
            "driving",
            "Driving to kitchen.",
        ),
        ({"goal": GoalStatus(stamp_ns=0, id="a", state="failed")}, "failed", "No reason"),
        ({"goal": GoalStatus(stamp_ns=0, id="a", state="paused")}, "paused", "pointed out"),
    ],
)
def test_the_most_pressing_thing_is_told(changes: dict, activity: str, words: str) -> None:
    state = state_of(known(**changes))
    assert (state.activity, state.activity in ACTIVITIES) == (activity, True)
    assert words in state.message


def test_place_and_destination_have_names() -> None:
    state = state_of(known(trip=TRIP))
    assert (state.place, state.destination, state.tour) == ("kitchen", "kitchen", "evening")
    corners = [(-2.0, -2.0), (4.0, -2.0), (4.0, 4.0), (-2.0, 4.0)]
    rooms = Zones(stamp_ns=0, map="home", zones=[Zone(name="hall", kind="room", points=corners)])
    assert state_of(known(zones=rooms)).room == "hall"
    assert state_of(known(zones=rooms, age_s=5.0)).room is None
    far = known(places=[SavedPose(name="far", map="home", pose=Pose2D(9.0, 9.0, 0.0))])
    assert state_of(far).place is None


def test_a_robot_that_only_works_out_where_it_is_does_not_clean() -> None:
    searching = structs.replace(LOCALIZED, state="searching")
    goal = GoalStatus(stamp_ns=0, id="a", state="planning")
    for facts, word in (({}, "idle"), ({"goal": goal}, "cleaning")):
        view = known(estimate=searching, **facts)
        assert state_of(view).activity == "waiting"
        assert vacuum_of(view, state_of(view)) == {"state": word}


def test_a_trip_that_failed_gives_way_to_what_was_driven_since() -> None:
    failed = TourStatus(stamp_ns=0, name="x", trip="t1", state="failed", message="Given up.")
    goal = GoalStatus(stamp_ns=0, id="later", state="driving")
    assert state_of(known(trip=failed)).activity == "failed"
    assert state_of(known(trip=failed, goal=goal)).activity == "driving"


def test_texts_are_as_short_as_home_assistant_wants_them() -> None:
    long = BaseState(stamp_ns=0, mode="fault", message="x" * 1000)
    state = state_of(known(base=long), "y" * 1000)
    assert (len(state.message), len(state.answer or "")) == (MAX_TEXT, MAX_TEXT)
