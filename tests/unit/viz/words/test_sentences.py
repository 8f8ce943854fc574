"""The state in plain words."""

import msgspec
import pytest

from trolley.geometry import Pose2D
from trolley.messages import (
    BaseState,
    Candidate,
    GoalStatus,
    Link,
    PoseEstimate,
    SavedPose,
    Stop,
    StopResult,
    Tour,
    TourStatus,
)
from trolley_viz.words.sentences import (
    StatusLine,
    base_line,
    duration,
    goal_line,
    percent,
    position_line,
    result_line,
    trip_line,
)

KITCHEN = SavedPose(name="kitchen", map="room", pose=Pose2D(2.0, 1.0, 0.0))
TOUR = Tour(name="article", stops=[Stop(name="hall"), Stop(name="kitchen"), Stop(name="door")])


def estimate(state: str, **fields: object) -> PoseEstimate:
    values: dict[str, object] = {"match": 0.93, "spread": 0.1, "pose": Pose2D(1.0, 2.0, 0.0)}
    values |= {"covariance": [0.0009, 0, 0, 0, 0.0016, 0, 0, 0, 0.01], **fields}
    return PoseEstimate(stamp_ns=1, map="room", state=state, **values)  # type: ignore[arg-type]


def test_localized_says_how_well_and_where() -> None:
    words = position_line(estimate("localized"), 0.1)
    assert words == StatusLine("Localized 93 %", "good", "x 1.00 m, y 2.00 m, 0° (± 5 cm)")


def test_old_estimates_are_stale_whatever_they_say() -> None:
    assert position_line(estimate("localized"), 3.2) == StatusLine(
        "Stale · 3 s ago", "bad", "The last position is too old to rely on."
    )
    assert position_line(estimate("localized"), None).headline == "Stale"


def test_without_a_map_any_more_there_is_no_position_however_old_that_is() -> None:
    gone = msgspec.structs.replace(estimate("searching"), map=None, message="there is no map")
    assert position_line(gone, None) == StatusLine(
        "No position", "idle", "There is no map: make one in the “Map” tab."
    )


def test_a_search_says_between_how_many_places() -> None:
    places = [Candidate(pose=Pose2D(0.0, float(i), 0.0), match=0.8) for i in range(2)]
    words = position_line(estimate("searching", candidates=places, wants_turn=True), 0.1)
    assert words.headline == "Searching"
    assert words.detail == "It could be in 2 places. A turn on the spot would help."


@pytest.mark.parametrize(
    ("state", "tone"), [("unsure", "warn"), ("lost", "bad"), ("mapping", "busy")]
)
def test_every_state_has_its_tone(state: str, tone: str) -> None:
    assert position_line(estimate(state), 0.1).tone == tone


def test_nothing_is_said_of_a_base_that_drives() -> None:
    assert base_line(BaseState(stamp_ns=1, mode="ok")) is None
    assert base_line(None) is None
    creeping = BaseState(stamp_ns=1, mode="ok", reason="blind", message="It sees nothing.")
    assert base_line(creeping) == StatusLine("Creeping", "warn", "It sees nothing.")


def test_a_stop_that_the_silent_board_cannot_confirm_is_not_called_stopped() -> None:
    board = Link(name="chassis", state="searching")
    base = BaseState(stamp_ns=1, mode="stopped", message="Not known.", links=[board])
    assert base_line(base) == StatusLine("Stop not confirmed", "bad", "Not known.")


def test_a_stopped_base_says_why_and_what_to_do() -> None:
    words = base_line(BaseState(stamp_ns=1, mode="stopped", reason="button"))
    assert words == StatusLine(
        "Stopped", "bad", "The stop button was pressed. Press “Drive on” to let it drive again."
    )


def test_a_base_that_does_not_stop_says_so() -> None:
    base = BaseState(stamp_ns=0, mode="fault", reason="does_not_obey", not_stopped=True)
    assert base_line(base) == StatusLine("NOT STOPPED", "bad", "The motor board does not obey.")


def test_a_goal_is_called_by_its_place() -> None:
    goal = GoalStatus(
        stamp_ns=1,
        id="a",
        state="driving",
        pose=Pose2D(2.02, 1.0, 0.0),
        distance_remaining=2.34,
        eta=8.2,
    )
    assert goal_line(goal, [KITCHEN]) == StatusLine(
        "Driving to kitchen", "busy", "2.3 m to go, about 8 s"
    )
    assert goal_line(goal, []).headline == "Driving to the place on the map"
    careful = msgspec.structs.replace(goal, warning="in_passage")
    assert goal_line(careful, [KITCHEN]).detail == (
        "2.3 m to go, about 8 s. That is a narrow passage: while the robot stands there, nobody "
        "gets past it."
    )
    near = msgspec.structs.replace(goal, distance_remaining=0.04, eta=0.9)
    assert goal_line(near, [KITCHEN]).detail == "Nearly there"


@pytest.mark.parametrize(
    ("reason", "headline"),
    [
        ("waiting", "Waiting on the way to kitchen"),
        ("scan_lost", "Waiting on the way to kitchen"),
        ("stale", "Waiting on the way to kitchen"),
        ("slip", "Freeing itself on the way to kitchen"),
    ],
)
def test_a_robot_that_waits_is_not_said_to_free_itself(reason: str, headline: str) -> None:
    goal = GoalStatus(stamp_ns=1, id="a", state="recovering", reason=reason, pose=KITCHEN.pose)
    assert goal_line(goal, [KITCHEN]).headline == headline


def test_a_failed_goal_says_why() -> None:
    goal = GoalStatus(stamp_ns=1, id="a", state="failed", reason="blocked", pose=KITCHEN.pose)
    assert goal_line(goal, [KITCHEN]) == StatusLine(
        "Did not reach kitchen", "bad", "Something is in the way and does not move."
    )


def test_a_trip_counts_its_stops() -> None:
    trip = TourStatus(stamp_ns=1, name="article", trip="t1", state="driving", stop=1)
    assert trip_line(trip, TOUR) == StatusLine("“article”: stop 2 of 3 (kitchen)", "busy")
    assert trip_line(trip, None) == StatusLine("“article”: stop 2", "busy")


def test_a_trip_that_is_done_counts_what_it_reached() -> None:
    results = [StopResult(stop=i, name=None, state="reached" if i else "skipped") for i in range(3)]
    trip = TourStatus(stamp_ns=1, name="article", trip="t1", state="done", results=results)
    assert trip_line(trip, TOUR) == StatusLine("“article” done", "good", "2 of 3 stops reached.")


def test_a_stop_says_how_it_ended() -> None:
    failed = StopResult(stop=2, name=None, state="failed", code="no_path")
    assert result_line(failed).headline == "stop 3 not reached"
    assert "no path there" in result_line(failed).detail


def test_numbers_for_people() -> None:
    assert [percent(x) for x in (0.0, 0.934, 0.999, 1.0)] == ["0 %", "93 %", "99 %", "100 %"]
    assert [duration(x) for x in (0.04, 9.96, 119.0, 150.0, 7300.0)] == [
        "0.0 s",
        "10 s",
        "119 s",
        "2 min",
        "2 h 1 min",
    ]
