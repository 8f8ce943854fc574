"""The controller: samples drives over the window and takes the best (MPPI)."""

import math

import numpy as np
from numpy.typing import NDArray

from trolley.config import PlannerConfig
from trolley.geometry import Twist2D
from trolley.jit import kernel
from trolley_planner.control.controller import DT_S, Motion, first_step, limits_here, state_of
from trolley_planner.control.local_costmap import Window
from trolley_planner.control.rollout import (
    COLLISION,
    Limits,
    Prices,
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


TURN_GAIN = 2.5
"""Turn rate per heading error when descending [1/s]."""


TURN_IN_PLACE = 1.0
"""Heading error from which on the descent turns without driving [rad]."""


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


@kernel
def descend_controls(
    out_controls: NDArray[np.float64],
    start: NDArray[np.float64],
    field: Field,
    body: Body,
    limits: Limits,
    manner: tuple[float, float, float],
) -> None:
    """Write the commands that follow the cost-to-go downhill, like pure pursuit of its bottom.

    Where there is no room to turn the way down begins backwards.

    Args:
        out_controls: (steps, 2), overwritten.
        start: (5,).
        field: the window.
        body: the outline.
        limits: of the robot.
        manner: how far ahead the point lies that is steered for [m], the share of the allowed
            speed, and how long it drives straight backwards first [s].
    """
    lookahead_m, share, backwards_s = manner
    state = start.copy()
    for step in range(out_controls.shape[0]):
        clearance = clearance_at(field, body, state[0], state[1], state[2], limits.caution_m)
        allowed = allowed_speed(field, limits, state[0], state[1], clearance)
        x, y = downhill_point(field, state[0], state[1], lookahead_m)
        distance = math.hypot(x - state[0], y - state[1])
        wanted_v, wanted_w = 0.0, 0.0
        if distance > 0.5 * field.coarse_m:
            error = wrapped(math.atan2(y - state[1], x - state[0]) - state[2])
            wanted_w = TURN_GAIN * error
            if abs(error) < TURN_IN_PLACE:
                wanted_v = share * allowed * math.cos(error) ** 2
        if step * limits.dt < backwards_s:
            wanted_v, wanted_w = -limits.max_reverse, 0.0
        state[3], state[4] = followed(state[3], state[4], (wanted_v, wanted_w), limits, allowed)
        out_controls[step, 0], out_controls[step, 1] = state[3], state[4]
        advance(state, limits.dt)


@kernel
def sample_around(
    out_average: NDArray[np.float64],
    base: NDArray[np.float64],
    noise: NDArray[np.float64],
    start: NDArray[np.float64],
    world: tuple[Field, Body, Limits, Target, Prices],
    temperature: float,
    scratch: NDArray[np.float64],
) -> float:
    """Write the average of samples around a sequence, the cheaper the heavier; return its price.

    Args:
        out_average: (steps, 2), overwritten.
        base: (steps, 2) what the samples surround.
        noise: (samples, steps, 2).
        start: (5,).
        world: what rollouts need.
        temperature: price that a sample may cost more at 1/e of the weight.
        scratch: (samples, steps, 2).
    """
    field, body, limits, target, prices = world
    count, steps = noise.shape[0], noise.shape[1]
    price = np.empty(count)
    for index in range(count):
        for step in range(steps):
            scratch[index, step, 0] = base[step, 0] + noise[index, step, 0]
            scratch[index, step, 1] = base[step, 1] + noise[index, step, 1]
        price[index] = rollout(scratch[index], start, field, body, limits, target, prices)
    lowest = price.min()
    total = 0.0
    out_average[:, :] = 0.0
    for index in range(count):
        weight = math.exp((lowest - price[index]) / temperature)
        if weight > 1e-6:
            total += weight
            for step in range(steps):
                out_average[step, 0] += weight * scratch[index, step, 0]
                out_average[step, 1] += weight * scratch[index, step, 1]
    out_average /= total
    average_price = rollout(out_average, start, field, body, limits, target, prices)
    best = np.argmin(price)
    if price[best] < average_price:
        out_average[:, :] = scratch[best]
        average_price = price[best]
    return average_price


@kernel
def best_plain_into(
    out_controls: NDArray[np.float64],
    start: NDArray[np.float64],
    world: tuple[Field, Body, Limits, Target, Prices],
    plain: tuple[NDArray[np.float64], NDArray[np.float64]],
) -> float:
    """Write the best of the plain sequences; return its price.

    Args:
        out_controls: (steps, 2), overwritten.
        start: (5,).
        world: what rollouts need.
        plain: (n, 3) manner of each descent, and (m, 2) v, w of each constant motion.
    """
    field, body, limits, target, prices = world
    descents, primitives = plain
    trial = np.empty_like(out_controls)
    best = math.inf
    for index in range(descents.shape[0] + primitives.shape[0]):
        if index < descents.shape[0]:
            manner = (descents[index, 0], descents[index, 1], descents[index, 2])
            descend_controls(trial, start, field, body, limits, manner)
        else:
            trial[:, :] = primitives[index - descents.shape[0]]
        price = rollout(trial, start, field, body, limits, target, prices)
        if price < best:
            out_controls[:, :] = trial
            best = price
    return best


@kernel
def choose_controls(
    controls: NDArray[np.float64],
    noise: NDArray[np.float64],
    start: NDArray[np.float64],
    world: tuple[Field, Body, Limits, Target, Prices],
    plain: tuple[NDArray[np.float64], NDArray[np.float64]],
    temperature: float,
    scratch: NDArray[np.float64],
) -> float:
    """Improve a sequence of commands; return its price.

    Args:
        controls: (steps, 2) the last solution, moved on by the time that passed; replaced.
        noise: (samples, steps, 2).
        start: (5,).
        world: what rollouts need.
        plain: see `best_plain_into`.
        temperature: see `sample_around`.
        scratch: (samples, steps, 2).
    """
    field, body, limits, target, prices = world
    best = controls.copy()
    best_price = rollout(best, start, field, body, limits, target, prices)
    descent = np.empty_like(controls)
    descent_price = best_plain_into(descent, start, world, plain)
    half = noise.shape[0] // 2
    average = np.empty_like(controls)
    for base in range(2):
        around = controls if base == 0 else descent
        part = noise[:half] if base == 0 else noise[half:]
        price = sample_around(average, around, part, start, world, temperature, scratch)
        if price < best_price:
            best[:, :] = average
            best_price = price
    if descent_price < best_price:
        best[:, :] = descent
        best_price = descent_price
    controls[:, :] = best
    return best_price
