"""Foresight among robots: where both will be counts, and only who drives into it is to blame."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from support.flatland import BOX
from support.proximity import robots_proximity_cost

from trolley_planner.control.proximity import (
    would_meet_people,
    would_meet_robots,
)
from trolley_planner.costmap.footprint import Footprint
from trolley_planner.fleet.neighbours import NEIGHBOURS
from trolley_planner.people.moving_obstacles import ROBOT_DT_S

BODY = Footprint.from_polygon(BOX).body
WALKED = BODY.few_points, BODY.inscribed_m, BODY.circumscribed_m
DECELERATION, DELAY_S = 0.9, 0.15


def track(x: float, y: float, vx: float = 0.0, vy: float = 0.0, radius: float = 0.2) -> np.ndarray:
    times = ROBOT_DT_S * np.arange(NEIGHBOURS.track_steps)
    return np.stack(
        [x + vx * times, y + vy * times, np.full(NEIGHBOURS.track_steps, radius)], axis=1
    )[None]


def start(v: float, w: float = 0.0) -> np.ndarray:
    return np.array([0.0, 0.0, 0.0, v, w])


@given(st.floats(-2.0, 2.0), st.floats(-2.0, 2.0), st.floats(0.1, 0.5))
def test_who_meets_one_that_stands_meets_a_walker_there_as_well(
    x: float, y: float, v: float
) -> None:
    """And farther off, too, since a walker may swerve."""
    walker = np.array([[x, y, 0.0, 0.0, 0.2]])
    meets_robot = would_meet_robots(start(v), track(x, y), BODY, DECELERATION, DELAY_S)
    assert would_meet_people(start(v), walker, BODY, DECELERATION, DELAY_S) or not meets_robot


def test_who_stands_meets_nobody_and_nobody_is_met_where_there_is_none() -> None:
    ahead, none = track(0.5, 0.0), np.empty((0, 1, 3))
    assert would_meet_robots(start(0.5), ahead, BODY, DECELERATION, DELAY_S)
    assert not would_meet_robots(start(0.0, 1.0), ahead, BODY, DECELERATION, DELAY_S)
    assert not would_meet_robots(start(0.5), track(-0.5, 0.0), BODY, DECELERATION, DELAY_S)
    assert not would_meet_robots(start(0.5), none, BODY, DECELERATION, DELAY_S)


def test_what_counts_is_where_both_will_be_then() -> None:
    crossing, turned = track(0.5, -0.5, vy=0.5), (1.0, 0.0)
    # After a second it is right before the robot that went on, and far from one that did not.
    near = robots_proximity_cost(crossing, WALKED, (0.3, 0.0), turned, 0.5, 1.0)
    away = robots_proximity_cost(crossing, WALKED, (-0.5, 0.0), turned, 0.5, 1.0)
    assert math.isinf(near)
    assert away == 0.0


@given(st.floats(0.2, 2.0))
def test_the_nearer_the_dearer(x: float) -> None:
    nearer, farther = (
        robots_proximity_cost(track(at, 0.0), WALKED, (0.0, 0.0), (1.0, 0.0), 0.0, 0.1)
        for at in (x, x + 0.2)
    )
    assert 0.0 <= farther <= nearer
