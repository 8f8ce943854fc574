"""The cheap controller: regulated pure pursuit, and plain motions where that would touch."""

import numpy as np

from trolley.config import PlannerConfig
from trolley.geometry import Twist2D
from trolley_planner.control.controller import DT_S, Motion, first_step, limits_here, state_of
from trolley_planner.control.local_costmap import Window
from trolley_planner.control.mppi import DESCENTS, PRICES, PRIMITIVES
from trolley_planner.kernels.mppi import best_plain_into
from trolley_planner.kernels.pursuit import pursue
from trolley_planner.kernels.rollout import COLLISION, Limits, Target, rollout, trace_into

SHARES = (1.0, 0.6, 0.35)
"""Of the usual lookahead: nearer points are tried where the farther one leads over something."""


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
