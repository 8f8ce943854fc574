"""Compiled foresight among robots: how near this one comes to others that say what they drive.

Each of them is a few discs with a place for every `ROBOT_DT_S` from now on; it may come some way
short of where it means to be. A state is x, y, yaw, v, w; everything is in frame `grid` [m].
"""

import math

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel
from trolley_planner.kernels.clearance import Body
from trolley_planner.kernels.walkers import (
    BRAKE_DT_S,
    FARTHEST,
    LONGEST_BRAKE_S,
    MEET_M,
    NEAR_M,
    ROBOT_DT_S,
    STANDS_MPS,
    SURE_S,
    brake_on,
    company,
    disc_gap,
    is_to_blame,
    runs_into,
)

SPREAD_MPS, MOST_SPREAD_M = 0.05, 0.1
"""Discs grow so fast, and by so much: a robot does what it says, but for the error of its pose."""


@kernel
def company_of_robots(
    robots: NDArray[np.float64],
    body: tuple[NDArray[np.float64], float, float],
    place: tuple[float, float],
    turned: tuple[float, float],
    v: float,
    time_s: float,
) -> float:
    """Return how near a moving robot is to others: 0 far away, 1 touching; infinite if it hits.

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
    spread = min(SPREAD_MPS * time_s, MOST_SPREAD_M)
    nearest = NEAR_M
    for index in range(robots.shape[0]):
        away = robots[index, step, 0] - place[0], robots[index, step, 1] - place[1]
        radius = robots[index, step, 2] + spread
        reach = radius + NEAR_M + circumscribed
        if away[0] * away[0] + away[1] * away[1] >= reach * reach:
            continue
        gap = disc_gap(outline, inscribed, away, turned, radius)
        if gap < MEET_M and time_s <= SURE_S and is_to_blame(v, away, turned):
            return math.inf
        nearest = min(nearest, gap)
    near = min(1.0 - nearest / NEAR_M, FARTHEST)
    return near * near


@kernel
def company_of_all(
    walkers: NDArray[np.float64],
    robots: NDArray[np.float64],
    body: tuple[NDArray[np.float64], float, float],
    then: tuple[tuple[float, float], tuple[float, float], float],
    v: float,
) -> float:
    """Return how near a moving robot is to who walks and to other robots, as `company`.

    Args:
        walkers: (n, 5) see `Field.walkers`.
        robots: (n, steps, 3) see `Field.robots`.
        body: points of the outline (n, 2), inscribed and circumscribed radius.
        then: place, cosine and sine of the heading, and the time from now [s].
        v: its speed.
    """
    place, turned, time_s = then
    near = company(walkers, body, place, turned, v, time_s)
    if robots.shape[0] > 0:
        near += company_of_robots(robots, body, place, turned, v, time_s)
    return near


@kernel
def would_meet_robots(
    start: NDArray[np.float64],
    robots: NDArray[np.float64],
    body: Body,
    deceleration: float,
    delay_s: float,
) -> bool:
    """Say whether a robot that brakes after a delay still meets another, or one that stops.

    Args:
        start: (5,) with the velocity that is about to be commanded.
        robots: (n, steps, 3) see `Field.robots`.
        body: the outline.
        deceleration: of the robot [m/s^2].
        delay_s: until it brakes.
    """
    if robots.shape[0] == 0:
        return False
    state, elapsed = (start[0], start[1], start[2], start[3], start[4]), 0.0
    while abs(state[3]) >= STANDS_MPS and elapsed < LONGEST_BRAKE_S:
        elapsed += BRAKE_DT_S
        state = brake_on(state, elapsed, delay_s, deceleration)
        turned = math.cos(state[2]), math.sin(state[2])
        later = min(round(elapsed / ROBOT_DT_S), robots.shape[1] - 1)
        for index in range(robots.shape[0]):
            for step in (0, later):
                away = robots[index, step, 0] - state[0], robots[index, step, 1] - state[1]
                if runs_into(body, away, turned, robots[index, step, 2], state[3]):
                    return True
    return False
