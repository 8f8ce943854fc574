"""Costs that a program publishes shape the path, for as long as it does."""

from typing import Any

import numpy as np
import pytest
from msgspec import structs
from support.examples import load_example

from trolley import topics
from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley.gridmap.wire import map_message
from trolley.messages.types import floats_from_bytes
from trolley_planner.sensing.published_costs import PUBLISHED_COSTS

from .conftest import Stage

HERE, MIDDLE, THERE = Pose2D(1.0, 1.0, 0.0), (2.0, 3.0), Pose2D(3.0, 5.0, 0.0)
"""In the left room, 4 x 6 m: the straight path from HERE to THERE leads through MIDDLE."""


@pytest.fixture
def keep_away() -> Any:
    return load_example("keep_away")


def publish(stage: Stage, costs: GridMap, source: str = "test") -> None:
    stage.robot.publish(topics.COSTS, map_message(stage.robot.robot_ns, costs), source)
    stage.lockstep.run(1.2)


def nearest_m(stage: Stage) -> float:
    """How near the newest path comes to MIDDLE."""
    poses = floats_from_bytes(stage.paths[-1].poses, 3)
    return float(np.hypot(poses[:, 0] - MIDDLE[0], poses[:, 1] - MIDDLE[1]).min())


def sent(stage: Stage, there: Pose2D) -> float:
    """Plan to a place; how near the path comes to MIDDLE."""
    stage.send(there)
    stage.lockstep.run(0.3)
    return nearest_m(stage)


def test_a_drive_keeps_away_while_a_program_publishes_costs(stage: Stage, keep_away: Any) -> None:
    stage.send(HERE)
    stage.until("arrived")
    assert sent(stage, THERE) < 0.2
    publish(stage, keep_away.layer("room", *MIDDLE))
    assert nearest_m(stage) > 0.7, "a drive that is under way takes the better path"
    driven_m = [9.0]

    def note() -> bool:
        driven_m.append(stage.world.pose.distance_to(Pose2D(*MIDDLE, 0.0)))
        return stage.goals[-1].state == "arrived"

    assert stage.lockstep.run_until(note, 60.0)
    assert min(driven_m) > 0.6
    stage.lockstep.run(12.0)
    assert sent(stage, HERE) < 0.2, "the program is gone, and so are its costs"


def test_what_costs_is_neither_closed_nor_opened(stage: Stage, keep_away: Any) -> None:
    everywhere = GridMap(
        "room", 1.0, Pose2D(-5.0, -5.0, 0.0), np.full((20, 20), 100, dtype=np.int8)
    )
    publish(stage, everywhere)
    for there in (Pose2D(*MIDDLE, 0.0), Pose2D(6.5, 4.5, 0.0)):
        stage.send(there)
        stage.until("arrived")
    assert stage.world.touches == 0


def test_costs_that_cannot_be_used_are_counted_and_change_nothing(
    stage: Stage, keep_away: Any
) -> None:
    stage.send(HERE)
    stage.until("arrived")
    health = stage.lockstep.record(topics.HEALTH, "planner")
    costs = keep_away.layer("room", *MIDDLE)
    publish(stage, GridMap("attic", costs.resolution, costs.origin, costs.cells))
    publish(stage, GridMap("room", costs.resolution, costs.origin, -costs.cells), "negative")
    publish(stage, GridMap("room", 1e-4, Pose2D(1e6, -1e6, 1.0), costs.cells), "far")
    in_odom = structs.replace(map_message(stage.robot.robot_ns, costs), frame="odom")
    stage.robot.publish(topics.COSTS, in_odom, "odom")
    assert sent(stage, THERE) < 0.2
    for number in range(PUBLISHED_COSTS.most_sources):
        stage.robot.publish(topics.COSTS, map_message(stage.robot.robot_ns, costs), f"p{number}")
    stage.lockstep.run(1.5)
    assert health[-1].counters["costs/frame"] == 1
    assert health[-1].counters["costs/too_many"] == 3
