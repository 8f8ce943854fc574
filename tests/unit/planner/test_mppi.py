"""Model predictive path integral control."""

import numpy as np
from support.flatland import empty_room

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, Twist2D, integrate_twist
from trolley_planner.context.planning_context import PlanningContext
from trolley_planner.control.controller import Motion, limits_of
from trolley_planner.control.critics import Target
from trolley_planner.control.mppi import Mppi
from trolley_planner.costmap.footprint import Footprint

CORNERS = [(0.15, 0.12), (-0.15, 0.12), (-0.15, -0.12), (0.15, -0.12)]
FOOTPRINT = Footprint.from_polygon(CORNERS)
CONFIG = PlannerConfig()
LIMITS = limits_of(CONFIG, 0.5, 1.5, 1.0)


def drive_once(seed: int) -> list[Twist2D]:
    context = PlanningContext(empty_room(), FOOTPRINT, PlannerConfig(seed=seed), 0.5)
    controller = Mppi(PlannerConfig(seed=seed))
    points = np.stack([np.linspace(1.0, 4.0, 61), np.full(61, 3.0)], axis=1)
    remaining = np.linspace(3.0, 0.0, 61)
    pose, twist, given = Pose2D(1.0, 3.2, 0.4), Twist2D.zero(), []
    for _ in range(60):
        context.local_costmap.update(pose.x, pose.y)
        context.local_costmap.compute_cost_to_go(points, remaining)
        target = Target(4.0, 3.0, 0.1, goes_on=False)
        found = controller.command(Motion(pose, twist), context.local_costmap, LIMITS, target, 0.05)
        assert found is not None
        twist = found
        pose = integrate_twist(pose, twist, 0.05)
        given.append(twist)
    return given


def test_the_controller_is_deterministic_smooth_and_within_limits() -> None:
    given = drive_once(1)
    assert given == drive_once(1)
    assert given != drive_once(2)
    speeds = np.array([[twist.vx, twist.wz] for twist in given])
    assert speeds[:, 0].max() <= 0.5 + 1e-9
    changes = np.abs(np.diff(speeds, axis=0))
    assert changes[:, 0].max() <= 0.05 * LIMITS.deceleration + 1e-9
    assert changes[:, 1].max() <= 0.05 * LIMITS.turn_acceleration + 1e-9
    assert speeds[-1, 0] > 0.45
