"""The footprint and its clearance."""

import math

import numpy as np
import pytest
from support.flatland import empty_room, with_block

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D
from trolley_planner.context.planning_context import PlanningContext
from trolley_planner.costmap.footprint import Footprint

CORNERS = [(0.15, 0.12), (-0.15, 0.12), (-0.15, -0.12), (0.15, -0.12)]
FOOTPRINT = Footprint.from_polygon(CORNERS)
CONFIG = PlannerConfig()


def context_with_block() -> PlanningContext:
    return PlanningContext(with_block(empty_room(), 3.0, 2.0, 0.5, 2.0), FOOTPRINT, CONFIG, 0.5)


@pytest.mark.parametrize("bad", [[(0, 0), (1, 0)], [(1, 1), (2, 1), (2, 2), (1, 2)]])
def test_footprints_that_are_none_are_refused(bad) -> None:
    with pytest.raises(ValueError, match=r"polygon|footprint"):
        Footprint.from_polygon(bad)


@pytest.mark.parametrize(
    ("pose", "expected"),
    [
        (Pose2D(2.5, 3.0, 0.0), 0.35),
        (Pose2D(2.5, 3.0, math.pi / 2.0), 0.38),
        (Pose2D(2.5, 3.0, math.pi), 0.35),
        (Pose2D(2.8, 3.0, 0.0), 0.05),
        (Pose2D(2.75, 1.75, math.pi / 4.0), 0.204),
    ],
)
def test_clearance_is_that_of_the_outline(pose: Pose2D, expected: float) -> None:
    context = context_with_block()
    context.local_costmap.update(pose.x, pose.y)
    assert context.seen_clearance(pose, 1.0) == pytest.approx(expected, abs=0.02)
    assert context.map_clearance(pose, 0.5) == pytest.approx(expected, abs=0.04)


def test_clearance_falls_all_the_way_into_an_obstacle() -> None:
    context = context_with_block()
    context.local_costmap.update(2.9, 3.0)
    found = [
        context.seen_clearance(Pose2D(x, 3.0, 0.0), 1.0)
        for x in np.arange(2.6, 3.05, 0.01).tolist()
    ]
    assert (np.diff(found) <= 1e-6).all()
    assert found[-1] < -0.1
