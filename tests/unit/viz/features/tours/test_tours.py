"""Tours in the viewer: progress, list, pins, past trips; and the tab in a pretend browser."""

import asyncio
import re
import threading
from typing import TYPE_CHECKING, Any
from zoneinfo import ZoneInfo

import msgspec
import numpy as np
import pytest
from support.pages import PageOf, page_of

from trolley import codes, requests, topics
from trolley.codes import Refused
from trolley.geometry import Pose2D
from trolley.messages import (
    PastTrip,
    Photo,
    ScheduleEntry,
    Stop,
    StopResult,
    Tour,
    Tours,
    TourStatus,
)
from trolley.messages.request_params import AskHistory, Named, Nothing, StartTour, WhichPhoto
from trolley.runtime.service import Service, answers
from trolley_viz.controls.controls import BadValue, NotThere
from trolley_viz.features.tours.draft import Draft, Point
from trolley_viz.features.tours.layer import (
    COMING,
    CURRENT,
    FAILED,
    REACHED,
    path_of,
    pins_of,
    trip_colours,
)
from trolley_viz.features.tours.past_trips import summary as trip_summary
from trolley_viz.features.tours.past_trips import title_of, tone_of, trips_html, when_text
from trolley_viz.features.tours.point_editor import (
    FOR_EVER,
    GIVE_UP,
    LEAVE_OUT,
    failure_changed,
    failure_of,
)
from trolley_viz.features.tours.points import MAX_POINT_ROWS, first_shown, point_text
from trolley_viz.features.tours.stored import summary
from trolley_viz.features.tours.tour_actions import copy_name
from trolley_viz.features.tours.trip import progress, visits_to_come
from trolley_viz.graphics.pictures import PIN_HEIGHT_PX, pin_picture
from trolley_viz.robots.past_trips import PastTrips, trouble_spots
from trolley_viz.server.messages import Said
from trolley_viz.server.photos import Photos
from trolley_viz.server.visitors import Visitor

if TYPE_CHECKING:
    from ...conftest import Stage

EVIL = "<img src=x onerror=alert(1)>"
STOPS = [Stop(name=name) for name in ("hall", "kitchen", "door")]
ROUND = Tour(name="round", stops=STOPS)
HALL = Stop(pose=Pose2D(1.0, 0.0, 0.0))
PLACES = {"hall": Pose2D(1.0, 0.0, 0.0), "kitchen": Pose2D(2.0, 1.0, 0.5)}


def result(stop: int, state: Any = "reached", code: str = "", **rest: Any) -> StopResult:
    return StopResult(stop=stop, name=STOPS[stop].name, state=state, code=code, seconds=4, **rest)


def trip(stop: int | None, state: Any = "driving", *results: StopResult, **rest: Any) -> TourStatus:
    return TourStatus(
        stamp_ns=1, name="round", trip="t", state=state, stop=stop, results=[*results], **rest
    )


# The trip under way.
def test_a_trip_shows_what_was_and_what_comes() -> None:
    page = progress(trip(1, "driving", result(0)), ROUND)
    places = [page.index(text) for text in ("hall reached", "kitchen now", "door to come")]
    assert places == sorted(places)
    assert "to come" not in progress(trip(1, "driving", result(0)), None)


def test_the_way_back_is_told_in_its_order() -> None:
    tour = msgspec.structs.replace(ROUND, there_and_back=True, repeat=2)
    there, back = result(0), [result(1), result(2)]
    assert visits_to_come(trip(1, "driving", there), tour) == [2, 1, 0]
    assert visits_to_come(trip(2, "dwelling", there, *back), tour) == [1, 0]
    assert visits_to_come(trip(1, "driving", there, *back), tour) == [0]
    assert visits_to_come(trip(1, "dwelling", there, *back, result(1)), tour) == [0]
    assert visits_to_come(trip(9), tour) == []


def test_only_this_round_is_shown() -> None:
    tour = msgspec.structs.replace(ROUND, repeat=3)
    first = [result(0), result(1, "skipped", codes.BLOCKED), result(2)]
    page = progress(trip(1, "driving", *first, result(0), lap=1), tour)
    assert "round 2 of 3" in page
    assert page.count("reached") == 1
    assert "skipped" not in page


def test_a_trip_paused_where_it_stays_is_not_next() -> None:
    page = progress(trip(1, "paused", result(0), result(1)), ROUND)
    assert page.count("reached") == 2
    assert "kitchen, paused" in page
    assert "kitchen next, paused" in progress(trip(1, "paused", result(0)), ROUND)


def test_names_on_a_trip_carry_no_markup() -> None:
    tour = Tour(name=EVIL, stops=[Stop(name=EVIL), Stop(name=EVIL)])
    evil = StopResult(stop=0, name=EVIL, state="failed", message=EVIL)
    status = TourStatus(
        stamp_ns=1, name=EVIL, trip="t", state="driving", stop=1, message=EVIL, results=[evil]
    )
    past = PastTrips(lambda limit, then: None)
    past.trips = (PastTrip(trip="t", name=EVIL, state="failed", message=EVIL, results=[evil]),)
    for page in (progress(status, tour), trips_html(past, past.trips)):
        assert "<img" not in page
        assert "&lt;img" in page


def test_a_past_trip_without_a_name_is_called_after_its_stops() -> None:
    reached = [
        StopResult(stop=i, name=name, state="reached")
        for i, name in enumerate(("corridor", None, "entrance"))
    ]
    assert title_of(PastTrip(trip="t", name=None, state="done", results=reached)) == (
        "corridor → a point → entrance"
    )
    assert title_of(PastTrip(trip="t", name="round", state="done", results=reached)) == "round"
    assert title_of(PastTrip(trip="t", name=None, state="done")) == "unnamed"


# The list and the editor.
def test_a_tour_in_a_line() -> None:
    tour = Tour(
        name="round",
        stops=[*STOPS, Stop(pose=Pose2D(1, 2, 3), dwell=30.0)],
        repeat=0,
        there_and_back=True,
        schedule=[ScheduleEntry(days=["sat", "sun"], at="08:30")],
    )
    assert summary(tour) == (
        "hall → kitchen → door → a point · there and back · repeats forever"
        " · stays 30 s in total · 08:30 Sat, Sun"
    )
    assert summary(Tour(stops=STOPS * 3)) == "hall → kitchen → door → hall → 5 more"


def test_copies_have_free_names() -> None:
    assert copy_name("round", {"round", "round 2"}) == "round 3"
    assert copy_name("x" * 64, {"x" * 64}) == "x" * 62 + " 2"


def test_what_failure_means_is_said_and_kept() -> None:
    ends = Point(name="hall", on_failure="retry", retries=3)
    assert [failure_of(ends), failure_of(Point(name="hall"))] == [GIVE_UP, GIVE_UP]
    assert failure_changed(ends, GIVE_UP) is ends
    endless = failure_changed(ends, FOR_EVER)
    assert (endless.on_failure, endless.retries) == ("retry", 0)
    assert failure_of(endless) == FOR_EVER
    assert failure_of(failure_changed(endless, LEAVE_OUT)) == LEAVE_OUT


def test_the_rows_of_a_long_tour_are_those_around_the_chosen_point() -> None:
    assert first_shown(5, None) == first_shown(MAX_POINT_ROWS, 0) == 0
    assert first_shown(100, None) == 100 - MAX_POINT_ROWS
    for chosen in range(100):
        assert 0 <= chosen - first_shown(100, chosen) < MAX_POINT_ROWS


def test_points_in_a_line() -> None:
    passed, stays = Point(pose=Pose2D(1, 2, 3), passes=True), Point(name="hall", dwell=5.0)
    draft = Draft(points=(passed, stays))
    assert point_text(draft, 0) == "passes a point on the map"
    assert point_text(draft, 1) == "1  hall · stays 5 s"


# On the map.
def test_stops_in_one_place_share_a_pin() -> None:
    points = (Point(name="hall"), Point(name="kitchen"), Point(name="hall"), Point(name="attic"))
    draft = Draft("round", (*points, Point(pose=Pose2D(5, 5, 0), passes=True)), repeat=2)
    pins = pins_of(draft, PLACES.get, lambda index, number: COMING)
    assert [(pin.text, pin.x) for pin in pins] == [("1,3", 1.0), ("2", 2.0), ("", 5.0)]
    assert path_of(draft, PLACES.get) == ((1.0, 0.0), (2.0, 1.0), (1.0, 0.0), (5, 5), (1.0, 0.0))


def test_a_long_tour_is_not_slow_to_draw() -> None:
    """It is looked at five times a second; every second pin lies where another one is."""
    draft = Draft("round", tuple(Point(pose=Pose2D(i // 2, 0.0, 0.0)) for i in range(1000)))
    asked: list[int] = []

    def colour(index: int, _number: int) -> tuple[int, int, int]:
        asked.append(index)
        return COMING

    pins = pins_of(draft, PLACES.get, colour)
    assert len(asked) <= len(draft.points)
    assert (len(pins), pins[-1].text) == (150, "299,300")


def test_what_was_reached_is_green_and_what_failed_is_red() -> None:
    status = trip(2, "driving", result(0), result(1, "skipped", codes.BLOCKED))
    assert trip_colours(status) == {0: REACHED, 1: FAILED, 2: CURRENT}
    assert trip_colours(trip(0, "dwelling", result(0))) == {0: REACHED}


def test_a_pin_is_as_wide_as_its_text() -> None:
    assert pin_picture("1", REACHED).shape == (PIN_HEIGHT_PX, PIN_HEIGHT_PX, 4)
    wide = pin_picture("1,12,13", REACHED)
    assert wide.shape[1] > 2 * PIN_HEIGHT_PX
    assert pin_picture("1," * 500, REACHED).shape[1] < 5 * PIN_HEIGHT_PX
    assert np.all(wide[0, 0] == 0)
    assert tuple(pin_picture("", FAILED)[PIN_HEIGHT_PX // 2, PIN_HEIGHT_PX // 2]) == (*FAILED, 255)


# Past trips.
def failed_at(x: float, code: str = codes.BLOCKED, **rest: Any) -> StopResult:
    return result(1, "failed", code, pose=Pose2D(x, 0.0, 0.0), **rest)


def past_trip(*results: StopResult, **rest: Any) -> PastTrip:
    given: dict[str, Any] = {"state": "failed", "map": "room", "name": "round", **rest}
    return PastTrip(trip="t", results=[*results], **given)


def test_failures_in_one_place_are_counted_and_the_newest_is_told() -> None:
    trips = [
        past_trip(failed_at(1.0), failed_at(1.3, codes.NO_PATH)),
        past_trip(failed_at(1.1), failed_at(5.0, started_at="2026-11-21T10:00:00Z")),
        past_trip(failed_at(5.0), map="garden"),
        past_trip(result(0), result(1, "skipped", codes.SKIPPED, pose=Pose2D(1, 0, 0))),
        past_trip(result(1, "failed", codes.LOST)),
        past_trip(failed_at(1.0, codes.IN_OBSTACLE, goal=Pose2D(8.0, 0.0, 0.0))),
    ]
    near, far, refused = trouble_spots(trips, "room")
    assert refused.pose.x == 8.0
    assert (near.count, near.newest.code) == (3, codes.NO_PATH)
    assert (far.count, far.when) == (1, "2026-11-21T10:00:00Z")


def test_a_past_trip_in_a_line() -> None:
    trip = past_trip(planned=3, reached=1, missed=1, seconds=75.0, message="It was stuck.")
    assert trip_summary(trip) == "1 of 3 stops · 75 s · It was stuck."
    assert [tone_of(past_trip(state=state)) for state in ("done", "failed", "stopped")] == [
        "good",
        "bad",
        "idle",
    ]
    assert tone_of(past_trip(state="done", missed=1)) == "warn"


def test_unknown_times_are_told_as_unknown() -> None:
    assert when_text(None) == when_text("noon") == ""
    assert "21 Nov" in when_text("2026-11-21T12:00:00Z")


def test_past_trips_are_told_in_the_time_zone_of_the_page() -> None:
    past = PastTrips(lambda limit, then: None)
    past.trips = (past_trip(started_at="2026-07-21T23:30:00+00:00"),)
    assert "22 Jul 05:00" in trips_html(past, past.trips, time_zone=ZoneInfo("Asia/Kolkata"))


@pytest.mark.parametrize("name", ["", "Middle/Earth", "../../etc/passwd", "Europe", "\ud800"])
def test_a_time_zone_that_nobody_knows_is_that_of_the_viewer(stage: "Stage", name: str) -> None:
    browser = stage.browse()
    stage.say(browser, Said(time_zone="Asia/Kolkata"))
    assert stage.session.preferences.time_zone == ZoneInfo("Asia/Kolkata")
    stage.say(browser, Said(time_zone=name))
    assert stage.session.preferences.time_zone is None


def test_past_trips_are_asked_for_once_for_each_trip() -> None:
    asked: list[Any] = []
    past = PastTrips(lambda limit, then: asked.append(then))
    for _ in range(3):
        past.refresh(None, 0)
    assert len(asked) == 1
    asked[0]([past_trip()])
    past.refresh(None, 10**12)
    assert len(asked) == 1
    past.refresh(trip(0), 10**12)
    past.refresh(trip(None, "done"), 10**12)  # while it is still being asked
    asked[1]([])
    past.refresh(trip(None, "done"), 10**12)
    assert len(asked) == 3


def test_a_refused_history_is_asked_for_again_later() -> None:
    asked: list[Any] = []
    past = PastTrips(lambda limit, then: asked.append(then))
    past.refresh(None, 0)
    asked[0](Refused(codes.NOT_READY))
    past.refresh(None, 10**9)
    assert (len(asked), past.trips) == (1, None)
    past.refresh(None, 11 * 10**9)
    asked[1]([])
    assert (past.trips, past.problem) == ((), "")


# The tab.
class PretendTour(Service):
    """Keeps tours as the real one does, and remembers what it was asked."""

    name = "tour"

    def __init__(self) -> None:
        self.tours: dict[str, Tour] = {}
        self.started: list[str | None] = []
        self.asked_history = 0
        self.is_full = False
        self.keeps_all = False

    def start(self) -> None:
        self.say()

    def say(self) -> None:
        self.publish(topics.TOURS, Tours(stamp_ns=0, tours=[*self.tours.values()]))

    @answers(requests.TOURS_PUT)
    def put(self, tour: Tour) -> Tour:
        if self.is_full:
            raise Refused(codes.NOT_SAVED)
        self.tours[tour.name] = tour
        self.say()
        return tour

    @answers(requests.TOURS_DELETE)
    def delete(self, params: Named) -> Tour:
        if self.keeps_all:
            raise Refused(codes.NOT_SAVED)
        tour = self.tours.pop(params.name)
        self.say()
        return tour

    @answers(requests.TOUR_START)
    def begin(self, params: StartTour) -> TourStatus:
        self.started.append(params.name)
        status = TourStatus(stamp_ns=0, name=params.name, trip="t1", state="driving", stop=0)
        self.publish(topics.TOUR, status)
        return status

    @answers(requests.TOUR_STOP)
    def end(self, params: Nothing) -> TourStatus:
        status = TourStatus(stamp_ns=0, name="evening", trip="t1", state="stopped")
        self.publish(topics.TOUR, status)
        return status

    @answers(requests.TOUR_HISTORY)
    def history(self, params: AskHistory) -> list[PastTrip]:
        self.asked_history += 1
        return [past_trip(failed_at(1.0))]


@pytest.fixture
def tour(stage: "Stage") -> PretendTour:
    tour = stage.runtime.add(PretendTour())
    stage.browse()
    return tour


@pytest.fixture
def page(stage: "Stage", tour: PretendTour) -> PageOf:
    settle(stage)
    return page_of(stage).within("Tours")


def settle(stage: "Stage", seconds: float = 0.6) -> None:
    """Let everything be said and drawn."""
    stage.runtime.run(seconds)


def points(page: PageOf) -> list[str]:
    """The rows of the points."""
    return [label for label in page.labels if label[0].isdigit()]


def undo(page: PageOf) -> str:
    """Take the last step back; returns what stood on the button."""
    (label,) = [one for one in page.labels if one.startswith("Undo: ")]
    page.press(label)
    return label


def make_tour(stage: "Stage", page: PageOf) -> None:
    """Open the editor, add the kitchen and where the robot stands, name it and save it."""
    page.press("New tour")
    settle(stage)
    page.choose("Add place", "kitchen")
    settle(stage)
    page.press("Where it is")
    settle(stage)
    page.type("Name", "evening")
    settle(stage)
    page.press("Save")
    settle(stage)


def edit_tour(stage: "Stage", page: PageOf) -> None:
    page.within("evening").press("Edit")
    settle(stage)


def rename_tour(stage: "Stage", page: PageOf) -> None:
    edit_tour(stage, page)
    page.type("Name", "night")
    settle(stage)
    page.press("Save")
    settle(stage)


def test_a_tour_is_made_saved_and_started(stage: "Stage", tour: PretendTour, page: PageOf) -> None:
    make_tour(stage, page)
    assert not page.is_shown("Save")
    kitchen, here = tour.tours["evening"].stops
    assert (kitchen.name, here.pose) == ("kitchen", Pose2D(1.5, 0.0, 0.0))
    assert "evening kitchen → a point" in page.text()
    page.within("evening").press("Start")
    settle(stage)
    assert tour.started == ["evening"]


def test_a_tour_of_another_map_is_neither_started_nor_edited(
    stage: "Stage", tour: PretendTour, page: PageOf
) -> None:
    make_tour(stage, page)
    tour.put(msgspec.structs.replace(tour.tours["evening"], map="cellar"))
    settle(stage)
    assert "on the map “cellar”" in page.text()
    for action in ("Start", "Edit"):
        with pytest.raises(NotThere):
            page.within("evening").press(action)
    page.within("evening").press("Copy")
    settle(stage)
    assert tour.tours["evening 2"].map == "cellar"


def test_an_edited_tour_stays_on_its_map() -> None:
    stored = Tour(name="round", stops=[HALL], map="cellar")
    assert Draft.of(stored).tour(PLACES.get) == stored


def test_what_is_missing_is_said_and_cannot_be_saved(
    stage: "Stage", tour: PretendTour, page: PageOf
) -> None:
    page.press("New tour")
    settle(stage)
    assert page.value("Name") == "Tour 1"
    page.type("Name", "")
    settle(stage)
    assert "Give the tour a name." in page.text()
    assert "Add at least one place." in page.text()
    with pytest.raises(NotThere):
        page.press("Save")
    page.type("At", "25:00")
    settle(stage)
    assert "has not been added yet" in page.text()
    page.press("Add this time")
    settle(stage)
    assert "is not a time of day" in page.text()
    assert tour.tours == {}


def test_points_are_arranged_and_changed(stage: "Stage", tour: PretendTour, page: PageOf) -> None:
    make_tour(stage, page)
    edit_tour(stage, page)
    page.press("2  a point on the map")
    settle(stage)
    page.type("Stay (s)", 7.0)
    page.press("Earlier")
    settle(stage)
    page.type("Longest drive (s)", -1.0)
    page.type("At", "8:30")
    settle(stage)
    page.press("Add this time")
    page.tick("Repeat forever")
    settle(stage)
    page.press("Save")
    settle(stage)
    saved = tour.tours["evening"]
    assert [stop.name for stop in saved.stops] == [None, "kitchen"]
    assert (saved.stops[0].dwell, saved.stops[0].timeout, saved.repeat) == (7.0, None, 0)
    assert saved.schedule == [ScheduleEntry(at="08:30")]


def test_a_point_is_dragged_to_another_place(
    stage: "Stage", tour: PretendTour, page: PageOf
) -> None:
    make_tour(stage, page)
    edit_tour(stage, page)
    page.drag("2  a point on the map", -1)
    settle(stage)
    with pytest.raises(BadValue):
        page.drag("1  a point on the map", 0.5)
    with pytest.raises(BadValue):
        page.drag("Save", 1)
    page.press("Save")
    settle(stage)
    assert [stop.name for stop in tour.tours["evening"].stops] == [None, "kitchen"]


def test_a_late_change_of_one_point_does_not_reach_another(stage: "Stage", page: PageOf) -> None:
    make_tour(stage, page)
    edit_tour(stage, page)
    page.press("1  kitchen")
    settle(stage)
    page.press("2  a point on the map")
    page.type("Stay (s)", 7.0)  # and before the page shows the other point
    settle(stage)
    assert points(page)[0] == "1  kitchen"
    assert not any("stays" in label for label in page.labels)


def test_a_renamed_tour_keeps_one_name_and_undo_brings_the_other_back(
    stage: "Stage", tour: PretendTour, page: PageOf
) -> None:
    make_tour(stage, page)
    before = tour.tours["evening"]
    rename_tour(stage, page)
    assert set(tour.tours) == {"night"}
    undo(page)
    settle(stage)
    assert tour.tours == {"evening": before}


def test_a_deleted_tour_is_brought_back(stage: "Stage", tour: PretendTour, page: PageOf) -> None:
    make_tour(stage, page)
    before = dict(tour.tours)
    page.within("evening").press("Delete")
    settle(stage)
    assert tour.tours == {}
    assert undo(page) == "Undo: Delete the tour evening"
    settle(stage)
    assert tour.tours == before


@pytest.mark.parametrize("name", ["evening", "night"])
def test_undo_leaves_a_tour_that_somebody_else_changed_since(
    stage: "Stage", tour: PretendTour, page: PageOf, name: str
) -> None:
    make_tour(stage, page)
    rename_tour(stage, page)
    tour.put(Tour(name=name, stops=[Stop(pose=Pose2D(1.0, 1.0, 0.0))]))
    settle(stage)
    before = dict(tour.tours)
    undo(page)
    settle(stage)
    assert tour.tours == before
    told = f"Somebody else has changed “{name}” since then."
    assert stage.browsers[0].notices[-1] == ("Not undone", told)


def test_an_undo_that_is_refused_is_offered_again(
    stage: "Stage", tour: PretendTour, page: PageOf
) -> None:
    make_tour(stage, page)
    before = dict(tour.tours)
    page.within("evening").press("Delete")
    settle(stage)
    tour.is_full = True
    undo(page)
    settle(stage)
    assert tour.tours == {}
    tour.is_full = False
    undo(page)
    settle(stage)
    assert tour.tours == before


def test_an_undo_that_was_half_done_is_not_offered_again(
    stage: "Stage", tour: PretendTour, page: PageOf
) -> None:
    make_tour(stage, page)
    rename_tour(stage, page)
    tour.keeps_all = True
    assert undo(page) == "Undo: Save the tour night"
    settle(stage)
    assert set(tour.tours) == {"evening", "night"}
    assert stage.browsers[0].notices[-1][0] == "The old name was not deleted"
    last = stage.session.actions.history.last()
    assert last is not None
    assert last.title == "Save the tour evening"


def test_undo_neither_deletes_nor_overwrites_a_tour_that_somebody_else_worked_on(
    stage: "Stage", tour: PretendTour, page: PageOf
) -> None:
    make_tour(stage, page)
    mine = tour.tours["evening"]
    theirs = Tour(name="evening", stops=[Stop(pose=Pose2D(1.0, 1.0, 0.0))])
    tour.put(theirs)
    settle(stage)
    undo(page)
    settle(stage)
    assert tour.tours == {"evening": theirs}
    page.within("evening").press("Delete")
    settle(stage)
    tour.put(mine)
    settle(stage)
    undo(page)
    settle(stage)
    assert tour.tours == {"evening": mine}


def test_who_saved_meanwhile_is_not_overwritten_unasked(
    stage: "Stage", tour: PretendTour, page: PageOf
) -> None:
    make_tour(stage, page)
    edit_tour(stage, page)
    theirs = Tour(name="evening", stops=[Stop(name="kitchen")])
    tour.put(theirs)
    settle(stage)
    assert "Somebody else has changed this tour." in page.text()
    with pytest.raises(NotThere):
        page.press("Save")
    assert len(points(page)) == 2
    page.press("Take theirs")
    settle(stage)
    assert points(page) == ["1  kitchen"]
    tour.delete(Named(name="evening"))
    settle(stage)
    assert "Somebody else has deleted this tour." in page.text()
    page.press("Keep mine")
    settle(stage)
    page.press("Save")
    settle(stage)
    assert tour.tours == {"evening": theirs}


def test_changes_are_thrown_away_at_the_second_press_only(stage: "Stage", page: PageOf) -> None:
    page.press("New tour")
    settle(stage)
    page.type("Name", "evening")
    page.press("Cancel")
    settle(stage)
    page.press("Discard changes? Press again")
    settle(stage)
    assert not page.is_shown("Name")


def test_a_tour_being_edited_stays_with_its_robot(stage: "Stage", page: PageOf) -> None:
    page.press("New tour")
    settle(stage)
    page.type("Name", "evening")
    stage.session.follow("kart")
    settle(stage)
    assert not page.is_shown("Name")
    stage.session.follow("trolley")
    settle(stage)
    assert page.value("Name") == "evening"


def test_a_place_on_another_map_is_told_and_an_unknown_one_refused(
    stage: "Stage", tour: PretendTour, page: PageOf
) -> None:
    tour.put(Tour(name="evening", stops=[Stop(name="attic"), Stop(name="cellar")]))
    settle(stage)
    edit_tour(stage, page)
    assert "The place “cellar” no longer exists." in page.text()
    assert "“attic” is on another map." in page.text()


def test_only_stops_with_a_photo_show_one() -> None:
    past = PastTrips(lambda *_: None)
    trip = past_trip(result(0), failed_at(1.0), result(2), photos=["t-0", "", "t-2"])
    past.trips = (trip, past_trip(result(0)))
    shown = trips_html(past, past.trips, robot="kiwi")
    assert re.findall(r'src="([^"]*)"', shown) == ["photo/kiwi/t-0", "photo/kiwi/t-2"]


class PhotoDesk(Service):
    """Gives one photo, as the tour service does."""

    name = "tour"

    @answers(requests.TOUR_PHOTO)
    def give(self, params: WhichPhoto) -> Photo:
        if params.name != "t1-0":
            raise Refused(codes.UNKNOWN_NAME, "There is none.")
        return Photo(name=params.name, jpeg=b"\xff\xd8\xff")


def test_a_photo_is_fetched_from_the_robot(stage: "Stage") -> None:
    stage.runtime.add(PhotoDesk())
    found: list[bytes | None] = []
    own = "trolley"

    async def fetch() -> None:
        for robot, name in ((own, "t1-0"), (own, "t1-9"), (own, "../x"), ("A B", "t1-0")):
            found.append(await Photos(stage.viz).fetch(robot, name))

    web = threading.Thread(target=lambda: asyncio.run(fetch()), daemon=True)
    web.start()
    while web.is_alive():
        settle(stage)
    assert found == [b"\xff\xd8\xff", None, None, None]


def test_past_trips_are_not_polled(stage: "Stage", tour: PretendTour, page: PageOf) -> None:
    settle(stage, 2.0)
    assert tour.asked_history == 0
    page.press("Past trips")
    settle(stage, 3.0)
    assert tour.asked_history == 1
    assert "round" in page.text()
    tour.begin(StartTour(name="evening"))
    settle(stage, 2.0)
    tour.end(Nothing())
    settle(stage, 2.0)
    assert tour.asked_history == 3
    page.press("Close past trips")
    settle(stage)
    assert "round" not in page.text()


def test_where_trips_failed_is_drawn_when_it_is_wanted(stage: "Stage", tour: PretendTour) -> None:
    settle(stage, 2.0)
    assert stage.layer("trouble")._nodes == []
    stage.session.preferences.switch_layer("trouble", is_on=True)
    settle(stage, 3.0)
    assert len(stage.layer("trouble")._nodes) == 2
    assert tour.asked_history == 1


def test_a_trip_is_drawn_while_it_is_under_way_and_a_while_longer(
    stage: "Stage", tour: PretendTour
) -> None:
    drawing = stage.layer("trip")._drawing
    status = TourStatus(
        stamp_ns=0, name=None, trip="t1", state="driving", stop=0, tour=Tour(stops=[HALL, HALL])
    )
    tour.publish(topics.TOUR, status)
    settle(stage)
    assert len(drawing._nodes) == 2  # a pin for both stops, and the way
    tour.publish(topics.TOUR, msgspec.structs.replace(status, state="done", stop=None))
    settle(stage, 30.0)
    assert drawing._nodes
    settle(stage, 40.0)
    assert drawing._nodes == []


def test_who_only_looks_sees_tours_and_changes_none(stage: "Stage") -> None:
    tour = stage.runtime.add(PretendTour())
    stage.browse(0, Visitor("guest", "viewer"))
    tour.put(ROUND)
    tour.begin(StartTour(name="round"))
    settle(stage)
    page = page_of(stage).within("Tours")
    assert page.labels == ["Past trips"]
    page.press("Past trips")
    settle(stage, 2.0)
    assert "kitchen not reached" in page.text()


def test_more_tours_than_cards_are_searched(
    stage: "Stage", tour: PretendTour, page: PageOf
) -> None:
    for i in range(60):
        tour.tours[f"tour {i:02}"] = Tour(name=f"tour {i:02}", stops=STOPS)
    tour.say()
    settle(stage)
    assert page.html().count('<b translate="no">tour ') == 40
    assert "20 more" in page.text()
    page.type("Search", "57")
    settle(stage)
    assert page.html().count('<b translate="no">tour ') == 1
    page.within("tour 57").press("Delete")
    settle(stage)
    assert "tour 57" not in tour.tours
