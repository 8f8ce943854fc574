"""The history of trips."""

import contextlib
import sqlite3
from typing import TYPE_CHECKING

import msgspec
import pytest

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.geometry import Pose2D
from trolley.messages import PastTrip, Stop, Tour
from trolley.messages.request_params import AskHistory
from trolley_tour.trips import history_file

if TYPE_CHECKING:
    from .conftest import Home, Plan


def test_history_tells_results_and_survives_a_restart(home: "Home", plan: "type[Plan]"):
    home.planner.script = [plan(), plan(state="failed", reason=codes.BLOCKED, message="Blocked.")]
    home.start("corridor", "kitchen")
    home.run_until("failed")
    home.restart_tour()
    (past,) = home.lockstep.ask(requests.TOUR_HISTORY)
    assert (past.state, past.reason) == ("failed", codes.ABORTED)
    assert [(one.state, one.code) for one in past.results] == [
        ("reached", ""),
        ("failed", codes.BLOCKED),
    ]
    assert 8.0 < past.seconds < 12.0


def test_history_gives_the_newest_first(home: "Home"):
    trips = [home.start("kitchen").trip for _ in range(4)]
    home.lockstep.ask(requests.TOUR_STOP)
    past = home.lockstep.ask(requests.TOUR_HISTORY, AskHistory(limit=2))
    assert [one.trip for one in past] == trips[:-3:-1]


def test_history_refuses_a_time_that_is_none(home: "Home"):
    with pytest.raises(Refused) as caught:
        home.lockstep.ask(requests.TOUR_HISTORY, AskHistory(since="yesterday"))
    assert caught.value.code == codes.BAD_REQUEST


def test_broken_history_is_kept_aside_and_reported(home: "Home"):
    folder = home.lockstep.state / "trolley"
    (folder / "history.sqlite").write_bytes(b"this is no database, but a rather long text" * 100)
    health = home.lockstep.record(topics.HEALTH, "tour")
    assert home.lockstep.ask(requests.TOUR_HISTORY) == []
    home.lockstep.run(1.5)
    assert health[-1].message == "history.sqlite could not be read and was set aside."
    home.start("kitchen")
    home.run_until("done")
    assert len(home.lockstep.ask(requests.TOUR_HISTORY)) == 1
    assert len(list(folder.glob("history.sqlite.broken-*"))) == 1


def test_history_that_breaks_under_way_loses_no_new_trip(home: "Home"):
    home.start("kitchen")
    home.run_until("done")
    file = home.lockstep.state / "trolley" / "history.sqlite"
    content = bytearray(file.read_bytes())
    content[100:4000] = bytes(3900)
    file.write_bytes(content)
    home.start("corridor")
    home.run_until("done")
    (past,) = home.lockstep.ask(requests.TOUR_HISTORY)
    assert past.results[0].name == "corridor"
    assert len(list(file.parent.glob("history.sqlite.broken-*"))) == 1


def test_what_a_full_disk_refused_is_filed_when_there_is_room(
    home: "Home", monkeypatch: pytest.MonkeyPatch
):
    def fail(_path: object) -> None:
        raise sqlite3.OperationalError("database or disk is full")

    health = home.lockstep.record(topics.HEALTH, "tour")
    with monkeypatch.context() as full:
        full.setattr(history_file, "_opened", fail)
        trips = [home.start("kitchen").trip]
        home.run_until("done")
        trips.append(home.start("corridor").trip)
        home.run_until("done")
        home.lockstep.run(1.5)
        assert "could not be saved" in health[-1].message
    home.lockstep.run(15.0)
    past = home.lockstep.ask(requests.TOUR_HISTORY)
    assert [one.trip for one in past] == trips[::-1]
    assert health[-1].message == ""
    assert home.lockstep.counters("tour")["history/not_saved"] >= 2


def test_a_trip_that_cannot_be_read_hides_no_other(home: "Home"):
    for _ in range(2):
        home.start("kitchen")
        home.run_until("done")
        home.lockstep.run(1.0)
    file = home.lockstep.state / "trolley" / "history.sqlite"
    with contextlib.closing(sqlite3.connect(file)) as connection, connection:
        connection.execute("UPDATE trips SET document = '{' WHERE number = 1")
    (past,) = home.lockstep.ask(requests.TOUR_HISTORY)
    assert past.state == "done"
    assert home.lockstep.counters("tour")["history/unreadable"] == 1


def test_history_is_bounded_in_number_and_size(tmp_path, monkeypatch):
    def numbers() -> list[str]:
        return [one.trip for one in history_file.read_trips(tmp_path, None, 100, 1 << 20).trips]

    def keep(number: int, text: str = "") -> None:
        past = PastTrip(trip=str(number), name=None, state="done", message=text)
        assert history_file.keep_trip(tmp_path, past, 365.0) == history_file.Outcome()

    monkeypatch.setattr(history_file, "MAX_TRIPS", 3)
    for number in range(5):
        keep(number)
    assert numbers() == ["4", "3", "2"]
    monkeypatch.setattr(history_file, "MAX_BYTES", 1000)
    keep(5, "x" * 600)
    assert numbers() == ["5", "4"]
    keep(6, "x" * 2000)
    assert numbers() == ["6"]


def test_history_tells_where_a_stop_failed_and_how_many_were_planned(home: "Home", plan):
    home.planner.script = [plan(), plan(state="failed", reason=codes.NO_PATH)]
    home.start("corridor", "kitchen", "entrance", repeat=2)
    home.run_until("failed")
    (past,) = home.lockstep.ask(requests.TOUR_HISTORY)
    assert (past.map, past.planned, past.reached, past.missed) == ("apartment", 6, 1, 1)
    assert [one.pose for one in past.results] == [Pose2D(1.0, 2.0, 0.5)] * 2
    places = [home.tour.places.find(name) for name in ("corridor", "kitchen")]
    assert [one.goal for one in past.results] == places
    home.start("corridor", there_and_back=True, repeat=0)
    home.lockstep.ask(requests.TOUR_STOP)
    endless, _ = home.lockstep.ask(requests.TOUR_HISTORY)
    assert (endless.planned, endless.results) == (0, [])


def test_more_rounds_than_can_be_counted_in_a_file_leave_the_history_readable(home: "Home"):
    stops = [Stop(name="kitchen"), Stop(name="corridor")]
    home.lockstep.ask(requests.TOURS_PUT, Tour(name="round", stops=stops, repeat=2))
    file = home.lockstep.state / "trolley" / "tours.toml"
    file.write_text(file.read_text().replace("repeat = 2", f"repeat = {2**63 - 1}"))
    home.restart_tour()
    home.lockstep.ask(requests.TOUR_START, requests.TOUR_START.params(name="round"))
    home.lockstep.ask(requests.TOUR_STOP)
    (past,) = home.lockstep.ask(requests.TOUR_HISTORY)
    assert (past.name, past.planned) == ("round", 2_000_000)


def test_no_place_is_told_that_is_on_another_map(home: "Home", plan):
    home.planner.script = [plan(), plan(state="failed", reason=codes.NO_PATH)]
    home.start("corridor", "kitchen")
    home.lockstep.run(1.0)
    home.localizer.estimate = msgspec.structs.replace(home.localizer.estimate, map="garden")
    home.run_until("failed")
    (past,) = home.lockstep.ask(requests.TOUR_HISTORY)
    assert past.map == "apartment"
    assert [one.pose for one in past.results] == [None, None]


def test_times_are_told_where_the_clock_is_synchronised(home: "Home", monkeypatch):
    monkeypatch.setattr(type(home.tour), "utc_now", lambda _: "2026-11-02T07:29:50Z")
    home.start("kitchen")
    home.run_until("done")
    (past,) = home.lockstep.ask(requests.TOUR_HISTORY, AskHistory(since="2026-11-02T00:00:00"))
    assert past.started_at == past.ended_at == "2026-11-02T07:29:50Z"
    assert past.results[0].started_at == "2026-11-02T07:29:50Z"
    later = AskHistory(since="2026-11-02T08:00:00+00:00")
    assert home.lockstep.ask(requests.TOUR_HISTORY, later) == []
