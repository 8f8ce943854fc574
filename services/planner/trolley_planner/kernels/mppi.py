"""Compiled model predictive path integral control: sample, weigh, average.

Source:
    Williams, Wagener, Goldfain, Drews, Rehg, Boots, Theodorou, Information Theoretic MPC for
    Model-Based Reinforcement Learning (2017), algorithm 1. Deviation: samples surround two
    sequences, the last solution and a plain descent of the cost-to-go, and the averages have to
    be better than the best single sequence.
"""

import math

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel
from trolley_planner.kernels.angles import wrapped
from trolley_planner.kernels.clearance import Body, Field, clearance_at
from trolley_planner.kernels.rollout import (
    Limits,
    Prices,
    Target,
    advance,
    allowed_speed,
    downhill_point,
    followed,
    rollout,
)

TURN_GAIN = 2.5
"""Turn rate per heading error when descending [1/s]."""
TURN_IN_PLACE = 1.0
"""Heading error from which on the descent turns without driving [rad]."""


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
