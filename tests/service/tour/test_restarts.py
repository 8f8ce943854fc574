"""What becomes of a trip when services are killed and started again."""

from typing import TYPE_CHECKING

import pytest

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.geometry import Pose2D
from trolley.messages import Stop, Tour
from trolley.messages.request_params import SendGoal, StartTour, WhichGoal

if TYPE_CHECKING:
    from .conftest import Home, Plan


def test_killed_tour_service_adopts_its_goal(home: "Home"):
    trip = home.start("corridor", "kitchen").trip
    home.lockstep.run(1.0)
    home.restart_tour()
    home.lockstep.run(1.0)
    assert home.status.state == "driving"
    done = home.run_until("done")
    assert done.trip == trip
    assert home.results() == [(0, "reached", ""), (1, "reached", "")]
    assert home.planner.ids == [f"tour-{trip}-0-1", f"tour-{trip}-1-1"]


def test_a_trip_keeps_the_speed_that_it_was_started_with(home: "Home"):
    tour = Tour(stops=[Stop(name="corridor"), Stop(name="kitchen")])
    home.lockstep.ask(requests.TOUR_START, StartTour(tour=tour, speed=0.2))
    home.lockstep.run(1.0)
    home.restart_tour()
    home.run_until("done")
    assert [goal.speed for goal in home.planner.sent] == [0.2, 0.2]
    home.start("corridor")
    home.run_until("done")
    assert home.planner.sent[-1].speed is None


def test_time_out_survives_a_restart(home: "Home", plan: "type[Plan]"):
    home.planner.script = [plan(seconds=1000.0)]
    home.start(Stop(name="corridor", timeout=15.0))
    home.lockstep.run(10.0)
    home.restart_tour()
    failed = home.run_until("failed", 6.0)
    assert failed.results[0].seconds == pytest.approx(15.0, abs=0.5)


def test_stop_reached_while_the_tour_service_was_away_counts(home: "Home"):
    home.start("corridor", "kitchen")
    home.lockstep.run(1.0)
    home.lockstep.kill("tour")
    home.lockstep.run(10.0)
    home.add_tour()
    home.run_until("done")
    assert home.results() == [(0, "reached", ""), (1, "reached", "")]
    assert len(home.planner.ids) == 2


def test_what_people_did_while_the_tour_service_was_away_holds(home: "Home"):
    home.start("corridor", "kitchen")
    home.lockstep.run(1.0)
    home.lockstep.kill("tour")
    home.lockstep.ask(requests.GOAL_CANCEL, WhichGoal(id=home.planner.current))
    home.add_tour()
    home.lockstep.run(10.0)
    assert (home.status.state, home.status.reason) == ("paused", codes.CANCELED)


def test_goal_sent_while_the_tour_service_was_away_pauses_the_trip(home: "Home"):
    home.start("corridor", "kitchen")
    home.lockstep.run(1.0)
    home.lockstep.kill("tour")
    home.lockstep.ask(requests.GOAL_SEND, SendGoal(id="mine", pose=Pose2D(1.0, 1.0, 0.0)))
    home.lockstep.run(10.0)
    home.add_tour()
    home.lockstep.run(10.0)
    assert (home.status.state, home.status.reason) == ("paused", codes.OTHER_GOAL)


def test_stop_while_the_tour_service_was_away_holds(home: "Home"):
    home.start(Stop(name="corridor", dwell=30.0), "kitchen")
    home.run_until("dwelling")
    home.lockstep.kill("tour")
    home.base.say("stopped")
    home.add_tour()
    home.lockstep.run(60.0)
    assert (home.status.state, home.status.reason) == ("paused", codes.STOPPED)


def test_paused_trip_stays_paused(home: "Home"):
    home.start("corridor", "kitchen")
    home.lockstep.run(1.0)
    home.lockstep.ask(requests.TOUR_PAUSE)
    home.restart_tour()
    home.lockstep.run(30.0)
    assert (home.status.state, home.status.reason) == ("paused", codes.PAUSED)
    home.lockstep.ask(requests.TOUR_RESUME)
    home.run_until("done")


def test_dwelling_goes_on(home: "Home"):
    home.start(Stop(name="corridor", dwell=5.0), "kitchen")
    home.run_until("dwelling")
    home.restart_tour()
    home.run_until("done")
    assert home.results() == [(0, "reached", ""), (1, "reached", "")]
    assert len(home.planner.ids) == 2


def test_restarted_planner_gets_the_same_goal_again(home: "Home"):
    trip = home.start("corridor", "kitchen").trip
    home.lockstep.run(1.0)
    home.restart_planner()
    home.run_until("done")
    assert home.planner.ids == [f"tour-{trip}-0-1", f"tour-{trip}-1-1"]
    assert home.results() == [(0, "reached", ""), (1, "reached", "")]


def test_trip_waits_while_the_planner_is_away(home: "Home"):
    trip = home.start(Stop(name="corridor", timeout=20.0), "kitchen").trip
    home.lockstep.run(1.0)
    home.lockstep.kill("planner")
    waiting = home.run_until("waiting", 5.0)
    assert waiting.reason == codes.NO_PLANNER
    home.lockstep.run(60.0)
    assert home.status.state == "waiting"
    home.planner = home.lockstep.add(type(home.planner)())
    home.run_until("done")
    assert home.planner.ids[0] == f"tour-{trip}-0-1"


def test_trip_waits_for_a_planner_that_is_not_ready(home: "Home", plan: "type[Plan]"):
    home.planner.script = [plan(refuse=Refused(codes.NOT_READY, "The planner lacks a map."))] * 3
    home.start("corridor")
    home.run_until("waiting", 5.0)
    assert home.status.reason == codes.NOT_READY
    assert home.status.message == "The planner lacks a map."
    home.run_until("done")


def test_stopping_a_trip_while_the_planner_is_away_holds_when_it_is_back(home: "Home"):
    home.start("corridor", "kitchen")
    home.lockstep.run(1.0)
    home.lockstep.kill("planner")
    home.lockstep.run(5.0)
    home.lockstep.ask(requests.TOUR_STOP)
    home.planner = home.lockstep.add(type(home.planner)())
    home.lockstep.run(10.0)
    assert home.planner.sent == []


def test_restart_of_the_base_pauses_the_trip(home: "Home"):
    home.start("corridor", "kitchen")
    home.lockstep.run(1.0)
    home.restart_base(epoch_ns=200_000_000_000)
    assert (home.status.state, home.status.reason) == ("paused", codes.RESTARTED)
    home.lockstep.run(30.0)
    assert home.status.state == "paused"
    home.lockstep.ask(requests.TOUR_RESUME)
    home.run_until("done")


def test_restart_of_the_base_pauses_a_dwelling_trip(home: "Home"):
    home.start(Stop(name="corridor", dwell=30.0), "kitchen")
    home.run_until("dwelling")
    home.restart_base(epoch_ns=200_000_000_000)
    home.lockstep.run(60.0)
    assert (home.status.state, home.status.reason) == ("paused", codes.RESTARTED)


def reboot(home: "Home") -> None:
    """Everything is killed and starts again, tour first."""
    for name in ("tour", "planner", "base"):
        home.lockstep.kill(name)
    home.lockstep.run(5.0)
    home.add_tour()
    home.lockstep.run(3.0)
    home.base = home.lockstep.add(type(home.base)(300_000_000_000))
    home.planner = home.lockstep.add(type(home.planner)())


def test_after_a_reboot_a_trip_waits_for_people(home: "Home"):
    home.start("corridor", "kitchen")
    home.lockstep.run(1.0)
    reboot(home)
    home.lockstep.run(30.0)
    assert (home.status.state, home.status.reason) == ("paused", codes.RESTARTED)
    assert home.planner.sent == []


def test_after_a_reboot_a_trip_that_may_goes_on_where_it_was(home: "Home"):
    trip = home.start("corridor", "kitchen", resume=True).trip
    home.lockstep.run(6.0)
    assert home.status.stop == 1
    reboot(home)
    done = home.run_until("done")
    assert done.trip == trip
    assert home.results() == [(0, "reached", ""), (1, "reached", "")]


def test_after_a_reboot_a_paused_trip_stays_paused(home: "Home"):
    home.start("corridor", "kitchen", resume=True)
    home.lockstep.run(1.0)
    home.lockstep.ask(requests.TOUR_PAUSE)
    reboot(home)
    home.lockstep.run(30.0)
    assert home.status.state == "paused"


def test_trip_held_for_the_clock_takes_requests(home: "Home"):
    home.start("corridor", "kitchen", "entrance")
    home.lockstep.run(1.0)
    home.lockstep.kill("tour")
    home.lockstep.kill("base")
    home.lockstep.run(2.0)
    home.add_tour()
    assert home.status.state == "waiting"
    assert home.lockstep.ask(requests.TOUR_SKIP).stop == 1
    assert home.lockstep.ask(requests.TOUR_STOP).state == "stopped"


def test_trip_paused_while_held_for_the_clock_stays_paused(home: "Home"):
    home.start("corridor", "kitchen")
    home.lockstep.run(1.0)
    for name in ("tour", "base"):
        home.lockstep.kill(name)
    home.lockstep.run(2.0)
    home.add_tour()
    assert home.lockstep.ask(requests.TOUR_PAUSE).state == "paused"
    home.base = home.lockstep.add(type(home.base)(home.base.epoch))
    home.lockstep.run(30.0)
    assert (home.status.state, home.status.reason) == ("paused", codes.PAUSED)
    assert len(home.planner.ids) == 1
    home.lockstep.ask(requests.TOUR_RESUME)
    home.run_until("done")


def test_old_trip_is_shown_after_a_restart(home: "Home"):
    home.start("corridor")
    done = home.run_until("done")
    home.restart_tour()
    home.lockstep.run(2.0)
    assert home.status.trip == done.trip
    assert home.status.state == "done"
    assert len(home.lockstep.ask(requests.TOUR_HISTORY)) == 1


def test_new_trip_after_a_restart_has_ids_of_its_own(home: "Home"):
    home.start("corridor")
    home.run_until("done")
    home.restart_tour()
    home.lockstep.run(1.0)
    home.start("corridor")
    home.run_until("done")
    assert len(home.planner.ids) == 2


@pytest.mark.parametrize("content", ["trip = ", 'trip = "a"\ntries = [1, 2]\ntour = {name = "x"}'])
def test_broken_trip_is_kept_aside_and_reported(home: "Home", content):
    home.lockstep.kill("tour")
    folder = home.lockstep.state / "trolley"
    (folder / "trip.toml").write_text(content)
    home.add_tour()
    health = home.lockstep.record(topics.HEALTH, "tour")
    home.lockstep.run(2.0)
    assert health[-1].state == "degraded"
    assert "trip.toml" in health[-1].message
    assert home.status.state == "idle"
    assert len(list(folder.glob("trip.toml.broken-*"))) == 1
    home.start("corridor")
    home.run_until("done")


def test_trip_goes_on_where_its_state_cannot_be_saved(home: "Home"):
    folder = home.lockstep.state / "trolley"
    (folder / "trip.toml").mkdir()  # even root cannot replace a folder by a file
    health = home.lockstep.record(topics.HEALTH, "tour")
    home.start("corridor", "kitchen")
    home.run_until("done")
    assert any(one.state == "degraded" and "trip.toml" in one.message for one in health)
