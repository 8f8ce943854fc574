"""The cost of being near people and robots, one pose at a time: the slow twin of the rollouts'."""

import math

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel
from trolley_planner.control.proximity import (
    PROXIMITY,
    disc_gap,
    is_to_blame,
    people_proximity_cost,
)
from trolley_planner.people.moving_obstacles import ROBOT_DT_S


@kernel
def robots_proximity_cost(
    robots: NDArray[np.float64],
    body: tuple[NDArray[np.float64], float, float],
    place: tuple[float, float],
    turned: tuple[float, float],
    v: float,
    time_s: float,
) -> float:
    """Return the cost of being near other robots, like `people_proximity_cost`.

    Args:
        robots: (n, steps, 3) x, y, radius, see `Field.robots`.
        body: points of the outline (n, 2), inscribed and circumscribed radius.
        place: of the robot then.
        turned: cosine and sine of its heading.
        v: its speed.
        time_s: from now.
    """
    outline, inscribed, circumscribed = body
    step = min(round(time_s / ROBOT_DT_S), robots.shape[1] - 1)
    spread = min(PROXIMITY.robot_spread_mps * time_s, PROXIMITY.robot_most_spread_m)
    nearest = PROXIMITY.near_m
    for index in range(robots.shape[0]):
        away = robots[index, step, 0] - place[0], robots[index, step, 1] - place[1]
        radius = robots[index, step, 2] + spread
        reach = radius + PROXIMITY.near_m + circumscribed
        if away[0] * away[0] + away[1] * away[1] >= reach * reach:
            continue
        gap = disc_gap(outline, inscribed, away, turned, radius)
        if gap < PROXIMITY.meet_m and time_s <= PROXIMITY.sure_s and is_to_blame(v, away, turned):
            return math.inf
        nearest = min(nearest, gap)
    near = min(1.0 - nearest / PROXIMITY.near_m, PROXIMITY.most_cost)
    return near * near


@kernel
def proximity_cost(
    walkers: NDArray[np.float64],
    robots: NDArray[np.float64],
    body: tuple[NDArray[np.float64], float, float],
    then: tuple[tuple[float, float], tuple[float, float], float],
    v: float,
) -> float:
    """Return the cost of being near people and other robots.

    Args:
        walkers: (n, 7) see `Field.walkers`.
        robots: (n, steps, 3) see `Field.robots`.
        body: points of the outline (n, 2), inscribed and circumscribed radius.
        then: place, cosine and sine of the heading, and the time from now [s].
        v: its speed.
    """
    place, turned, time_s = then
    near = people_proximity_cost(walkers, body, place, turned, v, time_s)
    if robots.shape[0] > 0:
        near += robots_proximity_cost(robots, body, place, turned, v, time_s)
    return near
