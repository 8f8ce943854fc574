"""How near the robot comes to who walks: the compiled loops beside slow plain ones."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from support.cases import cases

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, Twist2D, integrate_twist
from trolley.geometry.polygon import distance_to_outline, polygon_contains
from trolley_planner.control.controller import limits_of
from trolley_planner.control.proximity import (
    PROXIMITY,
    disc_gap,
    is_walked_into,
    people_proximity_cost,
    standing_cost,
    would_meet_people,
)
from trolley_planner.costmap.footprint import Footprint
from trolley_planner.people.moving_obstacles import NOBODY

FOOTPRINT = Footprint.from_polygon([(0.3, 0.2), (-0.25, 0.2), (-0.25, -0.2), (0.3, -0.1)])
BODY = FOOTPRINT.body
LIMITS = limits_of(PlannerConfig(), 0.5, 1.5, 1.0)
COARSE_M = 0.02
"""The few points of the outline find a gap so well."""
SURE_MPS = 0.06
"""And the speed of the nearest so well."""
CORNERS = np.array(FOOTPRINT.polygon)
EDGE = np.concatenate(
    [np.linspace(one, other, 500) for one, other in pairwise([*CORNERS, CORNERS[0]])]
)

poses = st.builds(Pose2D, st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(-3.1, 3.1))
walking = st.tuples(
    st.floats(-2.0, 2.0),
    st.floats(-2.0, 2.0),
    st.floats(-1.5, 1.5),
    st.floats(-1.5, 1.5),
    st.floats(0.2, 0.4),
    st.floats(0.02, 0.15),
)
crowds = st.lists(walking, max_size=4).map(lambda found: np.array(found).reshape(-1, 6))


def plain_gap(pose: Pose2D, x: float, y: float, radius: float) -> float:
    """From the outline to a disc [m], negative where they overlap."""
    local = pose.inverse().transform_points(np.array([[x, y]]))
    gap = float(distance_to_outline(FOOTPRINT.polygon, local)[0])
    return (-gap if polygon_contains(FOOTPRINT.polygon, local)[0] else gap) - radius


def away_from(pose: Pose2D, x: float, y: float) -> tuple[float, float]:
    return x - pose.x, y - pose.y


def facing(pose: Pose2D) -> tuple[float, float]:
    return math.cos(pose.yaw), math.sin(pose.yaw)


@given(poses, st.floats(-1.5, 1.5), st.floats(-1.5, 1.5), st.floats(0.2, 0.4))
def test_the_gap_is_that_of_the_outline(pose: Pose2D, x: float, y: float, radius: float) -> None:
    away, turned = away_from(pose, x, y), facing(pose)
    found = disc_gap(BODY.edge_points, BODY.inscribed_m, away, turned, radius)
    plain = plain_gap(pose, x, y, radius)
    if plain + radius > 0.0:
        assert plain - 1e-9 <= found <= plain + COARSE_M
    else:  # who is within the outline overlaps in any case
        assert found <= COARSE_M


def is_to_blame(pose: Pose2D, v: float, x: float, y: float) -> bool:
    """Whether the robot is no bystander: it comes nearer by itself."""
    ahead = pose.inverse().transform_points(np.array([[x, y]]))[0]
    return v * ahead[0] > PROXIMITY.closing_mps * math.hypot(*ahead)


def closing_mps(pose: Pose2D, moves: tuple[float, float], x: float, y: float) -> float:
    """Speed of the outline's point that is nearest to a place, towards it, by two poses of it."""
    there = pose.inverse().transform_points(np.array([[x, y]]))[0]
    nearest = EDGE[np.hypot(*(EDGE - there).T).argmin()]
    moved = integrate_twist(Pose2D(0.0, 0.0, 0.0), Twist2D(moves[0], 0.0, moves[1]), 1e-4)
    velocity = (moved.transform_points(nearest[None])[0] - nearest) / 1e-4
    return float(velocity @ there) / max(math.hypot(*there), 1e-9)


def plain_cost(gap: float, v: float) -> float:
    """Of one person: being near, and, the faster the more, touching."""
    near = min(max(1.0 - gap / PROXIMITY.near_m, 0.0), PROXIMITY.most_cost)
    deep = max(PROXIMITY.touch_m - gap, 0.0)
    return near**2 + PROXIMITY.touch * deep**2 * (1.0 + PROXIMITY.moving * abs(v))


@settings(max_examples=cases(300))
@given(crowds, poses, st.sampled_from([-0.2, 0.0, 0.3]), st.floats(0.0, 3.0))
def test_company_counts_everybody_where_they_are_then(
    crowd: NDArray[np.float64], pose: Pose2D, v: float, time_s: float
) -> None:
    body = BODY.edge_points, BODY.inscribed_m, BODY.circumscribed_m
    among = np.column_stack([crowd, np.full(len(crowd), 1.0)])  # who come upon others
    found = people_proximity_cost(among, body, (pose.x, pose.y), facing(pose), v, time_s)
    low, high, hits, may_hit = 0.0, 0.0, False, False
    for x, y, vx, vy, radius, growth in crowd:
        there = x + time_s * vx, y + time_s * vy
        gap = plain_gap(pose, *there, radius + min(growth * time_s, PROXIMITY.most_spread_m))
        blamed = time_s <= PROXIMITY.sure_s and is_to_blame(pose, v, *there)
        may_hit |= blamed and gap < PROXIMITY.meet_m
        hits |= blamed and -radius < gap < PROXIMITY.meet_m - COARSE_M
        left = math.exp(-time_s / PROXIMITY.fades_s)
        near, nearer = (left * plain_cost(one, v) for one in (gap + COARSE_M, gap))
        low, high = low + near, high + nearer
    assert not hits or found == math.inf
    assert may_hit or found < math.inf
    # Within the outline a gap is counted from the circle in it, or from the edge.
    if found < math.inf and all(
        plain_gap(pose, x + time_s * vx, y + time_s * vy, 0.0) > 0.0 for x, y, vx, vy, *_ in crowd
    ):
        assert low - 1e-6 <= found <= high + 1e-6


@settings(max_examples=cases(300))
@given(crowds, st.floats(-0.25, 2.0), st.floats(-1.5, 1.5))
def test_braking_for_somebody_is_seen_in_time(
    crowd: NDArray[np.float64], v: float, w: float
) -> None:
    start = np.array([0.0, 0.0, 0.0, v, w])
    found = would_meet_people(start, crowd, BODY, LIMITS.deceleration, 0.15)
    pose, speed, meets, nearly = Pose2D(0.0, 0.0, 0.0), v, False, False
    for step in range(1, 400):
        if abs(speed) < PROXIMITY.standing_mps:
            break
        if 0.05 * step > 0.15:
            slower = math.copysign(max(abs(speed) - 0.05 * LIMITS.deceleration, 0.0), speed)
            w *= slower / speed
            speed = slower
        pose = integrate_twist(pose, Twist2D(speed, 0.0, w), 0.05)
        swerve_m = 0.5 * PROXIMITY.swerve_mps2 * (0.05 * step) ** 2
        for x, y, vx, vy, radius, _ in crowd:
            for time_s in (0.0, 0.05 * step):
                there = x + time_s * vx, y + time_s * vy
                gap = plain_gap(pose, *there, radius + swerve_m)
                closing = closing_mps(pose, (speed, w), *there) - PROXIMITY.closing_mps
                is_outside = gap > -radius - swerve_m
                meets |= closing > SURE_MPS and is_outside and gap < PROXIMITY.meet_m - COARSE_M
                nearly |= closing > -SURE_MPS and gap < PROXIMITY.meet_m + COARSE_M
                nearly |= not is_outside
    assert found or not meets
    assert nearly or not found


@settings(max_examples=cases(300))
@given(crowds, poses, st.floats(-0.5, 0.5), st.floats(-1.5, 1.5))
def test_it_stands_for_who_walks_into_it_where_moving_is_no_better(
    crowd: NDArray[np.float64], pose: Pose2D, v: float, w: float
) -> None:
    start = np.array([*pose.as_array(), v, w])
    found = is_walked_into(start, np.column_stack([crowd, np.ones(len(crowd))]), BODY)
    times = np.arange(0.0, PROXIMITY.bump_s + 1e-6, PROXIMITY.brake_dt_s)
    must, may = False, False
    for x, y, vx, vy, radius, _ in crowd:
        ways = [(x + t * vx, y + t * vy, radius) for t in times]
        moved = [integrate_twist(pose, Twist2D(v, 0.0, w), t) for t in times]
        moving = [plain_gap(at, *there) for at, there in zip(moved, ways, strict=True)]
        standing = min(plain_gap(pose, *there) for there in ways)
        assume(min(*moving, standing) > COARSE_M - radius)  # nobody is within the outline
        close, gain = min(moving) - min(0.0, moving[0] - PROXIMITY.nearer_m), min(moving) - standing
        must |= close < -COARSE_M and gain < PROXIMITY.flee_m - COARSE_M
        may |= close < COARSE_M and gain < PROXIMITY.flee_m + COARSE_M
    assert must <= found <= may


def test_who_stands_or_leaves_meets_nobody() -> None:
    ahead = np.array([[0.5, 0.0, -1.0, 0.0, 0.25, 0.1]])
    behind = np.array([[-0.45, 0.0, 1.0, 0.0, 0.25, 0.1]])
    assert would_meet_people(np.array([0.0, 0.0, 0.0, 0.5, 0.0]), ahead, BODY, 0.9, 0.15)
    assert not would_meet_people(np.array([0.0, 0.0, 0.0, 0.0, 1.0]), ahead, BODY, 0.9, 0.15)
    assert not would_meet_people(np.array([0.0, 0.0, 0.0, 0.5, 0.0]), behind, BODY, 0.9, 0.15)
    assert not would_meet_people(np.array([0.0, 0.0, 0.0, 0.5, 0.0]), NOBODY, BODY, 0.9, 0.15)


def standing_at(x: float, y: float, walker: list[float], alone_s: float = math.inf) -> float:
    body = BODY.edge_points, BODY.inscribed_m, BODY.circumscribed_m
    return standing_cost(np.array([[*walker, alone_s]]), body, (x, y), (1.0, 0.0), 2.4)


def test_standing_is_no_excuse_for_being_in_the_way() -> None:
    comes = [5.0, 0.0, -0.8, 0.0, 0.25, 0.05]
    in_the_way = standing_at(0.0, 0.0, comes)
    assert in_the_way > 2.0
    costs = [standing_at(0.0, -0.1 * tenth, comes) for tenth in range(12)]
    # Each decimetre aside is worth something, until nobody is touched.
    assert all(nearer > farther for nearer, farther in pairwise(costs[:8]))
    assert costs[-1] == 0.0
    # Putting it off is not worth much, and who walks away costs nothing.
    assert standing_at(-0.6, 0.0, comes) > 0.75 * in_the_way
    assert standing_at(0.0, 0.0, [5.0, 0.0, 0.8, 0.0, 0.25, 0.05]) == 0.0
    assert standing_at(0.0, 0.0, [5.0, 0.0, 0.0, 0.0, 0.25, 0.05]) == 0.0


def test_who_comes_later_counts_less_since_nobody_knows_whether_they_will() -> None:
    soon, later, much_later = (
        standing_at(0.0, 0.0, [x, 0.0, -0.8, 0.0, 0.25, 0.02], alone_s=9.0) for x in (2.7, 3.9, 6.3)
    )
    assert later == pytest.approx(soon * math.exp(-1.2 / 0.8 / PROXIMITY.fades_s), rel=0.1)
    assert 0.0 < much_later < 0.1 * soon
    # Who comes upon nobody walks on.
    assert standing_at(0.0, 0.0, [6.3, 0.0, -0.8, 0.0, 0.25, 0.02]) > 0.4 * soon


def test_who_comes_upon_somebody_else_before_hardly_counts() -> None:
    comes = [5.0, 0.0, -0.8, 0.0, 0.25, 0.05]
    in_the_way = standing_at(0.0, 0.0, comes)
    assert standing_at(0.0, 0.0, comes, alone_s=7.0) < in_the_way
    assert 0.0 < standing_at(0.0, 0.0, comes, alone_s=5.0) < 0.01 * in_the_way
    assert standing_at(0.0, 0.0, comes, alone_s=0.0) < 1e-3 * in_the_way


def test_who_comes_from_beside_does_not_stop_a_robot_that_does_not_drive_at_them() -> None:
    beside = np.array([[0.0, 0.9, 0.0, -1.2, 0.25, 0.1]])
    ahead_of_it = np.array([[0.5, 0.6, 0.0, -1.2, 0.25, 0.1]])
    start = np.array([0.0, 0.0, 0.0, 0.5, 0.0])
    assert not would_meet_people(start, beside, BODY, 0.9, 0.15)
    assert would_meet_people(start, ahead_of_it, BODY, 0.9, 0.15)


def test_somebody_who_may_swerve_into_the_robots_way_is_braked_for() -> None:
    """Passing 0.14 m from its side they would walk by, unless they turn."""
    passes = np.array([[1.1, 0.56, -0.9, 0.0, 0.22, 0.1]])
    fast, slow = (np.array([0.0, 0.0, 0.0, v, 0.0]) for v in (0.5, 0.1))
    assert would_meet_people(fast, passes, BODY, 0.9, 0.15)
    assert not would_meet_people(slow, passes, BODY, 0.9, 0.15)


def test_a_robot_that_turns_into_somebody_is_to_blame_as_well() -> None:
    beside = np.array([[0.28, -0.38, 0.0, 0.0, 0.22, 0.1]])
    turns, turns_away = (np.array([0.0, 0.0, 0.0, 0.06, w]) for w in (-1.0, 1.0))
    assert would_meet_people(turns, beside, BODY, 0.9, 0.15)
    assert not would_meet_people(turns_away, beside, BODY, 0.9, 0.15)
