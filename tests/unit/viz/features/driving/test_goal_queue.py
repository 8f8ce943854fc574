"""Several places in a row, and taking back."""

import math

import pytest

from trolley.geometry import Pose2D
from trolley.messages import TourStatus
from trolley_viz.controls.undo import MAX_STEPS, History, Step
from trolley_viz.features.driving.goal_queue import MAX_STOPS, GoalQueue


def trip(trip_id: str, state: str, stamp_ns: int = 5) -> TourStatus:
    return TourStatus(stamp_ns=stamp_ns, name=None, trip=trip_id, state=state)  # type: ignore[arg-type]


def test_places_and_points_become_a_tour_without_a_name() -> None:
    goal_queue = GoalQueue()
    assert goal_queue.tour() is None
    goal_queue.add_place("kitchen", Pose2D(2.0, 1.0, 0.3))
    goal_queue.add_point(2.0, 4.0, None, None)
    goal_queue.add_point(3.0, 4.0, 1.0, None)
    tour = goal_queue.tour()
    assert tour is not None
    assert tour.name == ""
    kitchen, came, dragged = tour.stops
    assert kitchen.name == "kitchen"
    # Without a heading it looks the way that it comes: from the kitchen, along +y.
    assert came.pose is not None
    assert came.pose.yaw == pytest.approx(math.pi / 2)
    assert dragged.pose == Pose2D(3.0, 4.0, 1.0)
    assert {stop.on_failure for stop in tour.stops} == {"skip"}


def test_the_first_point_is_reached_from_where_the_robot_stands() -> None:
    goal_queue = GoalQueue()
    goal_queue.add_point(0.0, 2.0, None, Pose2D(2.0, 2.0, 0.0))
    assert abs(goal_queue.items[0].pose.yaw) == pytest.approx(math.pi)


def test_there_is_an_end_to_it() -> None:
    goal_queue = GoalQueue()
    added = [goal_queue.add_place("kitchen", Pose2D.identity()) for _ in range(MAX_STOPS + 1)]
    assert added == [True] * MAX_STOPS + [False]
    goal_queue.remove_last()
    assert len(goal_queue.items) == MAX_STOPS - 1


@pytest.mark.parametrize(
    ("later", "is_kept"),
    [
        (trip("t1", "driving"), True),
        (trip("t0", "done", stamp_ns=1), True),
        (trip("t1", "done"), False),
        (trip("t2", "driving"), False),
        (None, True),
    ],
)
def test_they_go_when_their_trip_is_over(later: TourStatus | None, is_kept: bool) -> None:
    goal_queue = GoalQueue()
    goal_queue.collect(is_on=True)
    goal_queue.add_place("kitchen", Pose2D.identity())
    goal_queue.set_off(trip("t1", "driving", stamp_ns=2))
    assert not goal_queue.is_collecting
    goal_queue.follow(later)
    assert bool(goal_queue.items) == is_kept
    goal_queue.collect(is_on=True)
    assert goal_queue.items == ()


def test_the_last_step_is_taken_back_first() -> None:
    history, undone = History(), list[str]()
    for name in "abc":
        history.add(Step("drive", name, lambda name=name: undone.append(name)))
    history.undo()
    history.undo()
    assert undone == ["c", "b"]
    step = history.last()
    assert step is not None
    assert step.title == "a"
    history.clear()
    history.undo()
    assert undone == ["c", "b"]


def test_the_last_step_of_a_kind_is_taken_back_where_it_was_done() -> None:
    history, undone = History(), list[str]()
    history.add(Step("place", "kitchen", lambda: undone.append("kitchen")))
    history.add(Step("zone", "mirror", lambda: undone.append("mirror")))
    assert history.last("drive") is None
    step = history.last("place")
    assert step is not None
    assert step.title == "kitchen"
    history.undo("place")
    history.undo("place")
    assert undone == ["kitchen"]
    history.undo()
    assert undone == ["kitchen", "mirror"]


def test_what_is_overtaken_is_not_taken_back() -> None:
    history, undone, holds = History(), list[str](), [True]
    history.add(Step("drive", "old", lambda: undone.append("old")))
    history.add(Step("drive", "new", lambda: undone.append("new"), lambda: holds[0]))
    holds[0] = False
    history.undo()
    assert undone == ["old"]


def test_only_so_many_steps_are_remembered() -> None:
    history, undone = History(), list[int]()
    for i in range(MAX_STEPS + 5):
        history.add(Step("drive", str(i), lambda i=i: undone.append(i)))
    while history.last() is not None:
        history.undo()
    assert len(undone) == MAX_STEPS
    assert undone[-1] == 5
