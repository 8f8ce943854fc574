"""The controller: samples drives over the window and takes the best (MPPI)."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, Twist2D
from trolley_planner.kernels.mppi import choose_controls
from trolley_planner.kernels.rollout import (
    COLLISION,
    Limits,
    Prices,
    Target,
    stopping_clearance,
    trace_into,
)
from trolley_planner.window import Window

DT_S = 0.1
"""Step of the rollouts."""
NOISE_SEQUENCES = 1024
KNOT_STEPS = 4
"""Noise is drawn at every fourth step and even in between: commands stay smooth."""
NOISE_SPEED = 0.35
"""Deviation of the sampled speeds, as a share of the highest speed."""
NOISE_TURN = 0.45
"""Deviation of the sampled turn rates, as a share of the highest turn rate."""
NARROW_NOISE = 0.3
TEMPERATURE_M = 0.03
DELAY_S = 0.15
"""From a command to what the wheels make of it, with the age of the scan."""
DESCENTS = np.array(
    [(look, share) for look in (0.2, 0.35, 0.6) for share in (0.45, 1.0)], dtype=np.float64
)
PRIMITIVES = np.array(
    [
        (0.0, 0.0),
        (0.0, 0.6),
        (0.0, -0.6),
        (0.15, 0.0),
        (0.1, 0.4),
        (0.1, -0.4),
        (-0.12, 0.0),
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
)


@dataclass(frozen=True, slots=True)
class Motion:
    """Where the robot is in `grid` and how it moves."""

    pose: Pose2D
    twist: Twist2D


def limits_of(config: PlannerConfig, speed: float, turn: float, deceleration: float) -> Limits:
    """Return what the robot may do at the moment.

    Args:
        config: the planner's own limits.
        speed: highest speed now [m/s].
        turn: highest turn rate of the base [rad/s].
        deceleration: what the base brakes with [m/s^2].
    """
    return Limits(
        max_speed=speed,
        max_reverse=min(0.15, speed),
        max_turn=min(config.max_turn_radps, turn),
        acceleration=config.acceleration_mps2,
        deceleration=min(deceleration, 1.5 * config.acceleration_mps2),
        turn_acceleration=config.angular_acceleration_radps2,
        slow_speed=min(config.slow_speed_mps, speed),
        caution_m=config.caution_distance_m,
        clearance_m=config.clearance_m,
        dt=DT_S,
    )


class Controller:
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
        """(n, 3) x, y, yaw in `grid`: what the last command leads to, `DT_S` apart."""

    def command(
        self, motion: Motion, window: Window, limits: Limits, target: Target, elapsed_s: float
    ) -> Twist2D | None:
        """Return the velocity to drive now, None if every drive would touch something.

        Args:
            motion: of the robot, with the velocity that it has.
            window: around it, leading along the path.
            limits: of the robot.
            target: where the path leads next.
            elapsed_s: since the last command.
        """
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
        # The first step takes DT_S; only a part of it has passed until the next command.
        share = min(max(elapsed_s / DT_S, 0.2), 1.0)
        v = motion.twist.vx + share * (float(self._controls[0, 0]) - motion.twist.vx)
        w = motion.twist.wz + share * (float(self._controls[0, 1]) - motion.twist.wz)
        return Twist2D(v, 0.0, w)


def safe_command(
    motion: Motion, wanted: Twist2D, window: Window, limits: Limits, give_m: float = 0.0
) -> Twist2D:
    """Return as much of a velocity as lets the robot stop before it touches anything.

    Who stands too close already may still move away.

    Args:
        motion: of the robot.
        wanted: velocity about to be commanded.
        window: around it.
        limits: braking and clearance.
        give_m: how much closer it may come where it is too close already.
    """
    start = state_of(motion)
    for share in (1.0, 0.75, 0.5, 0.25, 0.1):
        start[3], start[4] = share * wanted.vx, share * wanted.wz
        now, smallest = stopping_clearance(start, window.field, window.body, limits, DELAY_S)
        if smallest >= min(limits.clearance_m, now - give_m):
            return wanted.scaled(share)
    return Twist2D.zero()


def state_of(motion: Motion) -> NDArray[np.float64]:
    """Return x, y, yaw, v, w as the kernels take them."""
    pose, twist = motion.pose, motion.twist
    return np.array([pose.x, pose.y, pose.yaw, twist.vx, twist.wz])


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
