"""Compiled foresight among people: how near the robot comes to who walks, moment by moment.

Who walks is a disc that goes on as it does; how far it may be from there grows with time. A state
is x, y, yaw, v, w; everything is in frame `grid` [m].

Source:
    Fiorini, Shiller, Motion Planning in Dynamic Environments Using Velocity Obstacles (1998): what
    counts is where both will be. Here along rollouts, and for some time only: people change their
    minds.
"""

import math

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel
from trolley_planner.costmap.footprint import Body
from trolley_planner.people.moving_obstacles import ROBOT_DT_S

SPREAD_MPS, MOST_SPREAD_M = 0.1, 0.15
"""Discs grow so fast, and by so much."""


MEET_M = 0.06
"""Nearer than this the robot has met somebody,"""


SURE_S = 1.2
"""which counts as touching them within this time; later much may change."""


NEAR_M = 0.4
"""Nearer than this to somebody costs, the more the nearer."""


STANDS_MPS = 0.05
"""Who is not faster than this cannot run into anybody."""


LEAVING = -0.5
"""Nor who drives away from them: the cosine of the angle between."""


BRAKE_DT_S, LONGEST_BRAKE_S = 0.05, 10.0
"""Braking is looked at in such steps, for so long at most."""


FARTHEST = 1.5
"""What somebody counts at most, where 1 is touching: an overlap of half of `NEAR_M`."""


ROBOT_SPREAD_MPS, ROBOT_MOST_SPREAD_M = 0.05, 0.1
"""Discs grow so fast, and by so much: a robot does what it says, but for the error of its pose."""


@kernel
def disc_gap(
    outline: NDArray[np.float64],
    inscribed_m: float,
    away: tuple[float, float],
    turned: tuple[float, float],
    radius_m: float,
) -> float:
    """Return the gap between the robot's outline and a disc [m], negative where they overlap.

    Args:
        outline: (n, 2) points of its edge in `base_link`.
        inscribed_m: radius of a circle within it.
        away: from the robot's origin to the disc's centre.
        turned: cosine and sine of the robot's heading.
        radius_m: of the disc.
    """
    squared = away[0] * away[0] + away[1] * away[1]
    if squared < inscribed_m * inscribed_m:
        return math.sqrt(squared) - inscribed_m - radius_m
    x, y = turned[0] * away[0] + turned[1] * away[1], turned[0] * away[1] - turned[1] * away[0]
    nearest = math.inf
    for index in range(outline.shape[0]):
        dx, dy = outline[index, 0] - x, outline[index, 1] - y
        nearest = min(nearest, dx * dx + dy * dy)
    return math.sqrt(nearest) - radius_m


@kernel
def is_to_blame(v: float, away: tuple[float, float], turned: tuple[float, float]) -> bool:
    """Say whether a robot at speed v that meets who is `away` of it has a part in that."""
    if abs(v) < STANDS_MPS:
        return False
    along = math.copysign(1.0, v) * (turned[0] * away[0] + turned[1] * away[1])
    return along > LEAVING * math.hypot(away[0], away[1])


@kernel
def company(
    walkers: NDArray[np.float64],
    body: tuple[NDArray[np.float64], float, float],
    place: tuple[float, float],
    turned: tuple[float, float],
    v: float,
    time_s: float,
) -> float:
    """Return how near a moving robot is to who walks: 0 far away, 1 touching; infinite if it hits.

    Args:
        walkers: (n, 5) see `Field.walkers`.
        body: points of the outline (n, 2), inscribed and circumscribed radius.
        place: of the robot then.
        turned: cosine and sine of its heading.
        v: its speed.
        time_s: from now.
    """
    outline, inscribed, circumscribed = body
    spread = min(SPREAD_MPS * time_s, MOST_SPREAD_M)
    total = 0.0
    for index in range(walkers.shape[0]):
        away_x = walkers[index, 0] + time_s * walkers[index, 2] - place[0]
        away_y = walkers[index, 1] + time_s * walkers[index, 3] - place[1]
        radius = walkers[index, 4] + spread
        reach = radius + NEAR_M + circumscribed
        if away_x * away_x + away_y * away_y >= reach * reach:
            continue
        away = away_x, away_y
        gap = disc_gap(outline, inscribed, away, turned, radius)
        if gap < MEET_M and time_s <= SURE_S and is_to_blame(v, away, turned):
            return math.inf
        if gap < NEAR_M:
            near = min(1.0 - gap / NEAR_M, FARTHEST)
            total += near * near
    return total


@kernel
def brake_on(
    state: tuple[float, float, float, float, float],
    elapsed_s: float,
    delay_s: float,
    deceleration: float,
) -> tuple[float, float, float, float, float]:
    """Return a state `BRAKE_DT_S` later, on its arc and braking once the delay is over.

    Args:
        state: x, y, yaw, v, w; it moves.
        elapsed_s: until the end of this step.
        delay_s: until the robot brakes.
        deceleration: of the robot [m/s^2].
    """
    x, y, yaw, v, w = state
    if elapsed_s > delay_s:
        slower = max(0.0, abs(v) - deceleration * BRAKE_DT_S)
        w *= slower / abs(v)
        v = math.copysign(slower, v)
    middle, way = yaw + 0.5 * BRAKE_DT_S * w, v * BRAKE_DT_S
    return x + way * math.cos(middle), y + way * math.sin(middle), yaw + w * BRAKE_DT_S, v, w


@kernel
def runs_into(
    body: Body, away: tuple[float, float], turned: tuple[float, float], radius_m: float, v: float
) -> bool:
    """Say whether a robot meets a disc, and is to blame for it.

    Args:
        body: the outline.
        away: from the robot's origin to the disc's centre.
        turned: cosine and sine of the robot's heading.
        radius_m: of the disc.
        v: the robot's speed.
    """
    reach = radius_m + MEET_M + body.circumscribed_m
    if away[0] * away[0] + away[1] * away[1] >= reach * reach:
        return False
    gap = disc_gap(body.edge_points, body.inscribed_m, away, turned, radius_m)
    return gap < MEET_M and is_to_blame(v, away, turned)


@kernel
def would_meet(
    start: NDArray[np.float64],
    walkers: NDArray[np.float64],
    body: Body,
    deceleration: float,
    delay_s: float,
) -> bool:
    """Say whether a robot that brakes after a delay still meets who walks on, or who stops.

    Args:
        start: (5,) with the velocity that is about to be commanded.
        walkers: (n, 5) see `Field.walkers`.
        body: the outline.
        deceleration: of the robot [m/s^2].
        delay_s: until it brakes.
    """
    if walkers.shape[0] == 0:
        return False
    state, elapsed = (start[0], start[1], start[2], start[3], start[4]), 0.0
    while abs(state[3]) >= STANDS_MPS and elapsed < LONGEST_BRAKE_S:
        elapsed += BRAKE_DT_S
        state = brake_on(state, elapsed, delay_s, deceleration)
        turned = math.cos(state[2]), math.sin(state[2])
        for index in range(walkers.shape[0]):
            for moves in (0.0, elapsed):
                away = (
                    walkers[index, 0] + moves * walkers[index, 2] - state[0],
                    walkers[index, 1] + moves * walkers[index, 3] - state[1],
                )
                if runs_into(body, away, turned, walkers[index, 4], state[3]):
                    return True
    return False


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
    spread = min(ROBOT_SPREAD_MPS * time_s, ROBOT_MOST_SPREAD_M)
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
