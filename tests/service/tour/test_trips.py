"""Trips through the wire, with a scripted planner."""

from typing import TYPE_CHECKING

import pytest
from msgspec import structs

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.geometry import Pose2D
from trolley.messages import BaseState, SavedPose, Stop
from trolley.messages.request_params import Named, SendGoal, StartTour, WhichGoal
from trolley.messages.touring import Tour

if TYPE_CHECKING:
    from .conftest import Home, Plan


def test_trip_visits_all_stops_in_order(home: "Home"):
    began = home.start("corridor", "entrance", "kitchen")
    assert (began.state, began.stop, began.name) == ("driving", 0, None)
    done = home.run_until("done")
    assert home.results() == [(0, "reached", ""), (1, "reached", ""), (2, "reached", "")]
    assert done.message == "All 3 stops were reached."
    assert [goal.pose for goal in home.planner.sent] == [
        home.tour.places.find(name) for name in ("corridor", "entrance", "kitchen")
    ]
    trip = done.trip
    assert home.planner.ids == [f"tour-{trip}-{stop}-1" for stop in range(3)]
    assert all(4.0 <= one.seconds <= 5.0 for one in done.results)


def test_stored_tour_is_started_by_name(home: "Home"):
    tour = Tour(name="evening", stops=[Stop(name="kitchen")])
    home.lockstep.ask(requests.TOURS_PUT, tour)
    status = home.lockstep.ask(requests.TOUR_START, StartTour(name="evening"))
    assert status.name == "evening"
    home.run_until("done")


def test_unknown_names_are_refused_before_setting_off(home: "Home"):
    with pytest.raises(Refused) as caught:
        home.start("corridor", "cellar")
    assert caught.value.code == codes.UNKNOWN_NAME
    with pytest.raises(Refused) as caught:
        home.lockstep.ask(requests.TOUR_START, StartTour(name="nowhere"))
    assert caught.value.code == codes.UNKNOWN_NAME
    assert home.planner.sent == []


def test_robot_dwells_at_a_stop(home: "Home"):
    home.start(Stop(name="corridor", dwell=10.0), "kitchen")
    home.run_until("dwelling")
    began_ns = home.lockstep.now_ns
    home.run_until("driving")
    assert 9.5 < (home.lockstep.now_ns - began_ns) * 1e-9 < 11.0
    assert home.status.stop == 1


def on_another_map(home: "Home") -> None:
    """The robot is upstairs from now on."""
    home.localizer.estimate = structs.replace(home.localizer.estimate, map="upstairs")
    home.lockstep.run(1.0)


@pytest.mark.parametrize(
    "stop", [Stop(pose=Pose2D(1.0, 1.0, 0.0)), Stop(name="kitchen", via=[Pose2D(1.0, 1.0, 0.0)])]
)
def test_numbers_are_not_driven_to_on_another_map(home: "Home", plan: "type[Plan]", stop: Stop):
    home.planner.script = [plan(state="failed", reason=codes.WRONG_MAP, seconds=4.0)]
    home.start(Stop(pose=Pose2D(3.0, 1.0, 0.0), on_failure="skip", retries=0), stop)
    on_another_map(home)
    home.run_until("failed")
    assert len(home.planner.sent) == 1
    assert [result.code for result in home.status.results] == [codes.WRONG_MAP, codes.WRONG_MAP]
    assert "the robot is on upstairs" in home.status.results[1].message


def test_a_paused_trip_is_not_resumed_on_another_map(home: "Home"):
    home.start(Stop(pose=Pose2D(1.0, 1.0, 0.0), retries=0))
    home.lockstep.ask(requests.TOUR_PAUSE)
    on_another_map(home)
    home.lockstep.ask(requests.TOUR_RESUME)
    home.run_until("failed")
    assert len(home.planner.sent) == 1


def test_via_points_are_handed_on(home: "Home"):
    via = [Pose2D(1.0, 1.0, 0.0), Pose2D(2.0, 1.0, 0.0)]
    home.start(Stop(pose=Pose2D(3.0, 1.0, 0.0), via=via))
    home.run_until("done")
    assert home.planner.sent[0].via == via
    assert home.planner.sent[0].frame == "map"


def test_there_and_back_twice(home: "Home"):
    home.start("corridor", "entrance", "kitchen", there_and_back=True, repeat=2)
    home.run_until("done", 120.0)
    assert [one[0] for one in home.results()] == [0, 1, 2, 1, 0, 1, 2, 1, 0]
    assert home.status.lap == 1
    assert len(set(home.planner.ids)) == 9


def test_trip_without_end_goes_on_until_it_is_stopped(home: "Home"):
    home.start("corridor", "kitchen", repeat=0)
    home.lockstep.run(60.0)
    assert home.status.state == "driving"
    assert home.status.lap > 4
    status = home.lockstep.ask(requests.TOUR_STOP)
    assert status.state == "stopped"
    home.lockstep.run(1.0)
    assert not home.planner.drives(home.planner.current)


def test_failed_stop_aborts_with_the_reason(home: "Home", plan: "type[Plan]"):
    home.planner.script = [
        plan(),
        plan(state="failed", reason=codes.BLOCKED, message="The way is blocked."),
    ]
    home.start("corridor", "kitchen", "entrance")
    failed = home.run_until("failed")
    assert home.results() == [(0, "reached", ""), (1, "failed", codes.BLOCKED)]
    assert failed.reason == codes.ABORTED
    assert failed.message == "Stop 2 (kitchen): the way is blocked; the trip was given up."


def test_failed_stop_is_tried_again_then_skipped(home: "Home", plan: "type[Plan]"):
    blocked = plan(state="failed", reason=codes.BLOCKED, message="The way is blocked.")
    home.planner.script = [blocked, blocked]
    home.start(Stop(name="corridor", retries=1, on_failure="skip"), "kitchen")
    waiting = home.run_until("waiting")
    assert waiting.message == "Stop 1 (corridor): the way is blocked; trying again in 2 s."
    done = home.run_until("done")
    assert home.results() == [(0, "skipped", codes.BLOCKED), (1, "reached", "")]
    assert done.results[0].message == "Stop 1 (corridor): the way is blocked; skipped."
    assert done.message == "1 of 2 stops were reached."
    assert (done.reached, done.missed) == (1, 1)
    assert home.planner.ids[:2] == [f"tour-{done.trip}-0-1", f"tour-{done.trip}-0-2"]


def test_retry_goes_on_until_it_works(home: "Home", plan: "type[Plan]"):
    no_path = plan(refuse=Refused(codes.NO_PATH))
    home.planner.script = [no_path] * 5
    home.start(Stop(name="corridor", on_failure="retry"))
    home.run_until("done", 200.0)
    assert home.planner.ids[-1].endswith("-0-6")


def test_retry_with_a_number_ends(home: "Home", plan: "type[Plan]"):
    home.planner.script = [plan(refuse=Refused(codes.NO_PATH))] * 9
    home.start(Stop(name="corridor", on_failure="retry", retries=2))
    home.run_until("failed", 200.0)
    assert len(home.planner.sent) == 3


def test_stop_times_out(home: "Home", plan: "type[Plan]"):
    home.planner.script = [plan(seconds=1000.0)]
    home.start(Stop(name="corridor", timeout=8.0, on_failure="skip"), "kitchen")
    home.run_until("done")
    assert home.results() == [(0, "skipped", codes.TIMEOUT), (1, "reached", "")]
    assert home.planner.goals[home.planner.ids[0]].state == "canceled"


def test_configured_time_out_holds_where_the_stop_has_none(make_home, plan: "type[Plan]"):
    home = make_home(stop_timeout_s=6.0)
    home.save_places()
    home.planner.script = [plan(seconds=1000.0)]
    home.start("corridor")
    home.run_until("failed", 10.0)
    assert home.results() == [(0, "failed", codes.TIMEOUT)]


def test_place_on_another_map_is_a_failure(home: "Home"):
    cellar = SavedPose(name="cellar", map="downstairs", pose=Pose2D(0.0, 0.0, 0.0))
    home.lockstep.ask(requests.POSES_PUT, cellar)
    home.start(Stop(name="cellar", on_failure="skip"), "kitchen")
    home.run_until("done")
    assert home.results() == [(0, "skipped", codes.WRONG_MAP), (1, "reached", "")]


def test_place_deleted_on_the_way_is_a_failure(home: "Home"):
    home.start("corridor", Stop(name="kitchen", on_failure="skip"))
    home.lockstep.ask(requests.POSES_DELETE, Named(name="kitchen"))
    home.run_until("done")
    assert home.results()[1] == (1, "skipped", codes.UNKNOWN_NAME)


def test_trip_that_can_reach_nothing_does_not_spin(home: "Home", plan: "type[Plan]"):
    home.planner.script = [plan(refuse=Refused(codes.NO_PATH))] * 10_000
    home.start(Stop(name="kitchen", on_failure="skip"), repeat=0)
    home.lockstep.run(150.0)
    assert home.status.state == "driving"
    assert len(home.planner.sent) < 12


def test_trip_where_the_robot_stands_does_not_spin(home: "Home", plan: "type[Plan]"):
    home.planner.script = [plan(seconds=0.0) for _ in range(10_000)]
    home.start("kitchen", repeat=0)
    home.lockstep.run(20.0)
    assert len(home.planner.sent) <= 21


def test_pause_and_resume_drive_to_the_same_stop(home: "Home"):
    home.start("corridor", "kitchen")
    home.lockstep.run(1.0)
    paused = home.lockstep.ask(requests.TOUR_PAUSE)
    assert (paused.state, paused.reason) == ("paused", codes.PAUSED)
    home.lockstep.run(20.0)
    assert home.status.state == "paused"
    assert home.planner.goals[home.planner.ids[0]].state == "paused"
    home.lockstep.ask(requests.TOUR_RESUME)
    home.run_until("done")
    assert home.results() == [(0, "reached", ""), (1, "reached", "")]
    assert [one.rpartition("-")[0][-1] for one in home.planner.ids] == ["0", "0", "1"]


def test_skip_goes_on_to_the_next_stop(home: "Home"):
    home.start("corridor", "kitchen")
    home.lockstep.run(1.0)
    assert home.lockstep.ask(requests.TOUR_SKIP).stop == 1
    home.run_until("done")
    assert home.results() == [(0, "skipped", codes.SKIPPED), (1, "reached", "")]


def test_skip_of_a_paused_trip_stays_paused(home: "Home"):
    home.start("corridor", "kitchen")
    home.lockstep.run(1.0)
    home.lockstep.ask(requests.TOUR_PAUSE)
    home.lockstep.ask(requests.TOUR_SKIP)
    home.lockstep.run(10.0)
    assert (home.status.state, home.status.stop) == ("paused", 1)
    assert len(home.planner.ids) == 1


def test_each_skip_of_a_paused_trip_is_told(home: "Home"):
    home.start("corridor", repeat=0)
    home.lockstep.run(1.0)
    home.lockstep.ask(requests.TOUR_PAUSE)
    for num_skipped in (1, 2, 3):
        home.lockstep.ask(requests.TOUR_SKIP)
        home.lockstep.run(1.0)
        assert (home.status.lap, home.status.missed) == (num_skipped, num_skipped)


@pytest.mark.parametrize(
    "request_", [requests.TOUR_STOP, requests.TOUR_PAUSE, requests.TOUR_RESUME, requests.TOUR_SKIP]
)
def test_without_a_trip_there_is_nothing_to_do(home: "Home", request_):
    with pytest.raises(Refused) as caught:
        home.lockstep.ask(request_)
    assert caught.value.code == codes.NOT_DRIVING


def test_new_trip_replaces_the_running_one(home: "Home"):
    first = home.start("corridor", "entrance")
    home.lockstep.run(1.0)
    second = home.start("kitchen")
    assert second.trip != first.trip
    home.run_until("done")
    assert home.planner.ids == [f"tour-{first.trip}-0-1", f"tour-{second.trip}-0-1"]
    past = home.lockstep.ask(requests.TOUR_HISTORY)
    assert [(one.state, one.reason) for one in past] == [("done", ""), ("stopped", codes.REPLACED)]


def test_start_while_a_direct_goal_drives_replaces_it(home: "Home"):
    goal = SendGoal(id="mine", pose=Pose2D(1.0, 1.0, 0.0))
    home.lockstep.ask(requests.GOAL_SEND, goal)
    home.start("kitchen")
    home.run_until("done")
    assert home.planner.goals["mine"].state == "canceled"


def test_goal_from_somebody_else_pauses_the_trip(home: "Home"):
    home.start("corridor", "kitchen")
    home.lockstep.run(1.0)
    home.lockstep.ask(requests.GOAL_SEND, SendGoal(id="mine", pose=Pose2D(1.0, 1.0, 0.0)))
    home.lockstep.run(0.5)
    assert (home.status.state, home.status.reason) == ("paused", codes.OTHER_GOAL)
    home.lockstep.run(20.0)
    assert home.planner.goals["mine"].state == "arrived"
    assert home.status.state == "paused"
    home.lockstep.ask(requests.TOUR_RESUME)
    home.run_until("done")


def test_goal_from_somebody_else_pauses_a_dwelling_trip(home: "Home"):
    home.start(Stop(name="corridor", dwell=20.0), "kitchen")
    home.run_until("dwelling")
    home.lockstep.ask(requests.GOAL_SEND, SendGoal(id="mine", pose=Pose2D(1.0, 1.0, 0.0)))
    home.lockstep.run(30.0)
    assert (home.status.state, home.status.reason) == ("paused", codes.OTHER_GOAL)
    home.lockstep.ask(requests.TOUR_RESUME)
    home.run_until("done")
    assert home.results() == [(0, "reached", ""), (1, "reached", "")]
    assert [one.split("-")[2] for one in home.planner.ids if one != "mine"] == ["0", "0", "1"]


def test_goal_from_somebody_else_pauses_a_waiting_trip(home: "Home", plan: "type[Plan]"):
    home.planner.script = [plan(refuse=Refused(codes.NO_PATH))]
    home.start(Stop(name="corridor", retries=1))
    home.run_until("waiting")
    home.lockstep.ask(requests.GOAL_SEND, SendGoal(id="mine", pose=Pose2D(1.0, 1.0, 0.0)))
    home.lockstep.run(10.0)
    assert (home.status.state, home.status.reason) == ("paused", codes.OTHER_GOAL)
    assert home.planner.goals["mine"].state == "arrived"


@pytest.mark.parametrize(
    ("request_", "reason"),
    [(requests.GOAL_CANCEL, codes.CANCELED), (requests.GOAL_PAUSE, codes.PAUSED)],
)
def test_cancel_or_pause_of_the_goal_pauses_the_trip(home: "Home", request_, reason):
    home.start("corridor", "kitchen")
    home.lockstep.run(1.0)
    home.lockstep.ask(request_, WhichGoal(id=home.planner.current))
    home.lockstep.run(10.0)
    assert (home.status.state, home.status.reason) == ("paused", reason)
    home.lockstep.ask(requests.TOUR_RESUME)
    home.run_until("done")
    assert home.results() == [(0, "reached", ""), (1, "reached", "")]


def test_resuming_the_goal_itself_takes_the_trip_along(home: "Home"):
    home.start("corridor", "kitchen")
    home.lockstep.run(1.0)
    home.lockstep.ask(requests.TOUR_PAUSE)
    home.lockstep.run(2.0)
    home.lockstep.ask(requests.GOAL_RESUME, WhichGoal(id=home.planner.current))
    home.run_until("done")
    assert home.results() == [(0, "reached", ""), (1, "reached", "")]


def test_stop_of_the_base_pauses_the_trip_for_good(home: "Home"):
    home.start(Stop(name="corridor", dwell=5.0), "kitchen")
    home.run_until("dwelling")
    home.base.say("stopped", message="The stop button was pressed.")
    home.lockstep.run(1.0)
    home.base.say("ok")
    home.lockstep.run(30.0)
    assert (home.status.state, home.status.reason) == ("paused", codes.STOPPED)
    assert home.status.message.startswith("The stop button was pressed; resume")
    assert len(home.planner.ids) == 1


def test_stop_from_before_the_trip_that_is_heard_late_does_not_pause_it(home: "Home"):
    late = BaseState(stamp_ns=home.base.robot_ns, mode="stopped")
    home.lockstep.run(0.2)
    home.start("corridor", "kitchen")
    home.lockstep.publish(topics.BASE, late)
    home.lockstep.run(0.5)
    assert home.status.state == "driving"
    home.base.say("stopped")
    home.lockstep.run(0.5)
    assert home.status.state == "paused"
    home.lockstep.ask(requests.TOUR_RESUME)
    home.lockstep.publish(topics.BASE, late)
    home.run_until("done")


def test_hand_on_the_robot_pauses_the_trip(home: "Home"):
    home.start("corridor", "kitchen")
    home.lockstep.run(1.0)
    home.base.say("ok", source="planner")
    home.lockstep.run(0.5)
    assert home.status.state == "driving"
    home.base.say("ok", source="teleop")
    home.lockstep.run(0.5)
    assert (home.status.state, home.status.reason) == ("paused", codes.TAKEN_OVER)


def test_start_right_after_teleop_is_not_taken_for_a_take_over(home: "Home"):
    home.base.say("ok", source="teleop")
    home.lockstep.run(0.2)
    home.start("kitchen")
    home.base.say("ok", source="teleop")
    home.run_until("done")


def test_stopped_robot_does_not_set_off(home: "Home", plan: "type[Plan]"):
    home.planner.script = [plan(refuse=Refused(codes.STOPPED))]
    home.start("kitchen")
    home.lockstep.run(5.0)
    assert (home.status.state, home.status.reason) == ("paused", codes.STOPPED)
    assert len(home.planner.sent) == 1


def test_trip_that_ends_takes_along_the_goal_that_it_could_not_resume(
    home: "Home", plan: "type[Plan]"
):
    home.start("kitchen")
    home.lockstep.run(1.0)
    home.base.say("stopped")
    home.lockstep.run(0.5)
    home.planner.script = [plan(refuse=Refused(codes.STOPPED))]
    home.lockstep.ask(requests.TOUR_RESUME)
    home.lockstep.run(1.0)
    assert home.status.state == "paused"
    home.lockstep.ask(requests.TOUR_STOP)
    home.lockstep.run(1.0)
    assert home.planner.goals[home.planner.ids[0]].state == "canceled"


def test_unlocalized_robot_waits(home: "Home", plan: "type[Plan]"):
    home.planner.script = [plan(refuse=Refused(codes.NOT_LOCALIZED))] * 4
    home.start("kitchen")
    home.run_until("waiting")
    assert home.status.reason == codes.NOT_LOCALIZED
    home.run_until("done")
    assert len(set(home.planner.ids)) == 1


def test_unlocalized_robot_does_not_wait_for_ever(home: "Home", plan: "type[Plan]"):
    home.planner.script = [plan(refuse=Refused(codes.NOT_LOCALIZED))] * 1000
    home.start(Stop(name="kitchen", timeout=30.0))
    home.run_until("failed")
    assert home.results() == [(0, "failed", codes.TIMEOUT)]
    assert "does not know where it is" in home.status.message


def test_status_is_published_each_second_on_a_trip(home: "Home"):
    before = len(home.statuses)
    home.lockstep.run(10.0)
    assert (home.status.state, len(home.statuses)) == ("idle", before)
    home.start(Stop(name="corridor", dwell=60.0))
    home.run_until("dwelling")
    before = len(home.statuses)
    home.lockstep.run(10.0)
    assert len(home.statuses) - before == 10
    assert home.lockstep.get(topics.TOUR.key("trolley"))[0].payload.startswith(b"{")


def test_the_way_back_passes_the_same_points_backwards(home: "Home"):
    before_hall, before_door = Pose2D(1.0, 0.0, 0.0), Pose2D(2.0, 0.0, 0.0)
    home.start(
        "corridor",
        Stop(name="entrance", via=[before_hall, before_door]),
        "kitchen",
        there_and_back=True,
    )
    home.run_until("done", 200.0)
    assert [goal.via for goal in home.planner.sent] == [
        [],
        [before_hall, before_door],
        [],
        [],
        [before_door, before_hall],
    ]


def test_status_tells_the_tour_as_it_was_when_the_trip_began(home: "Home"):
    tour = Tour(name="evening", stops=[Stop(name="corridor"), Stop(name="kitchen")])
    home.lockstep.ask(requests.TOURS_PUT, tour)
    home.lockstep.ask(requests.TOUR_START, requests.TOUR_START.params(name="evening"))
    home.lockstep.ask(requests.TOURS_PUT, Tour(name="evening", stops=[Stop(name="entrance")]))
    home.lockstep.run(3.0)
    assert home.status.tour == tour
    assert 2.0 < home.status.seconds < 4.0
    via = [Pose2D(1.0, 0.0, 0.0)] * 300
    home.start(Stop(name="corridor", via=via))
    home.lockstep.run(1.5)
    assert home.status.tour is None


def test_a_trip_that_does_not_go_on_is_not_told_again_each_second(home: "Home"):
    """With 300 stops it takes 350 kB each time."""
    home.start("corridor", "kitchen")
    for request, state in ((requests.TOUR_PAUSE, "paused"), (requests.TOUR_STOP, "stopped")):
        home.lockstep.run(3.0)
        assert home.status.state == "driving" or state == "stopped"
        home.lockstep.ask(request)
        home.lockstep.run(0.5)
        num = len(home.statuses)
        home.lockstep.run(5.0)
        assert (home.status.state, len(home.statuses)) == (state, num)
    assert home.lockstep.get("trolley/trolley/tour") != []
