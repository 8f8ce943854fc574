"""Clearance, motion and speed limits of the rollouts against plain geometry."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.flatland import empty_room, with_block

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, Twist2D, integrate_twist
from trolley.gridmap.kernels import interpolate
from trolley_planner.context.planning_context import PlanningContext
from trolley_planner.control.controller import limits_of
from trolley_planner.control.rollout import advance, caution_speed, followed, moved
from trolley_planner.costmap.footprint import FEW_DO_M, Footprint

CONFIG = PlannerConfig()
FOOTPRINT = Footprint.from_polygon([(0.3, 0.2), (-0.25, 0.2), (-0.25, -0.2), (0.3, -0.1)])
RIG = PlanningContext(with_block(empty_room(), 3.0, 2.0, 0.5, 2.0), FOOTPRINT, CONFIG, 0.5)

places = st.tuples(st.floats(2.2, 3.2), st.floats(1.8, 3.2), st.floats(-3.2, 3.2))


def plain_clearance(pose: Pose2D) -> float:
    """The least distance at points all along the outline, looked up one by one."""
    field = RIG.local_costmap.field
    nearest = math.inf
    for x, y in pose.transform_points(FOOTPRINT.edge_points):
        u, v = (float(x) - field.x) / field.fine_m, (float(y) - field.y) / field.fine_m
        nearest = min(nearest, interpolate(field.distance_m, u - 0.5, v - 0.5))
    return nearest - 0.5 * field.fine_m


@settings(max_examples=200, deadline=None)
@given(places)
def test_clearance_is_exact_near_things_and_to_two_centimetres_elsewhere(place) -> None:
    pose = Pose2D(*place)
    RIG.local_costmap.update(pose.x, pose.y)
    found, plain = RIG.seen_clearance(pose, 1.0), plain_clearance(pose)
    if found >= FEW_DO_M:
        assert plain - 0.003 <= found <= plain + 0.03
    elif found > 0.0:
        assert found == pytest.approx(plain, abs=1e-6)
    else:  # an obstacle within the outline counts for more than one on it
        assert found <= plain + 1e-6


@given(places, st.floats(-2.0, 2.0), st.floats(-3.0, 3.0))
def test_steps_without_sines_are_those_with_them(place, v, w) -> None:
    state = np.array([*place, v, w])
    advance(state, 0.1)
    x, y, cos, sin = moved(
        place[0], place[1], (math.cos(place[2]), math.sin(place[2])), (v, w), 0.1
    )
    assert (x, y) == pytest.approx((state[0], state[1]), abs=1e-8)
    assert (cos, sin) == pytest.approx((math.cos(state[2]), math.sin(state[2])), abs=1e-8)
    exact = integrate_twist(Pose2D(*place), Twist2D(v, 0.0, w), 0.1)
    assert math.hypot(exact.x - x, exact.y - y) <= 0.1 * abs(v) * (0.1 * w) ** 2 / 20.0 + 1e-8


@given(
    st.tuples(st.floats(-0.2, 2.0), st.floats(-2.0, 2.0)),
    st.tuples(st.floats(-9.0, 9.0), st.floats(-9.0, 9.0)),
    st.floats(0.05, 2.0),
)
def test_velocities_change_no_faster_than_the_robot_can(now, wanted, allowed) -> None:
    limits = limits_of(CONFIG, 2.0, 1.5, 1.0)
    v, w = followed(now[0], now[1], wanted, limits, allowed)
    assert abs(v - now[0]) <= limits.deceleration * limits.dt + 1e-9
    assert abs(w - now[1]) <= limits.turn_acceleration * limits.dt + 1e-9
    if now[0] >= 0.0:
        assert v - now[0] <= limits.acceleration * limits.dt + 1e-9
    assert v <= max(allowed, now[0]) + 1e-9


@given(st.floats(-0.1, 1.0), st.floats(0.0, 0.3), st.sampled_from([0.3, 0.5, 2.0]))
def test_more_room_is_never_slower_and_what_can_be_braked_for_is_allowed(room, more, speed) -> None:
    limits = limits_of(CONFIG, speed, 1.5, 1.0)
    now, farther = caution_speed(limits, room), caution_speed(limits, room + more)
    assert min(CONFIG.slow_speed_mps, speed) <= now <= farther <= speed
    if now == speed:
        return
    # Driving the limit for the delay and braking covers what is there, or more by caution's rule.
    stopping = 0.15 * now + 0.5 * now * now / limits.deceleration
    assert stopping >= room - limits.clearance_m - 1e-9
