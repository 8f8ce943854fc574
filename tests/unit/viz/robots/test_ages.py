"""What should have been renewed by now shows how old it is."""

from typing import TYPE_CHECKING

import pytest
from support.pages import page_of

from trolley import topics
from trolley.geometry import Pose2D
from trolley.messages import GoalStatus, MapChanges, TourStatus
from trolley_viz.robots.ages import LastHeard, overdue_s

if TYPE_CHECKING:
    from ..conftest import Stage

S = 1_000_000_000


def goal(state: str) -> GoalStatus:
    return GoalStatus(stamp_ns=1, id="a", state=state, pose=Pose2D(2.0, 1.0, 0.0))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("message", "silent", "is_old"),
    [
        (goal("driving"), set[str](), True),
        (goal("arrived"), set[str](), False),
        (goal("arrived"), {"planner"}, True),
        (goal("arrived"), {"tour"}, False),
    ],
)
def test_what_is_repeated_or_has_nobody_left_who_would_renew_it_is_old_after_some_seconds(
    message: GoalStatus, silent: set[str], *, is_old: bool
) -> None:
    assert overdue_s(topics.GOAL, message, 0, 2 * S, silent) is None
    assert overdue_s(topics.GOAL, message, 0, 5 * S, silent) == (5.0 if is_old else None)


def test_changes_of_the_map_hold_as_long_as_somebody_watches_them() -> None:
    changes = MapChanges(stamp_ns=1, map="room", changes=[])
    assert overdue_s(topics.CHANGES, changes, 0, 900 * S) is None
    assert overdue_s(topics.CHANGES, changes, 0, 900 * S, {"localizer"}) == 900.0


def test_a_robot_that_was_never_heard_is_away_for_nobody_knows_how_long() -> None:
    heard = LastHeard()
    assert heard.update(None, 5 * S) is None
    assert heard.update(1, 6 * S) is None
    assert heard.update(None, 8 * S) == 2.0


def test_goal_and_trip_of_services_that_died_say_how_old_they_are(stage: "Stage") -> None:
    browser = stage.browse()
    stage.robot.alive = ["localizer", "planner", "tour"]
    trip = TourStatus(stamp_ns=1, name="round", trip="t1", state="dwelling", stop=0)
    stage.robot.publish(topics.GOAL, goal("failed"))
    stage.robot.publish(topics.TOUR, trip)
    stage.runtime.run(2.0)
    assert not any("ago" in line.headline for line in browser.state.lines)
    stage.robot.alive = ["localizer"]
    stage.runtime.run(8.0)
    said = [line.headline for line in browser.state.lines]
    assert "No planner" in said
    assert any(one.startswith("Did not reach kitchen · ") for one in said)
    assert any(one.startswith("“round”: at stop 1 · ") for one in said)
    assert " s ago" in page_of(stage).within("Tours").text()


def test_a_robot_that_is_away_says_for_how_long(stage: "Stage") -> None:
    browser = stage.browse()
    stage.runtime.run(1.0)
    stage.runtime.kill("base")
    stage.runtime.run(10.0)
    assert browser.state.sentence.headline.startswith("No contact with the robot for ")
    (line,) = browser.state.lines
    assert line.detail == browser.state.sentence.headline
