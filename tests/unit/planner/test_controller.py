"""The braking check that no command gets past."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.flatland import empty_room, with_block

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, Twist2D, integrate_twist
from trolley_planner.context.planning_context import PlanningContext, empty_grid
from trolley_planner.control.controller import Motion, limited_change, limits_of, safe_command
from trolley_planner.costmap.footprint import Footprint
from trolley_planner.fleet.neighbours import NEIGHBOURS
from trolley_planner.people.moving_obstacles import ROBOT_DT_S
from trolley_planner.sensing.beams import ScanShape, Sweep

CORNERS = [(0.15, 0.12), (-0.15, 0.12), (-0.15, -0.12), (0.15, -0.12)]
FOOTPRINT = Footprint.from_polygon(CORNERS)
CONFIG = PlannerConfig()
LIMITS = limits_of(CONFIG, 0.5, 1.5, 1.0)


def context_with_block() -> PlanningContext:
    return PlanningContext(with_block(empty_room(), 3.0, 2.0, 0.5, 2.0), FOOTPRINT, CONFIG, 0.5)


def test_a_safe_command_never_touches_whatever_was_wanted() -> None:
    context = context_with_block()
    rng = np.random.default_rng(5)
    for _ in range(150):
        pose = Pose2D(rng.uniform(2.3, 2.75), rng.uniform(2.0, 4.0), rng.uniform(-3.1, 3.1))
        context.local_costmap.update(pose.x, pose.y)
        if context.seen_clearance(pose, 1.0) < CONFIG.clearance_m:
            continue
        wanted = Twist2D(rng.uniform(-0.5, 0.5), 0.0, rng.uniform(-1.5, 1.5))
        motion = Motion(pose, Twist2D.zero())
        given = safe_command(motion, wanted, context.local_costmap, LIMITS)
        # It drives on for the time that a command takes, and brakes along its arc.
        reached, twist = integrate_twist(pose, given, 0.15), given
        while twist.speed > 1e-3:
            slower = max(0.0, twist.speed - 0.01 * LIMITS.deceleration) / twist.speed
            twist = twist.scaled(slower)
            reached = integrate_twist(reached, twist, 0.01)
        assert context.seen_clearance(reached, 1.0) > 0.0
        assert abs(given.vx) <= abs(wanted.vx)


def test_away_from_an_obstacle_all_is_safe() -> None:
    context = context_with_block()
    pose = Pose2D(2.84, 3.0, 0.0)
    context.local_costmap.update(pose.x, pose.y)
    back = Twist2D(-0.1, 0.0, 0.0)
    assert safe_command(Motion(pose, Twist2D.zero()), back, context.local_costmap, LIMITS) == back
    ahead = Twist2D(0.1, 0.0, 0.0)
    assert safe_command(Motion(pose, Twist2D.zero()), ahead, context.local_costmap, LIMITS).is_zero


def test_nobody_backs_into_what_was_never_seen() -> None:
    config = PlannerConfig(frame="odom")
    context = PlanningContext(empty_grid(Pose2D.identity(), 6.0, 0.05), FOOTPRINT, config, 0.5)
    motion, back = Motion(Pose2D(3.0, 3.0, 1.0), Twist2D.zero()), Twist2D(-0.1, 0.0, 0.3)
    context.local_costmap.update(3.0, 3.0)
    assert safe_command(motion, back, context.local_costmap, LIMITS) == Twist2D(0.0, 0.0, 0.3)
    context.costmap.obstacle_layer.grid.observed[:] = 1
    assert safe_command(motion, back, context.local_costmap, LIMITS) == back


def test_with_half_a_view_nobody_backs_into_what_was_seen_long_ago() -> None:
    context = PlanningContext(empty_room(), FOOTPRINT, PlannerConfig(), 0.5)
    back, local = Twist2D(-0.1, 0.0, 0.0), context.local_costmap
    shape = ScanShape(-0.5 * math.pi, math.pi / 180.0, 0.05, 12.0)
    ranges = np.full(181, 2.0, dtype=np.float32)

    def may_back_up(yaw: float, now_s: float) -> bool:
        pose = Pose2D(3.0, 3.0, yaw)
        scan = Sweep(ranges, shape, pose, pose, FOOTPRINT.polygon)
        context.costmap.add_scan(scan, round(now_s * 1e9))
        local.update(3.0, 3.0)
        return not safe_command(Motion(pose, Twist2D.zero()), back, local, LIMITS).is_zero

    assert not may_back_up(0.0, 1.0), "the map alone does not tell who stands there"
    assert may_back_up(math.pi, 2.0), "it has looked there a second before"
    assert may_back_up(math.pi, 15.0)
    assert not may_back_up(math.pi, 30.0)


def test_a_robot_that_obeys_late_does_not_drive_deeper_into_what_has_come() -> None:
    context = context_with_block()
    context.local_costmap.update(2.6, 3.0)
    ahead = Twist2D(0.4, 0.0, 0.0)
    # It will be in the block before it obeys; without `here` it seems to stand there already.
    motion = Motion(Pose2D(2.95, 3.0, 0.0), ahead, here=Pose2D(2.6, 3.0, 0.0))
    assert safe_command(motion, ahead, context.local_costmap, LIMITS).is_zero


@pytest.mark.parametrize(("vx", "drives_on"), [(-0.5, False), (0.0, True), (0.5, True)])
def test_it_does_not_drive_into_another_robot_on_its_way(vx: float, drives_on: bool) -> None:
    context, pose, ahead = context_with_block(), Pose2D(1.5, 3.0, 0.0), Twist2D(0.4, 0.0, 0.0)
    track = [[2.1 + ROBOT_DT_S * vx * step, 3.0, 0.2] for step in range(NEIGHBOURS.track_steps)]
    context.costmap.moving.set_robots(np.empty((0, 3)), [np.array([track])], 0)
    local = context.local_costmap
    local.update_moving(0)
    local.update(pose.x, pose.y)
    given = safe_command(Motion(pose, Twist2D.zero()), ahead, local, LIMITS)
    assert (given == ahead) is drives_on
    local.leave_people_out()
    assert safe_command(Motion(pose, Twist2D.zero()), ahead, local, LIMITS) == given


@given(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(-1.5, 1.5), st.floats(0.02, 0.3))
def test_it_speeds_up_brakes_and_turns_as_fast_as_it_may(
    before: float, wanted: float, turn: float, elapsed_s: float
) -> None:
    limits = LIMITS._replace(acceleration=0.4, deceleration=0.9, turn_acceleration=2.0)
    after = limited_change(Twist2D(before, 0.0, 0.0), Twist2D(wanted, 0.0, turn), limits, elapsed_s)
    slows_down = before * (wanted - before) < 0.0
    most = elapsed_s * (limits.deceleration if slows_down else limits.acceleration)
    assert after.vx == pytest.approx(before + np.clip(wanted - before, -most, most))
    most = elapsed_s * limits.turn_acceleration
    assert after.wz == pytest.approx(np.clip(turn, -most, most))
