"""Clearance, motion and speed limits of the rollouts against plain geometry."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.cases import cases
from support.flatland import empty_room, with_block
from support.proximity import proximity_cost

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, Twist2D, integrate_twist
from trolley.gridmap.kernels import interpolate
from trolley_planner.context.planning_context import PlanningContext
from trolley_planner.control.controller import limits_of
from trolley_planner.control.critics import (
    CRITICS,
    Target,
    Velocity,
    cost_at,
    step_cost,
    terminal_cost,
)
from trolley_planner.control.proximity import standing_cost
from trolley_planner.control.robot_motion import (
    advance,
    allowed_speed,
    caution_speed,
    followed,
    moved,
)
from trolley_planner.control.rollout import ROLLOUT, Scene, rollouts_into
from trolley_planner.costmap.footprint import FEW_DO_M, Footprint, clearance_turned

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


@settings(max_examples=cases(200), deadline=None)
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


def plain_rollout(controls: np.ndarray, start: np.ndarray, scene: Scene) -> float:
    """One control sequence, step by step."""
    field, body, limits, target = scene
    x, y, yaw, v, w = (float(value) for value in start)
    turned = math.cos(yaw), math.sin(yaw)
    enough = max(limits.caution_m, CRITICS.near_m)
    clearance = clearance_turned(field, body, (x, y), turned, enough)
    floor = min(limits.clearance_m, clearance - ROLLOUT.same_clearance_m)
    is_in_the_open = clearance >= enough and len(field.walkers) == 0
    walked = body.few_points, body.inscribed_m, body.circumscribed_m
    cost, steps = 0.0, len(controls)
    for step in range(steps):
        allowed = allowed_speed(field, limits, x, y, clearance)
        before = v, w
        wanted = float(controls[step, 0]), float(controls[step, 1])
        v, w = followed(v, w, wanted, limits, allowed)
        controls[step] = v, w
        x, y, cos, sin = moved(x, y, turned, (v, w), limits.dt)
        place, turned = (x, y), (cos, sin)
        clearance = clearance_turned(field, body, place, turned, enough)
        near = 0.0
        if len(field.walkers) + len(field.robots):
            then = place, turned, (step + 1) * limits.dt
            near = proximity_cost(field.walkers, field.robots, walked, then, v)
        if clearance < floor or near == math.inf:
            return cost + ROLLOUT.collision_cost + steps - step + cost_at(field, x, y)
        cost += CRITICS.proximity * near * limits.dt
        cost += step_cost(Velocity(v, w), Velocity(*before), clearance, limits.dt)
        if step + 1 == steps // 2 and is_in_the_open:
            cost += ROLLOUT.middle * cost_at(field, x, y)
        if step + 1 in (steps // 2, steps):
            then_s = (step + 1) * limits.dt
            stands = standing_cost(field.walkers, walked, place, turned, then_s)
            cost += 0.5 * CRITICS.proximity * stands
        if (target.x - x) ** 2 + (target.y - y) ** 2 < target.radius**2:
            left = (steps - 1 - step) * limits.dt
            return cost - (left * limits.max_speed if target.goes_on else 0.0)
    return cost + terminal_cost(field, (x, y), turned, target, limits)


@settings(max_examples=cases(25), deadline=None)
@given(st.integers(0, 10_000), places, st.booleans(), st.booleans(), st.sampled_from([1, 7, 300]))
def test_side_by_side_they_cost_what_each_costs_alone(seed, place, busy, goes_on, count) -> None:
    rng = np.random.default_rng(seed)
    local = RIG.local_costmap
    local.update(place[0], place[1])
    local.compute_cost_to_go(np.array([[3.0, 1.0], [4.0, 1.2]]), np.array([1.0, 0.0]))
    field = local.field
    if busy:
        walkers = np.column_stack([rng.uniform(1.0, 4.5, (3, 2)), rng.normal(0.0, 0.7, (3, 2))])
        alone_s = np.array([0.5, 2.0, np.inf])
        walkers = np.column_stack([walkers, np.full((3, 2), 0.2), alone_s])
        discs = np.concatenate([rng.uniform(1.0, 4.5, (2, 9, 2)), np.full((2, 9, 1), 0.2)], axis=2)
        zones = np.full(RIG.costmap.shape, np.inf, dtype=np.float32)
        zones[:50] = 0.2
        field = field._replace(walkers=walkers, robots=discs, speed_mps=zones)
    limits = limits_of(CONFIG, 0.8, 1.5, 1.0)
    target = Target(place[0] + 0.8, place[1], 0.2, goes_on)
    scene = Scene(field, local.body, limits, target)
    controls = rng.normal(0.0, 0.8, (count, 15, 2))
    controls[:, :, 0] += rng.uniform(-0.2, 0.8)
    start = np.array([*place, rng.uniform(-0.2, 0.6), rng.normal(0.0, 0.5)])
    together, costs = controls.copy(), np.empty(count)
    rollouts_into(costs, together, start, scene)
    for index in range(0, count, 3):
        assert plain_rollout(controls[index], start, scene) == costs[index]
        np.testing.assert_array_equal(controls[index], together[index])


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


def test_getting_out_of_the_way_early_costs_less_than_late() -> None:
    """Else it is put off from command to command, until there is no time left for it."""
    room = PlanningContext(empty_room(), FOOTPRINT, CONFIG, 2.0)
    local = room.local_costmap
    local.update(3.0, 3.0)
    local.compute_cost_to_go(np.array([[3.0, 3.0], [6.0, 3.0]]), np.array([3.0, 0.0]))
    comes = np.array([[5.5, 3.0, -0.8, 0.0, 0.25, 0.05, np.inf]])
    scene = Scene(
        local.field._replace(walkers=comes), local.body, limits_of(CONFIG, 0.5, 1.5, 0.9),
        Target(6.5, 3.0, 0.2, True),
    )  # fmt: skip
    aside = np.array([-1.0] * 4 + [0.0] * 4 + [1.0] * 4)
    straight = np.zeros(12)
    early, late = np.concatenate([aside, straight]), np.concatenate([straight, aside])
    controls = np.stack([np.column_stack([np.full(24, 0.25), turn]) for turn in (early, late)])
    start = np.array([3.0, 3.0, 0.0, 0.25, 0.0])
    costs, alone = np.empty(2), np.empty(2)
    rollouts_into(costs, controls.copy(), start, scene)
    rollouts_into(alone, controls.copy(), start, scene._replace(field=local.field))
    assert alone[0] == pytest.approx(alone[1], abs=0.05)
    assert costs[0] < costs[1] - 0.3
