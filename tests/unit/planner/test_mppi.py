"""Model predictive path integral control."""

import math

import numpy as np
import pytest
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


@pytest.mark.parametrize("yaw", [0.35, 0.6, -0.4, 2.8])
def test_a_straight_path_at_an_angle_to_the_cells_is_kept(yaw: float) -> None:
    context = PlanningContext(empty_room(10.0, 10.0), FOOTPRINT, CONFIG, 0.5)
    local_costmap, controller = context.local_costmap, Mppi(CONFIG)
    ahead, start, last = np.array([math.cos(yaw), math.sin(yaw)]), np.array([5.03, 5.01]), 80
    points = start + np.linspace(0.0, 3.5, last + 1)[:, None] * ahead
    remaining = np.linspace(3.5, 0.0, last + 1)
    pose, twist, off_m = Pose2D(5.03, 5.01, yaw), Twist2D.zero(), []
    while (along := float((pose.as_array()[:2] - start) @ ahead)) < 3.0:
        first = max(0, int(along / 3.5 * last) - 1)
        part = slice(first, min(first + 50, last + 1))
        local_costmap.update(pose.x, pose.y)
        local_costmap.compute_cost_to_go(points[part], remaining[part] - remaining[part][-1])
        x, y = points[part][-1]
        target = Target(x, y, 0.1, goes_on=part.stop <= last)
        twist = controller.command(Motion(pose, twist), local_costmap, LIMITS, target, 0.05)
        assert twist is not None
        pose = integrate_twist(pose, twist, 0.05)
        away = pose.as_array()[:2] - start
        off_m.append(abs(ahead[0] * away[1] - ahead[1] * away[0]))
    assert max(off_m) < 0.035
