"""Proximity to people and other robots along the robot's motion.

A person is a disc that keeps its velocity and grows with time, the faster the less sure it is.
Other robots are a few discs each, with a place for every `ROBOT_DT_S` from now on; they may come
some way short of where they mean to be. A state is x, y, yaw, v, w; everything is in frame `grid`
[m].

Source:
    Fiorini, Shiller, Motion Planning in Dynamic Environments Using Velocity Obstacles (1998): what
    counts is where both will be. Here along rollouts, and for some time only: people change their
    minds.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel
from trolley_planner.costmap.footprint import Body
from trolley_planner.people.moving_obstacles import ROBOT_DT_S


class ProximityParams(NamedTuple):
    """How close is too close to people and other robots; all by hand."""

    most_spread_m: float = 0.15
    """Most that a person's disc grows with time; it grows as fast as their velocity is uncertain
    [m]."""
    robot_spread_mps: float = 0.05
    """Rate at which the disc of another robot grows, for the error of its pose [m/s]."""
    robot_most_spread_m: float = 0.1
    """Most that the disc of another robot grows with time [m]."""
    meet_m: float = 0.06
    """Gap below which the robot and a disc count as colliding [m]."""
    sure_s: float = 1.2
    """Time ahead within which a collision is ruled out; people may change course later [s]."""
    near_m: float = 0.4
    """Gap below which being near has a cost, which grows as the gap closes [m]."""
    standing_mps: float = 0.05
    """Speed below which the robot stands [m/s]."""
    closing_mps: float = 0.06
    """Speed of the robot towards a disc above which it is to blame for a collision [m/s]."""
    touch_m: float = 0.18
    """Gap below which being in the way costs more, weighted by `touch` [m]."""
    touch: float = 120.0
    """Cost of the square of what a gap lacks of `touch_m` [1/m^2]."""
    moving: float = 3.0
    """Increase of that cost per speed of the robot [s/m]."""
    stand_s: float = 6.0
    """Time that the robot is taken to stand at the end of a rollout [s]."""
    pass_s: float = 0.7
    """Time for which a person who passes the standing robot counts as near it [s]."""
    right_m: float = 0.02
    """Distance that a walking person is taken to keep to their right by then, so that of two equal
    sides the robot chooses the one that people expect [m]."""
    fades_s: float = 1.5
    """Time ahead after which being near people counts 1/e as much who come upon others: nobody can
    tell where they will be by then [s]."""
    sure_later_s: float = 8.0
    """Time after which who comes upon nobody, as in a corridor, counts 1/e as much where they come
    later than the robot stands [s]."""
    astray_s: float = 0.5
    """Time after coming upon somebody else from which on a person counts 1/e as much [s]."""
    swerve_mps2: float = 1.0
    """Acceleration with which people may leave their course while the robot brakes; their velocity
    is known some tenths of a second late [m/s^2]."""
    forgotten: float = 7.0
    """Who counts for less than e to the minus this is not looked at."""
    bump_s: float = 0.8
    """Time ahead for which the robot looks whether somebody walks into it [s]."""
    nearer_m: float = 0.01
    """Who touches the robot already counts only if they come nearer by this [m]."""
    flee_m: float = 0.03
    """Distance by which moving must keep them farther off than standing does [m]."""
    brake_dt_s: float = 0.05
    """Time step of the braking check [s]."""
    longest_brake_s: float = 10.0
    """Time after which the braking check ends [s]."""
    most_cost: float = 1.5
    """Highest cost of one person, where touching costs 1: an overlap by half of `near_m`."""


PROXIMITY = ProximityParams()


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
    return nearest_point(outline, away, turned)[2] - radius_m


@kernel
def nearest_point(
    outline: NDArray[np.float64], away: tuple[float, float], turned: tuple[float, float]
) -> tuple[float, float, float]:
    """Return the point of an outline that is nearest to a place, in `base_link`, and how far off.

    Args:
        outline: (n, 2) points of the robot's edge in `base_link`.
        away: from the robot's origin to the place.
        turned: cosine and sine of the robot's heading.
    """
    x, y = turned[0] * away[0] + turned[1] * away[1], turned[0] * away[1] - turned[1] * away[0]
    nearest, found = math.inf, 0
    for index in range(outline.shape[0]):
        dx, dy = outline[index, 0] - x, outline[index, 1] - y
        if dx * dx + dy * dy < nearest:
            nearest, found = dx * dx + dy * dy, index
    return outline[found, 0], outline[found, 1], math.sqrt(nearest)


@kernel
def is_to_blame(v: float, away: tuple[float, float], turned: tuple[float, float]) -> bool:
    """Say whether a robot at speed v comes nearer by itself to what is `away` from it."""
    closing = v * (turned[0] * away[0] + turned[1] * away[1])
    return closing > PROXIMITY.closing_mps * math.hypot(away[0], away[1])


@kernel
def gap_cost(gap_m: float, v: float) -> float:
    """Return the cost of a gap to a person, for a robot at speed v."""
    total = 0.0
    if gap_m < PROXIMITY.near_m:
        near = min(1.0 - gap_m / PROXIMITY.near_m, PROXIMITY.most_cost)
        total += near * near
    if gap_m < PROXIMITY.touch_m:
        # Not limited: the less of the robot is in the way, the better.
        deep_m = PROXIMITY.touch_m - gap_m
        total += PROXIMITY.touch * deep_m * deep_m * (1.0 + PROXIMITY.moving * abs(v))
    return total


@kernel
def fading(time_s: float, alone_s: float) -> float:
    """Return the logarithm by which the cost of being near a person falls, so long from now.

    Args:
        time_s: from now.
        alone_s: until they come upon somebody else; infinite if they do not: they walk on as now.
    """
    return 0.0 if math.isinf(alone_s) else time_s / PROXIMITY.fades_s


@kernel
def people_proximity_cost(
    walkers: NDArray[np.float64],
    body: tuple[NDArray[np.float64], float, float],
    place: tuple[float, float],
    turned: tuple[float, float],
    v: float,
    time_s: float,
) -> float:
    """Return the cost of being near people: 0 far away, more than 1 touching them now.

    It is infinite for a collision that the robot is to blame for.

    Args:
        walkers: (n, 7) see `Field.walkers`.
        body: points of the outline (n, 2), inscribed and circumscribed radius.
        place: of the robot then.
        turned: cosine and sine of its heading.
        v: its speed.
        time_s: from now.
    """
    outline, inscribed, circumscribed = body
    total = 0.0
    for index in range(walkers.shape[0]):
        away_x = walkers[index, 0] + time_s * walkers[index, 2] - place[0]
        away_y = walkers[index, 1] + time_s * walkers[index, 3] - place[1]
        radius = walkers[index, 4] + min(walkers[index, 5] * time_s, PROXIMITY.most_spread_m)
        reach = radius + PROXIMITY.near_m + circumscribed
        if away_x * away_x + away_y * away_y >= reach * reach:
            continue
        away = away_x, away_y
        gap = disc_gap(outline, inscribed, away, turned, radius)
        if gap < PROXIMITY.meet_m and time_s <= PROXIMITY.sure_s and is_to_blame(v, away, turned):
            return math.inf
        left = math.exp(-fading(time_s, walkers[index, 6]))
        total += left * gap_cost(gap, v)
    return total


@kernel
def standing_cost(
    walkers: NDArray[np.float64],
    body: tuple[NDArray[np.float64], float, float],
    place: tuple[float, float],
    turned: tuple[float, float],
    time_s: float,
) -> float:
    """Return the cost of standing from some time on where people come along, as seconds near them.

    Standing is no excuse for being in the way. Each counts once, where they come nearest; the less,
    the longer before that they have come upon somebody else: in a crowd nobody walks on as now, and
    a robot that fled from all their straight lines would not get through.

    Args:
        walkers: (n, 7) see `Field.walkers`.
        body: points of the outline (n, 2), inscribed and circumscribed radius.
        place: of the robot.
        turned: cosine and sine of its heading.
        time_s: from now, when it comes to stand there.
    """
    total = 0.0
    for index in range(walkers.shape[0]):
        vx, vy = walkers[index, 2], walkers[index, 3]
        squared = vx * vx + vy * vy
        if squared == 0.0:
            continue
        away_x = walkers[index, 0] + time_s * vx - place[0]
        away_y = walkers[index, 1] + time_s * vy - place[1]
        later = min(max(-(away_x * vx + away_y * vy) / squared, 0.0), PROXIMITY.stand_s)
        alone_s = walkers[index, 6]
        astray = max(time_s + later - alone_s, 0.0) / PROXIMITY.astray_s
        if math.isinf(alone_s):
            astray = later / PROXIMITY.sure_later_s
        if fading(time_s + later, alone_s) + astray > PROXIMITY.forgotten:
            continue
        right = PROXIMITY.right_m / math.sqrt(squared)
        there = place[0] - right * vy, place[1] + right * vx
        one = walkers[index : index + 1]
        near = people_proximity_cost(one, body, there, turned, 0.0, time_s + later)
        total += near * math.exp(-astray)
    return total * PROXIMITY.pass_s


@kernel
def brake_on(
    state: tuple[float, float, float, float, float],
    elapsed_s: float,
    delay_s: float,
    deceleration: float,
) -> tuple[float, float, float, float, float]:
    """Return a state `PROXIMITY.brake_dt_s` later, on its arc and braking once the delay is over.

    Args:
        state: x, y, yaw, v, w; it moves.
        elapsed_s: until the end of this step.
        delay_s: until the robot brakes.
        deceleration: of the robot [m/s^2].
    """
    x, y, yaw, v, w = state
    if elapsed_s > delay_s:
        slower = max(0.0, abs(v) - deceleration * PROXIMITY.brake_dt_s)
        w *= slower / abs(v)
        v = math.copysign(slower, v)
    middle, distance = yaw + 0.5 * PROXIMITY.brake_dt_s * w, v * PROXIMITY.brake_dt_s
    return (
        x + distance * math.cos(middle),
        y + distance * math.sin(middle),
        yaw + w * PROXIMITY.brake_dt_s,
        v,
        w,
    )


@kernel
def runs_into(
    body: Body,
    away: tuple[float, float],
    turned: tuple[float, float],
    radius_m: float,
    moves: tuple[float, float],
) -> bool:
    """Say whether a robot hits a disc, and is to blame for it: its nearest point comes nearer.

    Args:
        body: the outline.
        away: from the robot's origin to the disc's centre.
        turned: cosine and sine of the robot's heading.
        radius_m: of the disc.
        moves: the robot's speed and turn rate.
    """
    reach = radius_m + PROXIMITY.meet_m + body.circumscribed_m
    squared = away[0] * away[0] + away[1] * away[1]
    if squared >= reach * reach:
        return False
    arm_x, arm_y, distance = nearest_point(body.edge_points, away, turned)
    is_outside = squared >= body.inscribed_m * body.inscribed_m
    if is_outside and distance - radius_m >= PROXIMITY.meet_m:
        return False
    x, y = turned[0] * away[0] + turned[1] * away[1], turned[0] * away[1] - turned[1] * away[0]
    v, w = moves
    closing = (v - w * arm_y) * x + w * arm_x * y
    return closing > PROXIMITY.closing_mps * max(math.sqrt(squared), 1e-9)


@kernel
def would_meet_people(
    start: NDArray[np.float64],
    walkers: NDArray[np.float64],
    body: Body,
    deceleration: float,
    delay_s: float,
) -> bool:
    """Say whether a robot that brakes after a delay still hits people who walk on, or who stop.

    The last word on each command, so that the robot is never the one that closes in: by the time
    that it stands nobody is in its reach who could have come there, swerving as people do.

    Args:
        start: (5,) with the velocity that is about to be commanded.
        walkers: (n, 7) see `Field.walkers`.
        body: the outline.
        deceleration: of the robot [m/s^2].
        delay_s: until it brakes.
    """
    if walkers.shape[0] == 0:
        return False
    state, elapsed = (start[0], start[1], start[2], start[3], start[4]), 0.0
    while abs(state[3]) >= PROXIMITY.standing_mps and elapsed < PROXIMITY.longest_brake_s:
        elapsed += PROXIMITY.brake_dt_s
        state = brake_on(state, elapsed, delay_s, deceleration)
        turned = math.cos(state[2]), math.sin(state[2])
        swerve_m = 0.5 * PROXIMITY.swerve_mps2 * elapsed * elapsed
        for index in range(walkers.shape[0]):
            for walked_s in (0.0, elapsed):
                away = (
                    walkers[index, 0] + walked_s * walkers[index, 2] - state[0],
                    walkers[index, 1] + walked_s * walkers[index, 3] - state[1],
                )
                radius_m = walkers[index, 4] + swerve_m
                if runs_into(body, away, turned, radius_m, (state[3], state[4])):
                    return True
    return False


@kernel
def is_walked_into(start: NDArray[np.float64], walkers: NDArray[np.float64], body: Body) -> bool:
    """Say whether people who walk on soon touch a moving robot that had better stand.

    It had where moving keeps it hardly farther off. Those who touch it already count only if they
    come nearer.

    Args:
        start: (5,) with the velocity that is about to be commanded.
        walkers: (n, 7) see `Field.walkers`.
        body: the outline.
    """
    still = start.copy()
    still[3] = still[4] = 0.0
    for index in range(walkers.shape[0]):
        now_m, moving_m = least_gap(start, walkers[index], body)
        touches = moving_m < min(0.0, now_m - PROXIMITY.nearer_m)
        if touches and moving_m < least_gap(still, walkers[index], body)[1] + PROXIMITY.flee_m:
            return True
    return False


@kernel
def least_gap(
    start: NDArray[np.float64], walker: NDArray[np.float64], body: Body
) -> tuple[float, float]:
    """Return the gap to a person now and the least one within `bump_s`, as both move on [m].

    It is infinite where they are far apart.

    Args:
        start: (5,) of the robot, which keeps its velocity.
        walker: (7,) see `Field.walkers`.
        body: the outline.
    """
    state = (start[0], start[1], start[2], start[3], start[4])
    reach, dt_s = walker[4] + body.circumscribed_m, PROXIMITY.brake_dt_s
    now_m = least_m = math.inf
    for step in range(round(PROXIMITY.bump_s / dt_s) + 1):
        away = (
            walker[0] + step * dt_s * walker[2] - state[0],
            walker[1] + step * dt_s * walker[3] - state[1],
        )
        if away[0] * away[0] + away[1] * away[1] < reach * reach:
            turned = math.cos(state[2]), math.sin(state[2])
            gap_m = disc_gap(body.edge_points, body.inscribed_m, away, turned, walker[4])
            now_m = gap_m if step == 0 else now_m
            least_m = min(least_m, gap_m)
        state = brake_on(state, 0.0, math.inf, 0.0)
    return now_m, least_m


@kernel
def would_meet_robots(
    start: NDArray[np.float64],
    robots: NDArray[np.float64],
    body: Body,
    deceleration: float,
    delay_s: float,
) -> bool:
    """Say whether a robot that brakes after a delay still hits another one, moving or stopping.

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
    while abs(state[3]) >= PROXIMITY.standing_mps and elapsed < PROXIMITY.longest_brake_s:
        elapsed += PROXIMITY.brake_dt_s
        state = brake_on(state, elapsed, delay_s, deceleration)
        turned = math.cos(state[2]), math.sin(state[2])
        later = min(round(elapsed / ROBOT_DT_S), robots.shape[1] - 1)
        for index in range(robots.shape[0]):
            for step in (0, later):
                away = robots[index, step, 0] - state[0], robots[index, step, 1] - state[1]
                if runs_into(body, away, turned, robots[index, step, 2], (state[3], state[4])):
                    return True
    return False
