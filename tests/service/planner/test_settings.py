"""Settings that are changed while the robot drives."""

import itertools
from typing import Any

import pytest

from trolley import topics
from trolley.geometry import Pose2D
from trolley.messages import ChangedSetting, ConfigChanges

from .conftest import Stage

SLACK = 2e-3
"""What is asymptotically reached is never quite so."""


def change(stage: Stage, **values: Any) -> None:
    """What base publishes when these have been set."""
    changes = [ChangedSetting(section="planner", key=key, value=one) for key, one in values.items()]
    stage.lockstep.publish(topics.CONFIG, ConfigChanges(stamp_ns=0, changes=changes))


def fastest(stage: Stage, seconds: float) -> float:
    """The highest speed commanded meanwhile."""
    first = len(stage.commands)
    stage.lockstep.run(seconds)
    return max(command.twist.vx for command in stage.commands[first:])


def test_a_lower_speed_holds_at_once_and_a_higher_one_again(stage: Stage, far_side: Pose2D) -> None:
    stage.send(far_side, id="go-1")
    assert fastest(stage, 3.0) > 0.4
    change(stage, max_speed_mps=0.2)
    stage.lockstep.run(0.7)
    assert fastest(stage, 1.5) <= 0.2 + SLACK
    change(stage)
    assert fastest(stage, 3.0) > 0.4, "the file's value is back"
    status = stage.until("arrived")
    assert status.id == "go-1"
    assert stage.world.touches == 0


def test_a_speed_that_needs_a_longer_look_ahead_gets_it(stage: Stage, far_side: Pose2D) -> None:
    change(stage, max_speed_mps=0.1, horizon_s=1.0)
    stage.send(far_side)
    assert fastest(stage, 1.0) <= 0.1 + SLACK
    near = stage.planner.navigator.costmap_manager.require_context().half_m
    change(stage, max_speed_mps=0.5, horizon_s=5.0)
    stage.lockstep.run(0.3)
    far = stage.planner.navigator.costmap_manager.require_context().half_m
    assert far > near
    stage.until("arrived")


@pytest.mark.parametrize(
    "values",
    [
        {"clearance_m": 0.06, "caution_distance_m": 0.5},
        {"patience_s": 2.0, "give_up_s": 20.0, "progress_s": 4.0, "replan_s": 0.5},
        {"acceleration_mps2": 0.3, "angular_acceleration_radps2": 1.5, "control_rate_hz": 10.0},
        {"controller": "pursuit", "turn_to_find": True, "unsure_speed_mps": 0.05},
    ],
    ids=lambda values: next(iter(values)),
)
def test_a_goal_stays_the_goal_and_is_reached(
    stage: Stage, far_side: Pose2D, values: dict[str, Any]
) -> None:
    stage.send(far_side, id="go-1")
    stage.lockstep.run(2.0)
    first = len(stage.commands)
    change(stage, **values)
    stage.lockstep.run(1.0)
    assert all(command.twist.vx > 0.05 for command in stage.commands[first:]), "it does not stop"
    assert stage.until("arrived").id == "go-1"
    assert stage.world.touches == 0
    assert {(goal.id, goal.reason) for goal in stage.goals} == {(None, ""), ("go-1", "")}


@pytest.mark.parametrize("rate_hz", [5.0, 10.0, 20.0])
def test_a_command_is_valid_until_the_next_one_comes(
    stage: Stage, far_side: Pose2D, rate_hz: float
) -> None:
    change(stage, control_rate_hz=rate_hz)
    stage.send(far_side)
    stage.lockstep.run(1.0)
    first = len(stage.commands)
    stage.lockstep.run(2.0)
    for command, following in itertools.pairwise(stage.commands[first:]):
        assert following.stamp_ns - command.stamp_ns < command.valid_for * 1e9


def test_without_a_goal_nothing_moves(stage: Stage) -> None:
    change(stage, max_speed_mps=0.2, clearance_m=0.1)
    stage.lockstep.run(2.0)
    assert stage.commands == []


def test_unsure_it_drives_as_slowly_as_it_is_told(stage: Stage, far_side: Pose2D) -> None:
    stage.send(far_side)
    stage.robot.pose_state = "unsure"
    stage.lockstep.run(1.0)
    assert fastest(stage, 1.5) <= 0.15 + SLACK
    change(stage, unsure_speed_mps=0.08)
    stage.lockstep.run(0.7)
    assert fastest(stage, 1.5) <= 0.08 + SLACK


def test_what_another_trolley_means_is_counted_and_left_out(stage: Stage, far_side: Pose2D) -> None:
    changes = [
        ChangedSetting(section="planner", key="wings", value=2),
        ChangedSetting(section="planner", key="frame", value="odom"),
        ChangedSetting(section="planner", key="max_speed_mps", value=1e9),
        ChangedSetting(section="zap", key="zap", value="zap"),
        ChangedSetting(section="planner", key="max_turn_radps", value=0.9),
    ]
    stage.lockstep.publish(topics.CONFIG, ConfigChanges(stamp_ns=0, changes=changes))
    assert stage.lockstep.counters("planner")["config/not_understood"] == 4
    stage.send(far_side)
    stage.until("arrived")
    assert max(abs(command.twist.wz) for command in stage.commands) <= 0.9 + SLACK
