"""The cheap controller: regulated pure pursuit, and plain motions where that would touch."""

import math

import numpy as np
from numpy.typing import NDArray

from trolley.config import PlannerConfig
from trolley.geometry import Twist2D
from trolley.jit import kernel
from trolley_planner.control.controller import DT_S, Motion, first_step, limits_here, state_of
from trolley_planner.control.local_costmap import Window
from trolley_planner.control.mppi import DESCENTS, PRICES, PRIMITIVES, best_plain_into
from trolley_planner.control.rollout import (
    COLLISION,
    Limits,
    Target,
    advance,
    allowed_speed,
    downhill_point,
    followed,
    rollout,
    trace_into,
)
from trolley_planner.costmap.footprint import Body, Field, clearance_at
from trolley_planner.sensing.beams import wrapped

SHARES = (1.0, 0.6, 0.35)
"""Of the usual lookahead: nearer points are tried where the farther one leads over something."""


LOOK_S = 1.0
"""The point lies so far ahead in time,"""


LOOK_LEAST_M, LOOK_MOST_M = 0.35, 1.2
"""and within these lengths."""


TURN_IN_PLACE = 0.7
"""Farther off its heading the robot turns before it drives [rad]."""


TIGHT_M = 0.6
"""Tighter arcs than of this radius are driven slower in proportion."""


class Pursuit:
    """Steers for a point ahead: a fiftieth of the work of `Mppi`, and less foresight.

    Args:
        config: horizon.
    """

    def __init__(self, config: PlannerConfig) -> None:
        self._controls = np.zeros((max(5, round(config.horizon_s / DT_S)), 2))
        self.reset()

    def reset(self) -> None:
        """Forget what the last command led to."""
        self.trajectory = np.empty((0, 3), dtype=np.float32)

    def command(
        self, motion: Motion, window: Window, limits: Limits, target: Target, elapsed_s: float
    ) -> Twist2D | None:
        """Return the velocity to drive now; see `Controller`."""
        limits = limits_here(limits, window, motion.pose)
        start, field, body = state_of(motion), window.field, window.body
        world = (field, body, limits, target, PRICES)
        for share in SHARES:
            pursue(self._controls, start, (field, body, limits, target), share)
            price = rollout(self._controls, start, *world)
            if price < COLLISION:
                break
        else:
            price = best_plain_into(self._controls, start, world, (DESCENTS, PRIMITIVES))
        self.trajectory = np.empty((len(self._controls) + 1, 3), dtype=np.float32)
        trace_into(self.trajectory, self._controls, start, DT_S)
        return None if price >= COLLISION else first_step(motion, self._controls, elapsed_s)


@kernel
def pursue(
    out_controls: NDArray[np.float64],
    start: NDArray[np.float64],
    world: tuple[Field, Body, Limits, Target],
    share: float,
) -> None:
    """Write the commands that follow the point ahead.

    Args:
        out_controls: (steps, 2), overwritten.
        start: (5,).
        world: window, outline, limits and where the path leads next.
        share: of the usual lookahead; less cuts corners less.
    """
    field, body, limits, target = world
    state = start.copy()
    for step in range(out_controls.shape[0]):
        clearance = clearance_at(field, body, state[0], state[1], state[2], limits.caution_m)
        allowed = allowed_speed(field, limits, state[0], state[1], clearance)
        look = share * min(max(LOOK_S * abs(state[3]), LOOK_LEAST_M), LOOK_MOST_M)
        x, y = downhill_point(field, state[0], state[1], look)
        dx, dy = x - state[0], y - state[1]
        distance = math.hypot(dx, dy)
        wanted_v, wanted_w = 0.0, 0.0
        if distance > field.coarse_m:
            bearing = wrapped(math.atan2(dy, dx) - state[2])
            if abs(bearing) > TURN_IN_PLACE:
                rate = math.sqrt(1.6 * limits.turn_acceleration * abs(bearing))
                wanted_w = math.copysign(min(rate, limits.max_turn), bearing)
            else:
                curvature = 2.0 * math.sin(bearing) / distance
                wanted_v = regulated(allowed, curvature, limits)
                if not target.goes_on:
                    left = math.hypot(target.x - state[0], target.y - state[1])
                    wanted_v = min(wanted_v, math.sqrt(limits.deceleration * left) + 0.02)
                wanted_w = max(state[3], 0.05) * curvature
        state[3], state[4] = followed(state[3], state[4], (wanted_v, wanted_w), limits, allowed)
        out_controls[step, 0], out_controls[step, 1] = state[3], state[4]
        advance(state, limits.dt)


@kernel
def regulated(allowed: float, curvature: float, limits: Limits) -> float:
    """Return the speed on an arc: less where it is tight, and where the turn rate would not do."""
    bend = abs(curvature)
    speed = allowed / max(1.0, TIGHT_M * bend)
    return min(speed, limits.max_turn / bend) if bend > 0.0 else speed
