"""The one sentence about what the robot is doing."""

import msgspec
import pytest

from trolley.geometry import Pose2D
from trolley.messages import (
    BaseState,
    GoalStatus,
    Link,
    MappingStatus,
    PoseEstimate,
    SavedPose,
    Stop,
    StopResult,
    Tour,
    TourStatus,
)
from trolley_viz.features.past.record import LATELY, Record
from trolley_viz.pages.known import state_lines
from trolley_viz.robots.situation import RobotState, situation
from trolley_viz.words.sentences import GOES_ON

KITCHEN = SavedPose(name="kitchen", map="room", pose=Pose2D(2.0, 1.0, 0.0))
TOUR = Tour(name="round", stops=[Stop(name="hall"), Stop(name="kitchen"), Stop(name="door")])
DISCARDED = PoseEstimate(
    stamp_ns=1,
    map=None,
    pose=None,
    covariance=None,
    state="searching",
    match=0.0,
    spread=0.0,
    message="there is no map",
)
IDLE = GoalStatus(stamp_ns=1, id=None, state="idle")


def base(mode: str, reason: str = "", message: str = "", source: str | None = None) -> BaseState:
    return BaseState(stamp_ns=1, mode=mode, reason=reason, message=message, source=source)  # type: ignore[arg-type]


def silent(state: str, message: str) -> BaseState:
    """A stop that holds while the motor board is in a state of its connection."""
    board = Link(name="chassis", state=state)  # type: ignore[arg-type]
    lidar = Link(name="lidar", state="down", message="The lidar is unplugged.")
    return msgspec.structs.replace(base("stopped", "button", message), links=[lidar, board])


def goal(state: str, goal_id: str = "a", **fields: object) -> GoalStatus:
    values: dict[str, object] = {"pose": KITCHEN.pose, **fields}
    return GoalStatus(stamp_ns=1, id=goal_id, state=state, **values)  # type: ignore[arg-type]


def trip(state: str, **fields: object) -> TourStatus:
    values: dict[str, object] = {"name": "round", "trip": "t1", "stop": 1, **fields}
    return TourStatus(stamp_ns=1, state=state, **values)  # type: ignore[arg-type]


def results(*states: str) -> list[StopResult]:
    return [StopResult(stop=i, state=state) for i, state in enumerate(states)]  # type: ignore[arg-type]


def mapping(state: str, message: str = "") -> MappingStatus:
    return MappingStatus(stamp_ns=1, state=state, name="home", message=message)  # type: ignore[arg-type]


def known(**fields: object) -> RobotState:
    at = fields.pop("at", "localized")
    turn = bool(fields.pop("wants_turn", False))
    off_map = fields.pop("off_map", None)
    estimate = PoseEstimate(
        stamp_ns=1,
        map="room",
        pose=Pose2D(2.1, 1.0, 0.0),
        covariance=None,
        state=at,  # type: ignore[arg-type]
        match=0.9,
        spread=0.1,
        wants_turn=turn,
        off_map=off_map,  # type: ignore[arg-type]
    )
    values: dict[str, object] = {
        "base": base("ok"),
        "estimate": estimate,
        "estimate_age_s": 0.1,
        "goal": IDLE,
        "tour": TOUR,
        "places": [KITCHEN],
    }
    return RobotState(**(values | fields))  # type: ignore[arg-type]


DRIVING = goal("driving", distance_remaining=3.21, eta=12.4)
TOUR_GOAL = goal("driving", "tour-t1-1-0", distance_remaining=3.21, eta=12.4)
CASES = [
    (known(), "Ready."),
    (known(room="kitchen"), "Ready. It is in “kitchen”."),
    (known(at="unsure"), "It is not quite sure where it is, so it drives slowly."),
    (known(at="unsure", off_map=3.0), "It has left its map. Send it to a place on the map."),
    (
        known(at="unsure", off_map=3.0, goal=goal("paused", reason="off_map")),
        "The map ends here, so it waits. Send it to a place on the map, or bring it back.",
    ),
    (known(is_away=True), "No contact with the robot. It may be switched off or out of range."),
    (known(base=base("stopped", "button")), "Stopped. Press “Drive on” to let it drive again."),
    (
        known(base=base("stopped", "bumper")),
        "Stopped: it bumped into something. Press “Drive on” to let it drive again.",
    ),
    (
        known(base=base("stopped", "new_code", "A wheel came off.")),
        "Stopped: a wheel came off. Press “Drive on” to let it drive again.",
    ),
    (
        known(
            base=silent("down", "A stop holds, but it is not known whether the robot stands still.")
        ),
        "A stop holds, but it is not known whether the robot stands still.",
    ),
    (
        known(base=silent("searching", "")),
        "The robot was told to stop, but the motor board is silent: it may still be moving.",
    ),
    (known(base=silent("up", "")), "Stopped. Press “Drive on” to let it drive again."),
    (
        known(base=base("fault", "link_lost")),
        "The robot cannot drive: the connection to the motor board is down.",
    ),
    (known(base=base("ok", source="teleop")), "Somebody is driving it by hand."),
    (
        known(base=base("ok", "blind", "The lidar sees nothing behind.", source="teleop")),
        "Driven by hand: the lidar sees nothing behind.",
    ),
    (
        known(base=base("held", "stop_field"), goal=DRIVING),
        "Waiting: something is too close in the direction of travel. It will continue by itself.",
    ),
    (
        known(base=base("held", "stop_field")),
        "Waiting: something is too close in the direction of travel.",
    ),
    (
        known(base=base("held", "stop_field"), goal=goal("paused", reason="paused")),
        "Waiting: something is too close in the direction of travel.",
    ),
    (
        known(base=base("held", "scan_lost"), goal=DRIVING, ages={"goal": 3.5}),
        "Waiting: the lidar is silent.",
    ),
    (
        known(base=base("held", "command_lost"), goal=DRIVING),
        "Waiting: velocity commands stopped arriving.",
    ),
    (
        known(base=base("held", "command_lost"), goal=TOUR_GOAL, trip=trip("driving")),
        "Waiting: velocity commands stopped arriving. It will continue by itself.",
    ),
    (
        known(lost_goal=DRIVING),
        "The planner was restarted; the drive to kitchen was lost.",
    ),
    (known(goal=None), "Asking the robot what it is doing …"),
    (
        known(silent=frozenset({"planner"}), goal=None),
        "The robot cannot drive by itself: the planner is not running.",
    ),
    (
        known(silent=frozenset({"planner"}), goal=DRIVING),
        "The robot cannot drive by itself: the planner is not running.",
    ),
    (known(silent=frozenset({"viz-pc"})), "Ready."),
    (known(estimate=None), "The robot does not know where it is yet."),
    (
        known(silent=frozenset({"localizer"})),
        "The robot does not know where it is: the localizer is not running.",
    ),
    (
        known(estimate_age_s=1.5),
        "The robot does not know where it is: the localizer sends nothing new.",
    ),
    (
        known(at="lost", goal=DRIVING),
        "The robot does not know where it is. Show it with “Set pose …”, or let it search.",
    ),
    (known(at="searching"), "The robot is working out where it is."),
    (
        known(at="searching", wants_turn=True),
        "The robot is working out where it is, and needs to turn to see more.",
    ),
    (known(at="lost", has_map=False), "Ready."),
    (
        known(mapping=mapping("idle"), estimate=None, has_map=False),
        "It has no map yet. Make one in the “Map” tab.",
    ),
    (
        known(mapping=mapping("idle"), estimate=DISCARDED, has_map=False),
        "It has no map yet. Make one in the “Map” tab.",
    ),
    (known(mapping=mapping("idle")), "Ready."),
    (known(mapping=mapping("starting")), "It is getting ready to make a map."),
    (
        known(mapping=mapping("mapping"), at="mapping"),
        "Making the map “home”. Drive the robot through every room.",
    ),
    (
        known(mapping=mapping("mapping"), at="mapping", goal=goal("planning")),
        "Looking for a path to kitchen.",
    ),
    (
        known(mapping=mapping("mapping", "The lidar is silent."), at="mapping"),
        "Making a map: the lidar is silent.",
    ),
    (
        known(mapping=mapping("mapping"), at="lost"),
        "It cannot find its place on the new map. Bring it back to where it has been.",
    ),
    (
        known(mapping=mapping("paused"), at="mapping"),
        "The map “home” is paused. Press “Continue”.",
    ),
    (known(mapping=mapping("saving"), at="mapping"), "It is saving its new map."),
    (
        known(at="lost", goal=goal("driving", frame="odom")),
        "It is on its way to the place on the map.",
    ),
    (known(goal=goal("planning")), "Looking for a path to kitchen."),
    (known(goal=DRIVING), "It is on its way to kitchen, 3.2 m to go, about 12 s."),
    (
        known(goal=goal("driving", distance_remaining=0.6, eta=2.04)),
        "It is on its way to kitchen, 0.6 m to go, about 2 s.",
    ),
    (
        known(goal=goal("driving", distance_remaining=0.5, eta=0.2)),
        "It is on its way to kitchen, 0.5 m to go, about 1 s.",
    ),
    (
        known(goal=goal("driving", distance_remaining=0.04, eta=2.0)),
        "It is on its way to kitchen, nearly there.",
    ),
    (
        known(goal=goal("driving"), at="unsure"),
        "It is on its way to kitchen, slowly.",
    ),
    (
        known(goal=goal("driving", pose=Pose2D(7.0, 7.0, 0.0))),
        "It is on its way to the place on the map.",
    ),
    (
        known(
            goal=goal(
                "recovering", message="Something is in the way; the robot waits for it to go."
            )
        ),
        "On the way to kitchen: something is in the way; the robot waits for it to go.",
    ),
    (
        known(goal=goal("paused", reason="taken_over")),
        "It is paused on its way to kitchen: somebody drove it by hand. Press “Continue”.",
    ),
    (
        known(goal=goal("paused", reason="restarted")),
        "It is paused on its way to kitchen: the base was restarted. Press “Continue”.",
    ),
    (
        known(goal=goal("paused", reason="paused")),
        "It is paused on its way to kitchen. Press “Continue”.",
    ),
    (known(goal=goal("arrived")), "It has arrived at kitchen."),
    (known(goal=goal("arrived", pose=Pose2D(2.1, 2.1, 0.0))), "Ready."),  # driven on by hand
    (
        known(goal=goal("arrived", pose=Pose2D(2.1, 1.9, 0.0))),
        "It has arrived at the place on the map.",
    ),
    (
        known(goal=goal("failed", reason="blocked")),
        "It did not reach kitchen: something is in the way and does not move.",
    ),
    (known(goal=goal("canceled")), "Canceled. Ready."),
    (
        known(goal=TOUR_GOAL, trip=trip("driving")),
        "It is on its way to kitchen, 3.2 m to go, about 12 s (stop 2 of 3).",
    ),
    (
        known(goal=goal("driving", "tour-t1-1-0"), trip=trip("driving", name=None), tour=None),
        "It is on its way to kitchen (stop 2).",
    ),
    (
        known(goal=goal("arrived", "tour-t1-1-0"), trip=trip("dwelling")),
        "It is staying at kitchen for a while (stop 2 of 3).",
    ),
    (
        known(goal=goal("paused", "tour-t1-1-0"), trip=trip("paused", reason="stopped")),
        "The tour is paused: it was stopped. Press “Continue”.",
    ),
    (
        known(goal=DRIVING, trip=trip("paused", reason="other_goal")),
        "It is on its way to kitchen, 3.2 m to go, about 12 s.",
    ),
    (
        known(goal=goal("arrived"), trip=trip("paused", reason="other_goal")),
        "The tour is paused: somebody sent it elsewhere. Press “Continue”.",
    ),
    (
        known(trip=trip("waiting", message="The planner is not running.")),
        "The tour is waiting: the planner is not running.",
    ),
    (
        known(goal=goal("arrived", "tour-t1-2-0"), trip=trip("done", results=results("reached"))),
        "The tour is done.",
    ),
    (
        known(
            goal=goal("arrived", "tour-t1-2-0"),
            trip=trip("done", results=results("reached", "skipped", "reached")),
        ),
        "The tour is over: 2 of 3 places reached.",
    ),
    (
        known(
            goal=goal("failed", "tour-t1-2-0"),
            trip=trip("failed", reason="aborted", results=results("failed")),
        ),
        "The tour was given up: the trip was given up after a stop failed.",
    ),
    (
        known(goal=goal("arrived"), trip=trip("failed", reason="aborted")),
        "It has arrived at kitchen.",
    ),
    (
        known(
            goal=TOUR_GOAL,
            trip=trip("driving", reason="low_battery", message="Battery at 18 %: driving home."),
        ),
        "Battery at 18 %: driving home.",
    ),
    (
        known(goal=goal("arrived", "tour-t2-0-0"), trip=trip("paused", reason="low_battery")),
        "The tour is paused: the battery was low; charge it first. Press “Continue”.",
    ),
    (
        known(
            trip=trip("idle", reason="low_battery", message="Battery at 18 %: charge the robot.")
        ),
        "Battery at 18 %: charge the robot.",
    ),
]


@pytest.mark.parametrize(("case", "sentence"), CASES, ids=[text for _, text in CASES])
def test_one_sentence_says_what_matters_most(case: RobotState, sentence: str) -> None:
    assert situation(case).headline == sentence
    assert situation(case).detail == ""


def test_what_keeps_it_from_driving_comes_first() -> None:
    everything = known(
        base=base("stopped", "button"), at="lost", goal=goal("paused"), trip=trip("waiting")
    )
    assert situation(everything).headline.startswith("Stopped.")
    assert situation(everything).tone == "bad"


def test_a_robot_that_does_not_stop_is_not_called_stopped() -> None:
    sentence = "NOT STOPPED: the motor board does not obey: it drives by itself at 0.30 m/s."
    found = situation(RobotState(base=base("fault", "does_not_obey", sentence)))
    assert (found.headline, found.tone) == (sentence, "bad")


@pytest.mark.parametrize(
    ("case", "sentence"),
    [
        (
            known(is_away=True, away_s=12.0),
            "No contact with the robot for 12 s. It may be switched off or out of range.",
        ),
        (
            known(is_away=True, away_s=0.3),
            "No contact with the robot. It may be switched off or out of range.",
        ),
        (
            known(estimate_age_s=5.0, ages={"pose": 5.0}, base=base("held", "scan_lost")),
            "Waiting: the lidar is silent.",
        ),
        (
            known(estimate_age_s=5.0, ages={"pose": 5.0}),
            "The robot does not know where it is: the localizer has sent nothing for 5 s.",
        ),
        (
            known(goal=goal("driving"), ages={"goal": 200.0}),
            "It is on its way to kitchen · 3 min ago",
        ),
        (
            known(goal=goal("arrived"), trip=trip("dwelling"), silent=frozenset({"tour"})),
            "The tour does not go on: the tour service is not running.",
        ),
    ],
)
def test_what_is_old_is_said_with_its_age(case: RobotState, sentence: str) -> None:
    assert situation(case).headline == sentence


@pytest.mark.parametrize(("status", "goes_on"), [(IDLE, False), (DRIVING, True)])
def test_sentence_and_line_of_a_held_robot_promise_the_same(
    status: GoalStatus, *, goes_on: bool
) -> None:
    held = known(base=base("held", "scan_lost"), goal=status)
    details = [line.detail for line in state_lines(held) if line.headline == "Held"]
    assert situation(held).headline.endswith(GOES_ON) == goes_on
    assert details == ["The lidar is silent. " + GOES_ON if goes_on else "The lidar is silent."]


PAUSED = ("stopped", "taken_over", "other_goal", "canceled", "")


@pytest.mark.parametrize(
    ("case", "is_wanted"),
    [
        (known(base=base("stopped", "button")), True),
        (known(base=base("stopped", "button"), goal=goal("paused", reason="stopped")), True),
        (known(base=base("stopped", "bumper")), False),
        (known(base=base("stopped", "battery")), False),
        *[(known(goal=goal("paused", reason=one)), True) for one in PAUSED],
        *[(known(trip=trip("paused", reason=one)), True) for one in PAUSED],
        (known(goal=goal("paused", reason="restarted")), False),
        (known(trip=trip("paused", reason="low_battery")), False),
        (known(mapping=mapping("paused")), True),
        (known(goal=goal("failed", reason="no_path")), False),
        (known(at="lost"), False),
    ],
)
def test_a_stop_or_pause_that_somebody_wanted_is_not_among_what_went_wrong(
    case: RobotState, *, is_wanted: bool
) -> None:
    record = Record(LATELY)
    record.say(1, situation(case))
    assert (record.troubles() == []) == is_wanted
