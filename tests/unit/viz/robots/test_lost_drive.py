"""A drive that a restart of the planner has lost."""

from typing import TYPE_CHECKING

import pytest

from trolley import topics
from trolley.geometry import Pose2D
from trolley.messages import GoalStatus
from trolley_viz.robots.lost_drive import LastDrive

if TYPE_CHECKING:
    from ..conftest import Stage

IDLE = GoalStatus(stamp_ns=2, id=None, state="idle")


def goal(state: str, goal_id: str = "a") -> GoalStatus:
    pose = Pose2D(2.0, 1.0, 0.0)
    return GoalStatus(stamp_ns=1, id=goal_id, state=state, pose=pose)  # type: ignore[arg-type]


@pytest.mark.parametrize("state", ["planning", "driving", "recovering", "paused"])
def test_a_goal_that_an_idle_planner_knows_nothing_of_was_lost(state: str) -> None:
    drive = LastDrive()
    assert drive.update(goal(state)) is None
    assert drive.update(None) is None
    assert drive.update(IDLE) == goal(state)
    assert drive.update(IDLE) == goal(state)


@pytest.mark.parametrize(
    "last",
    [
        goal("arrived"),
        goal("failed"),
        goal("canceled"),
        goal("driving", "tour-t1-0-0"),
        goal("driving", "map-m1-0"),
    ],
)
def test_a_goal_that_has_ended_or_is_sent_again_is_not_lost(last: GoalStatus) -> None:
    drive = LastDrive()
    drive.update(goal("driving", "before"))
    drive.update(last)
    assert drive.update(IDLE) is None


def test_a_planner_that_was_idle_all_along_has_lost_nothing() -> None:
    assert LastDrive().update(IDLE) is None


def test_the_page_says_that_the_drive_was_lost_until_the_next_one(stage: "Stage") -> None:
    browser = stage.browse()
    stage.robot.publish(topics.GOAL, goal("driving"))
    stage.runtime.run(1.0)
    stage.robot.publish(topics.GOAL, IDLE)
    stage.runtime.run(1.0)
    lost = "The planner was restarted; the drive to kitchen was lost."
    assert browser.state.sentence.headline == lost
    stage.robot.publish(topics.GOAL, goal("arrived", "b"))
    stage.runtime.run(1.0)
    assert browser.state.sentence.headline != lost
