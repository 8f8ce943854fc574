"""The controller: samples drives over the window and takes the best (MPPI)."""

import math

import numpy as np
from numpy.typing import NDArray

from trolley.config import PlannerConfig
from trolley.geometry import Twist2D
from trolley_planner.control.controller import DT_S, Motion, first_step, limits_here, state_of
from trolley_planner.control.local_costmap import Window
from trolley_planner.kernels.mppi import choose_controls
from trolley_planner.kernels.rollout import COLLISION, Limits, Prices, Target, trace_into

NOISE_SEQUENCES = 1024
KNOT_STEPS = 6
"""Noise is drawn at every sixth step and even in between: commands stay smooth."""
NOISE_SPEED = 0.35
"""Deviation of the sampled speeds, as a share of the highest speed."""
NOISE_TURN = 0.45
"""Deviation of the sampled turn rates, as a share of the highest turn rate."""
NARROW_NOISE = 0.3
TEMPERATURE_M = 0.03
DESCENTS = np.array(
    [(look, share, 0.0) for look in (0.2, 0.35, 0.6) for share in (0.45, 1.0)]
    + [(0.35, 1.0, backwards_s) for backwards_s in (0.5, 1.0, 1.5)]
)
"""Ways down the cost-to-go: lookahead [m], share of the speed, backwards at first [s]."""
PRIMITIVES = np.array(
    [
        (0.0, 0.0),
        (0.0, 0.6),
        (0.0, -0.6),
        (0.15, 0.0),
        (0.1, 0.4),
        (0.1, -0.4),
        (-0.25, 0.0),
        (-0.1, 0.3),
        (-0.1, -0.3),
    ]
)
"""Plain motions that are always tried: in tight places random ones all touch something."""
PRICES = Prices(
    near=0.8,
    near_m=0.15,
    reverse=0.4,
    turn=0.02,
    change_v=0.3,
    change_w=0.1,
    heading=0.15,
    company=0.4,
)


class Mppi:
    """Chooses the velocity that leads best along the cost-to-go of a window.

    Args:
        config: horizon, number of samples, seed.
    """

    def __init__(self, config: PlannerConfig) -> None:
        self._steps = max(5, round(config.horizon_s / DT_S))
        self._samples = config.rollouts
        rng = np.random.default_rng(config.seed)
        self._noise = _smooth_noise(rng, NOISE_SEQUENCES + self._samples, self._steps)
        self._scratch = np.empty((self._samples, self._steps, 2))
        self._tick = 0
        self.reset()

    def reset(self) -> None:
        """Forget the last solution, as when the robot was driven by somebody else."""
        self._controls = np.zeros((self._steps, 2))
        self.trajectory = np.empty((0, 3), dtype=np.float32)

    def command(
        self, motion: Motion, window: Window, limits: Limits, target: Target, elapsed_s: float
    ) -> Twist2D | None:
        """Return the velocity to drive now; see `Controller`."""
        limits = limits_here(limits, window, motion.pose)
        start = state_of(motion)
        self._controls = _moved_on(self._controls, elapsed_s / DT_S)
        scale = np.array([NOISE_SPEED * limits.max_speed, NOISE_TURN * limits.max_turn])
        first = self._tick * 61 % NOISE_SEQUENCES
        self._tick += 1
        price = choose_controls(
            self._controls,
            self._noise[first : first + self._samples] * scale,
            start,
            (window.field, window.body, limits, target, PRICES),
            (DESCENTS, PRIMITIVES),
            TEMPERATURE_M,
            self._scratch,
        )
        self.trajectory = np.empty((self._steps + 1, 3), dtype=np.float32)
        trace_into(self.trajectory, self._controls, start, DT_S)
        if price >= COLLISION:
            self.reset()
            return None
        return first_step(motion, self._controls, elapsed_s)


def _smooth_noise(rng: np.random.Generator, count: int, steps: int) -> NDArray[np.float64]:
    """Return (count, steps, 2) of unit deviation, drawn at knots and linear between them."""
    knots = math.ceil(steps / KNOT_STEPS) + 1
    drawn = rng.standard_normal((count, knots, 2))
    at = np.arange(steps) / KNOT_STEPS
    # Every second sequence stays near the old solution: it smooths where all goes well.
    drawn[::2] *= NARROW_NOISE
    low = np.floor(at).astype(np.int64)
    share = (at - low)[None, :, None]
    return np.ascontiguousarray((1.0 - share) * drawn[:, low] + share * drawn[:, low + 1])


def _moved_on(controls: NDArray[np.float64], steps: float) -> NDArray[np.float64]:
    """Return the rest of a sequence (n, 2) after some steps, its last command repeated."""
    last = len(controls) - 1
    at = np.minimum(np.arange(len(controls)) + max(steps, 0.0), last)
    index = np.arange(len(controls))
    return np.stack([np.interp(at, index, controls[:, axis]) for axis in range(2)], axis=1)
