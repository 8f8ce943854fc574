"""How the robot moves: its limits, a step along an arc, and how it stops.

Everything is in frame `grid` [m], times in seconds. A state is x, y, yaw, v, w.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel
from trolley_planner.costmap.footprint import Body, Field, clearance_at

DT_S = 0.1
"""Time step of rollouts [s]."""


class Limits(NamedTuple):
    """The robot's present limits."""

    max_speed: float
    """[m/s]."""
    max_reverse: float
    """Highest speed backwards [m/s]."""
    max_turn: float
    """[rad/s]."""
    acceleration: float
    """[m/s^2]."""
    deceleration: float
    """[m/s^2]."""
    turn_acceleration: float
    """[rad/s^2]."""
    slow_speed: float
    """Speed right beside obstacles [m/s]."""
    caution_m: float
    """Clearance below which the robot slows down."""
    clearance_m: float
    """The footprint keeps at least this far from everything."""
    dt: float
    """Time step [s]."""


class RobotMotionParams(NamedTuple):
    """How the robot follows commands and brakes; by hand where no source is given."""

    delay_s: float = 0.15
    """Time from a command to what the wheels make of it, the age of the scan included."""
    braking_dt_s: float = 0.04
    """Time step of the braking check."""
    longest_braking_s: float = 10.0
    """The braking check ends after this time."""


ROBOT_MOTION = RobotMotionParams()


@kernel
def zone_speed(field: Field, x: float, y: float) -> float:
    """Return the limit of the speed zones at a point [m/s]."""
    rows, cols = field.speed_mps.shape
    if rows == 1 and cols == 1:
        return field.speed_mps[0, 0]
    row = min(max(math.floor(y / field.cell_m), 0), rows - 1)
    col = min(max(math.floor(x / field.cell_m), 0), cols - 1)
    return field.speed_mps[row, col]


@kernel
def caution_speed(limits: Limits, clearance_m: float) -> float:
    """Return the speed limit of caution beside obstacles [m/s].

    It rises evenly with the clearance, but is never less than what the robot can brake from in it.
    """
    room = max(0.0, clearance_m - limits.clearance_m)
    share = min(room / (limits.caution_m - limits.clearance_m), 1.0)
    slow = min(limits.slow_speed, limits.max_speed)
    late = limits.deceleration * ROBOT_MOTION.delay_s
    stoppable = math.sqrt(late * late + 2.0 * limits.deceleration * room) - late
    return min(limits.max_speed, max(slow + share * (limits.max_speed - slow), stoppable))


@kernel
def allowed_speed(field: Field, limits: Limits, x: float, y: float, clearance_m: float) -> float:
    """Return the least speed limit at a point: own, zone, caution beside obstacles [m/s]."""
    return min(caution_speed(limits, clearance_m), zone_speed(field, x, y))


@kernel
def followed(
    v: float, w: float, wanted: tuple[float, float], limits: Limits, allowed: float
) -> tuple[float, float]:
    """Return v and w after a step towards what is wanted, as fast as the robot may change them.

    Slowing down for `allowed` has the same limit as any other braking.
    """
    faster, slower = limits.acceleration * limits.dt, limits.deceleration * limits.dt
    wanted_v = min(max(wanted[0], -min(limits.max_reverse, allowed)), allowed)
    up = faster if v >= 0.0 else slower
    down = slower if v > 0.0 else faster
    change = limits.turn_acceleration * limits.dt
    wanted_w = min(max(wanted[1], -limits.max_turn), limits.max_turn)
    return (
        min(max(wanted_v, v - down), v + up),
        min(max(wanted_w, w - change), w + change),
    )


@kernel
def advance(state: NDArray[np.float64], dt: float) -> None:
    """Move the state along its arc, by the heading in the middle of the step."""
    middle = state[2] + 0.5 * dt * state[4]
    state[0] += state[3] * dt * math.cos(middle)
    state[1] += state[3] * dt * math.sin(middle)
    state[2] += state[4] * dt


@kernel
def moved(
    x: float, y: float, turned: tuple[float, float], twist: tuple[float, float], dt: float
) -> tuple[float, float, float, float]:
    """Return x, y and the cosine and sine of the heading after a step along an arc, as `advance`.

    Args:
        x: [m].
        y: [m].
        turned: cosine and sine of the heading before.
        twist: v and w.
        dt: [s].
    """
    half = 0.5 * dt * twist[1]
    # Series do for half a step's turn: 1e-9 at 0.2 rad, and no sine is computed.
    square = half * half
    sin = half * (1.0 - square / 6.0 * (1.0 - square / 20.0))
    cos = 1.0 - 0.5 * square * (1.0 - square / 12.0 * (1.0 - square / 30.0))
    middle_cos, middle_sin = turned[0] * cos - turned[1] * sin, turned[1] * cos + turned[0] * sin
    distance = twist[0] * dt
    return (
        x + distance * middle_cos,
        y + distance * middle_sin,
        middle_cos * cos - middle_sin * sin,
        middle_sin * cos + middle_cos * sin,
    )


@kernel
def trace_into(
    out_poses: NDArray[np.float32],
    controls: NDArray[np.float64],
    start: NDArray[np.float64],
    dt: float,
) -> None:
    """Write the poses (steps + 1, 3) that a sequence of commands leads through."""
    state = start.copy()
    for step in range(controls.shape[0] + 1):
        for axis in range(3):
            out_poses[step, axis] = state[axis]
        if step < controls.shape[0]:
            state[3], state[4] = controls[step, 0], controls[step, 1]
            advance(state, dt)


@kernel
def stopping_clearance(
    start: NDArray[np.float64],
    field: Field,
    body: Body,
    limits: Limits,
) -> tuple[float, float]:
    """Return the smallest clearance until the robot stands, if it brakes after `delay_s`.

    Args:
        start: (5,) with the velocity that is about to be commanded.
        field: the local costmap.
        body: the outline.
        limits: braking.

    Returns:
        The clearance now and the smallest until it stands [m].
    """
    state = start.copy()
    enough = limits.clearance_m + 0.05
    now = clearance_at(field, body, state[0], state[1], state[2], enough)
    smallest = now
    dt = ROBOT_MOTION.braking_dt_s
    elapsed = 0.0
    while elapsed < ROBOT_MOTION.longest_braking_s:
        if elapsed >= ROBOT_MOTION.delay_s:
            v, w = abs(state[3]), abs(state[4])
            slower = max(0.0, v - limits.deceleration * dt)
            # On its arc as long as it moves; a turn in place has its own brake.
            share = slower / v if v > 1e-6 else 0.0
            turn = w * share if v > 1e-6 else max(0.0, w - limits.turn_acceleration * dt)
            state[3] = math.copysign(slower, state[3])
            state[4] = math.copysign(turn, state[4])
        if state[3] == 0.0 and state[4] == 0.0:
            break
        advance(state, dt)
        elapsed += dt
        clearance = clearance_at(field, body, state[0], state[1], state[2], enough)
        smallest = min(smallest, clearance)
    return now, smallest
