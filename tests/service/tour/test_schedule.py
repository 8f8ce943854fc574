"""Tours that start by themselves, and what keeps them from it."""

import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING

import pytest

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.geometry import Pose2D
from trolley.messages import ScheduleEntry, Stop, Tour
from trolley.messages.request_params import AskOffer, Named, SendGoal, StartTour, WhichGoal
from trolley.messages.touring import Day

from .conftest import replace

if TYPE_CHECKING:
    from .conftest import Home, Plan

DUE = datetime(2026, 11, 2, 7, 30, 5, tzinfo=UTC)
"""A Monday, at half past eight in Berlin."""


@pytest.fixture
def berlin(monkeypatch):
    """Local time is that of Berlin."""
    monkeypatch.setenv("TZ", "Europe/Berlin")
    time.tzset()
    yield
    monkeypatch.undo()
    time.tzset()


@pytest.fixture
def moved_to_berlin(berlin: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Local time is that of New York, and is set to that of Berlin while the robot runs."""
    monkeypatch.setenv("TZ", "America/New_York")
    time.tzset()
    monkeypatch.setenv("TZ", "Europe/Berlin")


@pytest.mark.usefixtures("moved_to_berlin")
def test_a_time_zone_that_is_set_while_the_robot_runs_counts_at_once(home: "Home", monkeypatch):
    put_scheduled(home, "08:30", "mon")
    set_clock(home, monkeypatch, "2026-11-02T07:29:30Z")
    set_clock(home, monkeypatch, "2026-11-02T07:30:05Z")
    assert (home.status.state, home.status.name) == ("driving", "morning")


def put_scheduled(home: "Home", at: str, *days: Day) -> None:
    schedule = [ScheduleEntry(days=list(days), at=at)]
    tour = Tour(name="morning", stops=[Stop(name="kitchen")], schedule=schedule)
    home.lockstep.ask(requests.TOURS_PUT, tour)


def set_clock(home: "Home", monkeypatch, utc: str | None) -> None:
    monkeypatch.setattr(type(home.tour), "utc_now", lambda _: utc)
    home.lockstep.run(2.0)


@pytest.mark.usefixtures("berlin")
def test_scheduled_tour_starts_once_in_its_minute_of_local_time(home: "Home", monkeypatch):
    put_scheduled(home, "08:30", "mon")
    set_clock(home, monkeypatch, "2026-11-02T07:29:30Z")  # a Monday, an hour behind Berlin
    assert home.status.state == "idle"
    set_clock(home, monkeypatch, "2026-11-02T07:30:05Z")
    assert (home.status.state, home.status.name) == ("driving", "morning")
    home.lockstep.run(40.0)
    assert home.status.state == "done"
    assert len(home.planner.ids) == 1


@pytest.mark.usefixtures("berlin")
def test_scheduled_tour_does_not_push_another_aside(home: "Home", monkeypatch):
    put_scheduled(home, "08:30")
    trip = home.start("corridor", "entrance").trip
    set_clock(home, monkeypatch, "2026-11-02T07:29:30Z")
    set_clock(home, monkeypatch, "2026-11-02T07:30:05Z")
    assert home.status.trip == trip
    assert home.lockstep.counters("tour")["schedule/skipped"] == 1


@pytest.mark.usefixtures("berlin")
def test_without_a_synchronised_clock_nothing_starts(home: "Home", monkeypatch):
    put_scheduled(home, "08:30")
    set_clock(home, monkeypatch, "2026-11-02T07:29:30Z")
    set_clock(home, monkeypatch, None)
    assert home.status.state == "idle"


def test_a_robot_that_does_not_know_the_time_says_that_no_tour_starts(
    home: "Home", monkeypatch: pytest.MonkeyPatch
):
    """As one without internet, on which tours waited for their times in vain."""
    health = home.lockstep.record(topics.HEALTH, "tour")
    home.lockstep.run(700.0)
    assert health[-1].state == "ok", "there is no tour that would start by itself"
    put_scheduled(home, "08:30")
    home.lockstep.run(2.0)
    assert health[-1].state == "degraded"
    assert "clock" in health[-1].message
    set_clock(home, monkeypatch, "2026-11-02T07:29:30Z")
    assert health[-1].state == "ok"
    set_clock(home, monkeypatch, None)
    assert health[-1].state == "ok", "it may be synchronised again soon"


def let_come_due(home: "Home", monkeypatch: pytest.MonkeyPatch, due: datetime = DUE) -> None:
    """Let half a minute before and the moment itself come."""
    for moment in (due - timedelta(seconds=30), due):
        set_clock(home, monkeypatch, moment.isoformat())


def health(home: "Home") -> tuple[str, str]:
    heard = home.lockstep.record(topics.HEALTH, "tour")
    home.lockstep.run(2.0)
    return heard[-1].state, heard[-1].message


def pause(home: "Home") -> None:
    home.lockstep.ask(requests.TOUR_PAUSE)


def stop_and_let_go(home: "Home") -> None:
    home.base.say(mode="stopped")
    home.lockstep.run(0.3)
    home.base.say()


def take_the_joystick_and_let_go(home: "Home") -> None:
    home.base.say(source="teleop")
    home.lockstep.run(0.3)
    home.base.say()


@pytest.mark.usefixtures("berlin")
@pytest.mark.parametrize("interrupt", [pause, stop_and_let_go, take_the_joystick_and_let_go])
@pytest.mark.parametrize("with_restart", [False, True])
def test_a_trip_that_has_been_paused_for_long_gives_way_to_a_tour_that_is_due(
    home: "Home",
    monkeypatch: pytest.MonkeyPatch,
    interrupt: "Callable[[Home], None]",
    with_restart: bool,
):
    put_scheduled(home, "08:30")
    set_clock(home, monkeypatch, (DUE - timedelta(minutes=20)).isoformat())
    trip = home.start("corridor", "entrance").trip
    interrupt(home)
    home.lockstep.run(1.0)
    assert home.status.state == "paused"
    if with_restart:
        home.restart_tour()
    let_come_due(home, monkeypatch)
    assert (home.status.state, home.status.trip) == ("paused", trip)
    assert health(home) == (
        "degraded",
        "The tour “morning”, due on 2026-11-02 at 08:30, was skipped: another tour was paused.",
    )
    let_come_due(home, monkeypatch, DUE + timedelta(days=1))
    assert (home.status.state, home.status.name) == ("driving", "morning")
    assert health(home) == ("ok", "")


@pytest.mark.usefixtures("berlin")
def test_a_trip_that_went_on_meanwhile_has_not_been_paused_for_long(
    home: "Home", monkeypatch: pytest.MonkeyPatch
):
    put_scheduled(home, "08:30")
    set_clock(home, monkeypatch, (DUE - timedelta(hours=1)).isoformat())
    trip = home.start("corridor", repeat=0).trip
    pause(home)
    home.lockstep.run(1.0)
    home.lockstep.ask(requests.TOUR_RESUME)
    set_clock(home, monkeypatch, (DUE - timedelta(minutes=2)).isoformat())
    pause(home)
    let_come_due(home, monkeypatch)
    assert (home.status.state, home.status.trip) == ("paused", trip)


@pytest.mark.usefixtures("berlin")
def test_what_was_skipped_is_told_until_somebody_starts_a_tour(
    home: "Home", monkeypatch: pytest.MonkeyPatch
):
    put_scheduled(home, "08:30")
    home.start("corridor", "entrance")
    let_come_due(home, monkeypatch)
    home.run_until("done")
    assert health(home) == (
        "degraded",
        "The tour “morning”, due on 2026-11-02 at 08:30, was skipped: another tour was under way.",
    )
    home.start("kitchen")
    assert health(home) == ("ok", "")


@pytest.mark.usefixtures("berlin")
def test_what_was_skipped_is_told_no_more_once_that_tour_is_deleted(
    home: "Home", monkeypatch: pytest.MonkeyPatch
):
    put_scheduled(home, "08:30")
    home.lockstep.ask(requests.TOURS_PUT, Tour(name="other", stops=[Stop(name="kitchen")]))
    drive_by_hand(home)
    let_come_due(home, monkeypatch)
    home.lockstep.ask(requests.TOURS_DELETE, Named(name="other"))
    assert health(home)[0] == "degraded"
    home.lockstep.ask(requests.TOURS_DELETE, Named(name="morning"))
    assert health(home) == ("ok", "")


def send_a_goal(home: "Home") -> None:
    home.lockstep.ask(requests.GOAL_SEND, SendGoal(id="persons", pose=Pose2D(1.0, 1.0, 0.0)))


def drive_by_hand(home: "Home") -> None:
    home.base.say(source="teleop")


def extend_the_map(home: "Home") -> None:
    home.mapper.phase = "mapping"


def get_lost_in_a_map_that_is_being_made(home: "Home") -> None:
    home.mapper.phase = "paused"
    home.localizer.estimate = replace(home.localizer.estimate, state="lost")


@pytest.mark.usefixtures("berlin")
@pytest.mark.parametrize(
    ("occupy", "code", "why"),
    [
        (send_a_goal, codes.BUSY, "the robot was driving to a goal"),
        (drive_by_hand, codes.TAKEN_OVER, "somebody was driving the robot"),
        (extend_the_map, codes.MAPPING, "a map was being made"),
        (get_lost_in_a_map_that_is_being_made, codes.MAPPING, "a map was being made"),
    ],
)
def test_a_tour_that_is_due_leaves_an_occupied_robot_alone(
    home: "Home",
    plan: "type[Plan]",
    monkeypatch: pytest.MonkeyPatch,
    occupy: "Callable[[Home], None]",
    code: str,
    why: str,
):
    put_scheduled(home, "08:30")
    home.planner.script = [plan(seconds=100.0)]
    occupy(home)
    home.lockstep.run(1.0)
    let_come_due(home, monkeypatch)
    assert home.status.state == "idle"
    assert health(home)[1].endswith(f", was skipped: {why}.")
    offer = home.lockstep.ask(requests.TOUR_OFFER, AskOffer(pose=Pose2D(1.0, 1.0, 0.0)))
    assert (offer.free, offer.reason) == (False, code)


@pytest.mark.usefixtures("berlin")
def test_a_tour_that_is_due_does_not_replace_the_trip_of_a_stopped_robot(
    home: "Home", monkeypatch: pytest.MonkeyPatch
):
    put_scheduled(home, "08:30")
    set_clock(home, monkeypatch, (DUE - timedelta(hours=1)).isoformat())
    trip = home.start("corridor", "entrance").trip
    home.base.say(mode="stopped")
    let_come_due(home, monkeypatch)
    assert (home.status.state, home.status.trip) == ("paused", trip)
    assert health(home)[1].endswith(", was skipped: the robot was stopped.")


@pytest.mark.usefixtures("berlin")
def test_a_mapper_that_is_gone_keeps_no_tour_from_starting(
    home: "Home", monkeypatch: pytest.MonkeyPatch
):
    put_scheduled(home, "08:30")
    extend_the_map(home)
    home.lockstep.run(2.0)
    home.lockstep.kill("mapper")
    home.lockstep.run(2.0)
    let_come_due(home, monkeypatch)
    assert (home.status.state, home.status.name) == ("driving", "morning")


@pytest.mark.usefixtures("berlin")
def test_a_goal_that_has_been_paused_for_long_gives_way_to_a_tour_that_is_due(
    home: "Home", plan: "type[Plan]", monkeypatch: pytest.MonkeyPatch
):
    put_scheduled(home, "08:30")
    home.planner.script = [plan(seconds=100.0)]
    send_a_goal(home)
    set_clock(home, monkeypatch, (DUE - timedelta(minutes=20)).isoformat())
    home.lockstep.ask(requests.GOAL_PAUSE, WhichGoal(id="persons"))
    home.lockstep.run(2.0)
    let_come_due(home, monkeypatch)
    assert health(home)[1].endswith(", was skipped: a goal was paused.")
    assert home.status.state == "idle"
    let_come_due(home, monkeypatch, DUE + timedelta(days=1))
    assert (home.status.state, home.status.name) == ("driving", "morning")


@pytest.mark.usefixtures("berlin")
def test_a_tour_of_another_map_is_not_started(home: "Home", monkeypatch: pytest.MonkeyPatch):
    schedule = [ScheduleEntry(at="08:30")]
    stops = [Stop(pose=Pose2D(1.0, 1.0, 0.0))]
    cellar = Tour(name="cellar round", stops=stops, schedule=schedule, map="cellar")
    home.lockstep.ask(requests.TOURS_PUT, cellar)
    with pytest.raises(Refused) as refused:
        home.lockstep.ask(requests.TOUR_START, StartTour(name="cellar round"))
    assert refused.value.code == codes.WRONG_MAP
    assert refused.value.message == (
        "The tour 'cellar round' is on the map cellar, the robot is on apartment."
    )
    with pytest.raises(
        Refused, match=r"^The tour is on the map cellar, the robot is on apartment\.$"
    ):
        home.start(*stops, map="cellar")
    let_come_due(home, monkeypatch)
    assert home.status.state == "idle"
    assert health(home)[1].endswith(", was skipped: the robot was not on its map cellar.")
