"""The cheap controller drives like the other: along, round, in place, and never into things."""

import math

import numpy as np
import pytest
from support.flatland import empty_room, with_block

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, Twist2D, integrate_twist
from trolley_planner.context.planning_context import PlanningContext
from trolley_planner.control.controller import Motion, limits_of, safe_command
from trolley_planner.control.critics import Target
from trolley_planner.control.mppi import Mppi
from trolley_planner.control.pure_pursuit import PurePursuit
from trolley_planner.costmap.footprint import Footprint

FOOTPRINT = Footprint.from_polygon([(0.15, 0.12), (-0.15, 0.12), (-0.15, -0.12), (0.15, -0.12)])
CONFIG = PlannerConfig(controller="pursuit")
LIMITS = limits_of(CONFIG, 0.5, 1.5, 1.0)


pytestmark = pytest.mark.drives


def drive(context: PlanningContext, pose: Pose2D, ticks: int) -> tuple[list[Pose2D], list[Twist2D]]:
    """Follow a straight path from (1, 3) to (4, 3)."""
    points = np.stack([np.linspace(1.0, 4.0, 61), np.full(61, 3.0)], axis=1)
    remaining = np.linspace(3.0, 0.0, 61)
    target = Target(4.0, 3.0, 0.1, goes_on=False)
    twist, poses, given = Twist2D.zero(), [pose], []
    for _ in range(ticks):
        context.local_costmap.update(pose.x, pose.y)
        context.local_costmap.compute_cost_to_go(points, remaining)
        motion = Motion(pose, twist)
        near = points[max(round((pose.x - 1.0) / 0.05), 0) :]
        found = context.controller.command(
            motion, context.local_costmap, LIMITS, target, near, 0.05
        )
        assert found is not None
        twist = safe_command(motion, found, context.local_costmap, LIMITS)
        pose = integrate_twist(pose, twist, 0.05)
        poses.append(pose)
        given.append(twist)
    return poses, given


def test_the_controller_is_the_one_that_was_chosen() -> None:
    assert isinstance(PlanningContext(empty_room(), FOOTPRINT, CONFIG, 0.5).controller, PurePursuit)
    assert isinstance(
        PlanningContext(empty_room(), FOOTPRINT, PlannerConfig(), 0.5).controller, Mppi
    )


def test_it_drives_smoothly_to_the_end_of_the_path() -> None:
    poses, given = drive(
        PlanningContext(empty_room(), FOOTPRINT, CONFIG, 0.5), Pose2D(1.0, 3.3, 0.3), 240
    )
    assert math.hypot(poses[-1].x - 4.0, poses[-1].y - 3.0) < 0.15
    speeds = np.array([[twist.vx, twist.wz] for twist in given])
    assert speeds[:, 0].max() > 0.45
    changes = np.abs(np.diff(speeds, axis=0))
    assert changes[:, 0].max() <= 0.05 * LIMITS.deceleration + 1e-9
    assert changes[:, 1].max() <= 0.05 * LIMITS.turn_acceleration + 1e-9


def test_looking_away_it_turns_in_place_first() -> None:
    poses, _ = drive(
        PlanningContext(empty_room(), FOOTPRINT, CONFIG, 0.5), Pose2D(1.5, 3.0, 3.0), 40
    )
    turned = next(index for index, pose in enumerate(poses) if abs(pose.yaw) < 0.6)
    assert math.hypot(poses[turned].x - 1.5, poses[turned].y - 3.0) < 0.05


def test_it_drives_round_what_stands_on_the_path() -> None:
    context = PlanningContext(with_block(empty_room(), 2.3, 2.8, 0.3, 0.4), FOOTPRINT, CONFIG, 0.5)
    poses, _ = drive(context, Pose2D(1.0, 3.0, 0.0), 320)
    assert math.hypot(poses[-1].x - 4.0, poses[-1].y - 3.0) < 0.15
    for pose in poses:
        context.local_costmap.update(pose.x, pose.y)
        assert context.seen_clearance(pose, 1.0) > 0.0


def test_the_same_place_gives_the_same_drive() -> None:
    first = drive(PlanningContext(empty_room(), FOOTPRINT, CONFIG, 0.5), Pose2D(1.0, 3.3, 0.3), 60)
    assert first == drive(
        PlanningContext(empty_room(), FOOTPRINT, CONFIG, 0.5), Pose2D(1.0, 3.3, 0.3), 60
    )
