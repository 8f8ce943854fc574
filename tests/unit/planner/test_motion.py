"""Clearance of the footprint, the controller's safety, and the final approach."""

import math

import numpy as np
import pytest
from support.flatland import empty_room, with_block

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, Twist2D, integrate_twist, wrap_angle
from trolley_planner.context.planning_context import PlanningContext, empty_grid
from trolley_planner.control.controller import Motion, limits_of, safe_command
from trolley_planner.control.mppi import Mppi
from trolley_planner.control.rollout import Target
from trolley_planner.costmap.footprint import Footprint
from trolley_planner.driving.final_alignment import FinalAlignment, limited_change
from trolley_planner.goals.goal import Tolerances

CORNERS = [(0.15, 0.12), (-0.15, 0.12), (-0.15, -0.12), (0.15, -0.12)]
FOOTPRINT = Footprint.from_polygon(CORNERS)
CONFIG = PlannerConfig()
LIMITS = limits_of(CONFIG, 0.5, 1.5, 1.0)


def rig_with_block() -> PlanningContext:
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
    rig = rig_with_block()
    rig.local_costmap.update(pose.x, pose.y)
    assert rig.seen_clearance(pose, 1.0) == pytest.approx(expected, abs=0.02)
    assert rig.map_clearance(pose, 0.5) == pytest.approx(expected, abs=0.04)


def test_clearance_falls_all_the_way_into_an_obstacle() -> None:
    rig = rig_with_block()
    rig.local_costmap.update(2.9, 3.0)
    found = [
        rig.seen_clearance(Pose2D(x, 3.0, 0.0), 1.0) for x in np.arange(2.6, 3.05, 0.01).tolist()
    ]
    assert (np.diff(found) <= 1e-6).all()
    assert found[-1] < -0.1


def test_a_safe_command_never_touches_whatever_was_wanted() -> None:
    rig = rig_with_block()
    rng = np.random.default_rng(5)
    for _ in range(150):
        pose = Pose2D(rng.uniform(2.3, 2.75), rng.uniform(2.0, 4.0), rng.uniform(-3.1, 3.1))
        rig.local_costmap.update(pose.x, pose.y)
        if rig.seen_clearance(pose, 1.0) < CONFIG.clearance_m:
            continue
        wanted = Twist2D(rng.uniform(-0.5, 0.5), 0.0, rng.uniform(-1.5, 1.5))
        motion = Motion(pose, Twist2D.zero())
        given = safe_command(motion, wanted, rig.local_costmap, LIMITS)
        # It drives on for the time that a command takes, and brakes along its arc.
        reached, twist = integrate_twist(pose, given, 0.15), given
        while twist.speed > 1e-3:
            slower = max(0.0, twist.speed - 0.01 * LIMITS.deceleration) / twist.speed
            twist = twist.scaled(slower)
            reached = integrate_twist(reached, twist, 0.01)
        assert rig.seen_clearance(reached, 1.0) > 0.0
        assert abs(given.vx) <= abs(wanted.vx)


def test_away_from_an_obstacle_all_is_safe() -> None:
    rig = rig_with_block()
    pose = Pose2D(2.84, 3.0, 0.0)
    rig.local_costmap.update(pose.x, pose.y)
    back = Twist2D(-0.1, 0.0, 0.0)
    assert safe_command(Motion(pose, Twist2D.zero()), back, rig.local_costmap, LIMITS) == back
    ahead = Twist2D(0.1, 0.0, 0.0)
    assert safe_command(Motion(pose, Twist2D.zero()), ahead, rig.local_costmap, LIMITS).is_zero


def test_nobody_backs_into_what_was_never_seen() -> None:
    config = PlannerConfig(frame="odom")
    rig = PlanningContext(empty_grid(Pose2D.identity(), 6.0, 0.05), FOOTPRINT, config, 0.5)
    motion, back = Motion(Pose2D(3.0, 3.0, 1.0), Twist2D.zero()), Twist2D(-0.1, 0.0, 0.3)
    rig.local_costmap.update(3.0, 3.0)
    assert safe_command(motion, back, rig.local_costmap, LIMITS) == Twist2D(0.0, 0.0, 0.3)
    rig.costmap.obstacle_layer.grid.observed[:] = 1
    assert safe_command(motion, back, rig.local_costmap, LIMITS) == back


def drive_once(seed: int) -> list[Twist2D]:
    rig = PlanningContext(empty_room(), FOOTPRINT, PlannerConfig(seed=seed), 0.5)
    controller = Mppi(PlannerConfig(seed=seed))
    points = np.stack([np.linspace(1.0, 4.0, 61), np.full(61, 3.0)], axis=1)
    remaining = np.linspace(3.0, 0.0, 61)
    pose, twist, given = Pose2D(1.0, 3.2, 0.4), Twist2D.zero(), []
    for _ in range(60):
        rig.local_costmap.update(pose.x, pose.y)
        rig.local_costmap.compute_cost_to_go(points, remaining)
        target = Target(4.0, 3.0, 0.1, goes_on=False)
        found = controller.command(Motion(pose, twist), rig.local_costmap, LIMITS, target, 0.05)
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


@pytest.mark.parametrize("noise_m", [0.0, 0.01])
@pytest.mark.parametrize("yaw", [0.0, 2.0, -3.0])
@pytest.mark.parametrize(
    "start", [Pose2D(-0.3, 0.05, 0.2), Pose2D(0.2, 0.0, 0.1), Pose2D(0, 0.1, 3)]
)
def test_the_approach_ends_on_the_goal_and_stays(start, yaw, noise_m) -> None:
    rng = np.random.default_rng(1)
    goal = Pose2D(0.0, 0.0, yaw)
    approach = FinalAlignment(Tolerances(0.05, 0.05))
    pose, twist = start, Twist2D.zero()
    for _ in range(400):
        noise = rng.normal(0.0, noise_m, 2)
        felt = Pose2D(pose.x + noise[0], pose.y + noise[1], pose.yaw)
        wanted = approach.command(Motion(felt, twist), goal, LIMITS, 0.05)
        if wanted is None:
            break
        twist = limited_change(twist, wanted, LIMITS, 0.05)
        pose = integrate_twist(pose, twist, 0.05)
    else:
        pytest.fail("it never arrived")
    assert twist.speed < 0.02
    assert abs(twist.wz) < 0.05
    assert math.hypot(pose.x, pose.y) <= 0.05 + 3.0 * noise_m
    assert abs(wrap_angle(pose.yaw - yaw)) <= 0.05
