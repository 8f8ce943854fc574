"""Model predictive path integral control."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from support.flatland import empty_room

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, Twist2D, integrate_twist
from trolley.gridmap import GridMap
from trolley_planner.context.planning_context import PlanningContext
from trolley_planner.control.controller import Motion, limits_of
from trolley_planner.control.critics import Target, cost_of_turning_round
from trolley_planner.control.mppi import Mppi
from trolley_planner.costmap.footprint import Footprint

CORNERS = [(0.15, 0.12), (-0.15, 0.12), (-0.15, -0.12), (0.15, -0.12)]
FOOTPRINT = Footprint.from_polygon(CORNERS)
CONFIG = PlannerConfig()
LIMITS = limits_of(CONFIG, 0.5, 1.5, 1.0)
Floats = NDArray[np.float64]
NO_PATH = np.empty((0, 2))
"""It goes by the cost-to-go."""


class Driver:
    """A robot that does as it is told, in an empty room."""

    def __init__(self, room: GridMap, pose: Pose2D, seed: int) -> None:
        config = PlannerConfig(seed=seed)
        self.pose, self.twist = pose, Twist2D.zero()
        self._local_costmap = PlanningContext(room, FOOTPRINT, config, 0.5).local_costmap
        self._controller = Mppi(config)

    def step(self, points: Floats, remaining: Floats, *, goes_on: bool) -> None:
        local_costmap, motion = self._local_costmap, Motion(self.pose, self.twist)
        local_costmap.update(self.pose.x, self.pose.y)
        local_costmap.compute_cost_to_go(points, remaining)
        x, y = points[-1]
        target = Target(x, y, 0.1, goes_on)
        found = self._controller.command(motion, local_costmap, LIMITS, target, NO_PATH, 0.05)
        assert found is not None
        self.twist = found
        self.pose = integrate_twist(self.pose, found, 0.05)


def drive_once(seed: int) -> list[Twist2D]:
    driver = Driver(empty_room(), Pose2D(1.0, 3.2, 0.4), seed)
    points = np.stack([np.linspace(1.0, 4.0, 61), np.full(61, 3.0)], axis=1)
    remaining = np.linspace(3.0, 0.0, 61)
    given: list[Twist2D] = []
    for _ in range(60):
        driver.step(points, remaining, goes_on=False)
        given.append(driver.twist)
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
    driver = Driver(empty_room(10.0, 10.0), Pose2D(5.03, 5.01, yaw), CONFIG.seed)
    ahead, start, last = np.array([math.cos(yaw), math.sin(yaw)]), np.array([5.03, 5.01]), 80
    points = start + np.linspace(0.0, 3.5, last + 1)[:, None] * ahead
    remaining = np.linspace(3.5, 0.0, last + 1)
    off_m: list[float] = []
    while (along := float((driver.pose.as_array()[:2] - start) @ ahead)) < 3.0:
        first = max(0, int(along / 3.5 * last) - 1)
        part = slice(first, min(first + 50, last + 1))
        left_m = remaining[part] - remaining[part][-1]
        driver.step(points[part], left_m, goes_on=part.stop <= last)
        away = driver.pose.as_array()[:2] - start
        off_m.append(abs(ahead[0] * away[1] - ahead[1] * away[0]))
    assert max(off_m) < 0.035


def test_out_of_people_s_way_it_need_not_turn_round_first() -> None:
    """In a corridor it turned, and was 1.6 s later at a place 1.5 m behind it."""
    hurried = LIMITS._replace(max_reverse=LIMITS.max_speed)
    assert cost_of_turning_round(1.5, LIMITS) > 0.0
    assert cost_of_turning_round(1.5, hurried) == cost_of_turning_round(math.inf, hurried) == 0.0
