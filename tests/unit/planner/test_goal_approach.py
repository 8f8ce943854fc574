"""Where the robot stands in the end, where something is on the goal itself."""

import math

import numpy as np
import pytest
from support.all_poses import box
from support.flatland import empty_room

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, wrap_angle
from trolley_planner.context.planning_context import PlanningContext
from trolley_planner.costmap.footprint import Footprint
from trolley_planner.driving.goal_approach import GoalApproach
from trolley_planner.goals import Tolerances, nearest_free_pose

FOOTPRINT = Footprint.from_polygon(box(0.30, 0.24, 0.15))
CONFIG = PlannerConfig()
ASKED = Tolerances(0.05, math.radians(3.0))


@pytest.mark.parametrize("seed", range(20))
def test_what_stands_in_for_a_goal_leaves_room_to_miss_it(seed: int) -> None:
    # Clearance rises in a random direction and with a random turn: as beside a wall, askew to it.
    along, per_turn, least = np.random.default_rng(seed).uniform(-1.0, 1.0, 3).tolist()
    goal = Pose2D(2.0, 2.0, 0.3)

    def clearance(pose: Pose2D) -> float:
        bearing = math.pi * along
        aside = (pose.x - goal.x) * math.cos(bearing) + (pose.y - goal.y) * math.sin(bearing)
        return 0.02 * least + aside + 0.5 * per_turn * wrap_angle(pose.yaw - goal.yaw)

    found = nearest_free_pose(goal, ASKED, clearance, 0.02)
    if found is None:
        assert least < 0.0
        return
    assert found.distance_to(goal) < 0.8 * ASKED.xy
    assert abs(wrap_angle(found.yaw - goal.yaw)) < 0.6 * ASKED.yaw


@pytest.mark.parametrize("turned", [0.0, 0.3, -0.5])
@pytest.mark.parametrize("moved", [0.0, 0.5, 0.75])
def test_arriving_near_the_stand_in_is_arriving_at_the_goal(turned: float, moved: float) -> None:
    context = PlanningContext(empty_room(), FOOTPRINT, CONFIG, 0.5)
    goal = Pose2D(2.0, 3.0, 1.0)
    approach = GoalApproach(context, CONFIG, goal, ASKED)
    approach.aim = Pose2D(goal.x + moved * ASKED.xy, goal.y, goal.yaw + turned * ASKED.yaw)
    near = approach.near
    for side in (-0.99, 0.99):
        ended = Pose2D(approach.aim.x + side * near.xy, goal.y, approach.aim.yaw + side * near.yaw)
        assert approach.is_there(ended)
