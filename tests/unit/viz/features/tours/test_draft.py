"""A tour as it is edited: order, checks, and what it becomes."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from trolley.geometry import Pose2D
from trolley.messages import ScheduleEntry, Stop, Tour
from trolley_viz.features.tours.draft import DAYS, Draft, Editing, Point, days_text, time_entry

PLACES = {"hall": Pose2D(1.0, 0.0, 0.0), "kitchen": Pose2D(2.0, 1.0, 0.5)}
HALL, KITCHEN = Point(name="hall"), Point(name="kitchen")
HERE = Point(pose=Pose2D(3.0, 1.0, 0.0))
TOUR = Tour(name="evening", stops=[Stop(name="hall"), Stop(name="kitchen", dwell=5.0)])

metres = st.integers(-5, 5).map(float)
poses = st.builds(Pose2D, metres, metres, metres)
placed = st.one_of(
    st.builds(lambda name: {"name": name}, st.sampled_from(sorted(PLACES))),
    st.builds(lambda pose: {"pose": pose}, poses),
)
stops = st.builds(
    lambda place, **rest: Stop(**place, **rest),
    placed,
    via=st.lists(poses, max_size=3),
    dwell=st.floats(0.0, 1e4),
    timeout=st.none() | st.floats(0.1, 1e4),
    retries=st.integers(0, 5),
    on_failure=st.sampled_from(["retry", "skip", "abort"]),
)
times = st.builds(
    ScheduleEntry,
    days=st.lists(st.sampled_from(DAYS), unique=True),
    at=st.builds(lambda h, m: f"{h:02}:{m:02}", st.integers(0, 23), st.integers(0, 59)),
)
tours = st.builds(
    Tour,
    name=st.sampled_from(["evening", "Küche", "a b"]),
    stops=st.lists(stops, min_size=1, max_size=6),
    repeat=st.integers(0, 5),
    there_and_back=st.booleans(),
    resume=st.booleans(),
    schedule=st.lists(times, max_size=3),
)
points = st.builds(lambda place, passes: Point(**place, passes=passes), placed, st.booleans())
edits = st.lists(
    st.one_of(
        st.tuples(st.just("choose"), st.integers(0, 9)),
        st.tuples(st.just("move"), st.integers(-12, 12)),
        st.tuples(st.just("add"), points),
        st.tuples(st.just("remove"), st.none()),
        st.tuples(st.just("change"), points),
    ),
    max_size=30,
)


@given(tours)
def test_a_tour_that_is_opened_and_saved_is_the_same(tour: Tour) -> None:
    draft = Draft.of(tour)
    assert draft.tour(PLACES.get) == tour
    assert draft.problems((), PLACES.get) == []


@given(tours, edits)
def test_no_edit_loses_or_doubles_a_point(tour: Tour, edits: list) -> None:
    editing = Editing.open(tour)
    known = list(editing.draft.points)
    for what, value in edits:
        if what == "choose":
            editing.chosen = min(value, len(known) - 1) if known else None
        elif what == "move":
            point = editing.point
            if known:
                editing.move(abs(value) % len(known), value)
            assert editing.point is point
        elif what == "add":
            editing.add(value)
            known.append(value)
            assert editing.point is value
        elif editing.chosen is None or editing.point is None:
            continue
        elif what == "remove":
            known.remove(editing.point)
            editing.remove()
            assert editing.chosen is None
        else:
            known[known.index(editing.point)] = value
            editing.change(value)
        assert sorted(map(repr, editing.draft.points)) == sorted(map(repr, known))
    if not editing.draft.problems((), PLACES.get):
        saved = editing.draft.tour(PLACES.get)
        num_points = sum(1 + len(stop.via) for stop in saved.stops)
        assert num_points == len(editing.draft.points)


@given(tours, st.integers(0, 30), st.integers(0, 30))
def test_moving_keeps_the_order_of_the_others(tour: Tour, index: int, by: int) -> None:
    draft = Draft.of(tour)
    index %= len(draft.points)
    moved = draft.moved(index, by)
    rest = draft.without_point(index).points
    now = min(index + by, len(rest))
    assert moved.points[now] is draft.points[index]
    assert moved.without_point(now).points == rest


def test_points_that_are_passed_belong_to_the_next_stop() -> None:
    passed = Point(name="hall", passes=True)
    draft = Draft("round", (HERE, passed, KITCHEN))
    first, second = draft.tour(PLACES.get).stops
    assert first.via == []
    assert second.via == [PLACES["hall"]]
    assert [draft.stop_number(i) for i in range(3)] == [1, None, 2]


@pytest.mark.parametrize(
    ("draft", "problem"),
    [
        (Draft("", (HALL,)), "Give the tour a name."),
        (Draft("a/b", (HALL,)), "Choose another name: a name may not contain '/'"),
        (Draft("morning", (HALL,)), "There is already a tour called “morning”."),
        (Draft("round"), "Add at least one place."),
        (Draft("round", (Point(name="hall", passes=True),)), "The robot would not stop anywhere"),
        (
            Draft("round", (HALL, Point(name="kitchen", passes=True))),
            "The robot would not stop at the last point",
        ),
        (Draft("round", (Point(name="attic"),)), "The place “attic” no longer exists."),
        (Draft("round", (HALL,) * 1001), "A tour has at most 1000 stops."),
    ],
)
def test_what_keeps_a_tour_from_being_saved_is_said(draft: Draft, problem: str) -> None:
    (said,) = draft.problems({"morning"}, PLACES.get)
    assert said.startswith(problem)


@pytest.mark.parametrize(
    ("text", "at"), [("08:30", "08:30"), (" 8:05 ", "08:05"), ("23.59", "23:59")]
)
def test_times_of_day_are_understood(text: str, at: str) -> None:
    assert time_entry(text, ["tue", "mon"]) == ScheduleEntry(days=["mon", "tue"], at=at)
    assert time_entry(text, DAYS) == time_entry(text, []) == ScheduleEntry(days=[], at=at)


@pytest.mark.parametrize("text", ["", "24:00", "8", "8:5", "08:60", "noon", "08:30 Uhr", "²:30"])
def test_what_is_no_time_of_day_is_none(text: str) -> None:
    assert time_entry(text, []) is None


def test_days_in_words() -> None:
    assert days_text([]) == days_text(DAYS) == "every day"
    assert days_text(["fri", "mon", "tue", "wed", "thu"]) == "Mon–Fri"
    assert days_text(["sat", "sun"]) == "Sat, Sun"
    assert days_text(["mon", "tue", "wed", "sat"]) == "Mon–Wed, Sat"


def test_what_somebody_else_saved_is_noticed_and_either_is_kept() -> None:
    theirs = Tour(name="evening", stops=[Stop(name="hall")])
    editing = Editing.open(TOUR)
    editing.hear([TOUR])
    assert not editing.was_changed
    editing.add(HERE)
    editing.hear([theirs])
    assert editing.was_changed
    editing.keep_mine()
    assert not editing.was_changed
    assert editing.draft.points[-1] == HERE
    editing.hear([])
    assert editing.was_changed
    editing.hear([TOUR])
    editing.take_theirs()
    assert (editing.draft, editing.chosen) == (Draft.of(TOUR), None)
    assert not editing.was_changed


def test_a_deleted_tour_that_is_kept_is_a_new_one() -> None:
    editing = Editing.open(TOUR)
    editing.hear([])
    editing.keep_mine()
    assert editing.opened is None
    assert not editing.was_changed


def test_a_name_is_taken_by_other_tours_only() -> None:
    other = Tour(name="morning", stops=[Stop(name="hall")])
    assert Editing.open(TOUR).taken([TOUR, other]) == {"morning"}
    assert Editing(None, Draft()).taken([TOUR, other]) == {"evening", "morning"}
