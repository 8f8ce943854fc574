"""Model predictive path integral control (MPPI): sample control sequences, average the best.

Source:
    Williams, Wagener, Goldfain, Drews, Rehg, Boots, Theodorou, Information Theoretic MPC for
    Model-Based Reinforcement Learning (2017), algorithm 1. Deviation: samples surround two
    sequences, the last solution and a plain descent of the cost-to-go, and the averages have to
    be better than the best single sequence.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.config import PlannerConfig
from trolley.geometry import Twist2D
from trolley.jit import kernel
from trolley_planner.control.controller import Motion, first_step, limits_here, state_of
from trolley_planner.control.critics import Target, downhill_point
from trolley_planner.control.local_costmap import LocalCostmap
from trolley_planner.control.path_tracking import track_into
from trolley_planner.control.robot_motion import (
    DT_S,
    Limits,
    advance,
    allowed_speed,
    followed,
    trace_into,
)
from trolley_planner.control.rollout import ROLLOUT, Scene, rollouts_into
from trolley_planner.costmap.footprint import clearance_at
from trolley_planner.sensing.beams import wrapped


class MppiParams(NamedTuple):
    """How control sequences are sampled and averaged; all by hand."""

    noise_sequences: int = 1024
    """Noise sequences drawn once; each cycle uses the next ones of them."""
    knot_steps: int = 6
    """Steps between two drawn values; in between the noise is linear, so commands stay smooth."""
    speed_noise: float = 0.35
    """Standard deviation of the sampled speeds, as a share of the highest speed."""
    turn_noise: float = 0.45
    """Standard deviation of the sampled turn rates, as a share of the highest turn rate."""
    narrow_share: float = 0.3
    """Every second sequence has only this share of the noise: it smooths a good solution."""
    temperature_m: float = 0.03
    """Extra cost at which a sample's weight falls to 1/e [m] (lambda of the paper)."""
    least_weight: float = 1e-6
    """Samples with less weight than this are left out of the average."""
    descent_turn_gain: float = 2.5
    """Turn rate per heading error when descending [1/s]."""
    turn_in_place_rad: float = 1.0
    """Heading error from which on the descent turns without driving."""


MPPI = MppiParams()
STRAIGHT = (0.0, 0.0, 1.0)
DESCENTS = np.array(
    [(ahead, share, 0.0, *STRAIGHT) for ahead in (0.2, 0.35, 0.6) for share in (0.45, 1.0)]
    + [(0.35, 1.0, backwards_s, *STRAIGHT) for backwards_s in (0.5, 1.0, 1.5)]
)
"""Descents of the cost-to-go: lookahead [m], share of the speed, time backwards at first [s]; then
how far beside the way down it heads at first [rad], for how long [s], and the share of the speed
that it drives with after that."""
ASIDE = np.array(
    [
        (0.35, 1.0, 0.0, side * aside_rad, aside_s, then)
        for side in (-1.0, 1.0)
        for aside_rad, aside_s in ((0.5, 0.8), (0.5, 1.4), (0.5, 2.0), (0.9, 0.8), (0.9, 1.4))
        for then in (0.0, 1.0)
    ]
)
"""The same, aside: they are tried while people walk, whom random samples pass too late."""
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
"""Constant v [m/s], w [rad/s] that are always tried: in tight places random ones all collide."""


class Mppi:
    """Chooses the velocity that leads best along the cost-to-go of the local costmap.

    Args:
        config: horizon, number of samples, seed.
    """

    def __init__(self, config: PlannerConfig) -> None:
        self._steps = max(5, round(config.horizon_s / DT_S))
        self._num_samples = config.rollouts
        rng = np.random.default_rng(config.seed)
        self._noise = _smooth_noise(rng, MPPI.noise_sequences + self._num_samples, self._steps)
        self._samples = np.empty((self._num_samples, self._steps, 2))
        self._cycle = 0
        self.reset()

    def reset(self) -> None:
        """Forget the last solution, as after somebody else drove the robot."""
        self._controls = np.zeros((self._steps, 2))
        self.trajectory = np.empty((0, 3), dtype=np.float32)

    def command(
        self,
        motion: Motion,
        local_costmap: LocalCostmap,
        limits: Limits,
        target: Target,
        path: NDArray[np.float64],
        elapsed_s: float,
    ) -> Twist2D | None:
        """Return the velocity to drive now; see `Controller`."""
        limits = limits_here(limits, local_costmap, motion.pose)
        scene = Scene(local_costmap.field, local_costmap.body, limits, target)
        start = state_of(motion)
        self._controls = _shifted(self._controls, elapsed_s / DT_S)
        tracked = np.empty_like(self._controls)
        if track_into(tracked, start, scene, path):
            self._controls, cost = tracked, 0.0
        else:
            noise, deviations = self._next_noise(), _deviations(limits)
            cost = optimize(self._controls, self._samples, noise, deviations, start, scene)
        self.trajectory = np.empty((self._steps + 1, 3), dtype=np.float32)
        trace_into(self.trajectory, self._controls, start, DT_S)
        if cost >= ROLLOUT.collision_cost:
            self.reset()
            return None
        return first_step(motion, self._controls, elapsed_s)

    def _next_noise(self) -> NDArray[np.float64]:
        """Return the noise (samples, steps, 2) of this cycle, of unit deviation."""
        first = self._cycle * 61 % MPPI.noise_sequences
        self._cycle += 1
        return self._noise[first : first + self._num_samples]


def _deviations(limits: Limits) -> tuple[float, float]:
    """Return the deviations of the sampled speeds [m/s] and turn rates [rad/s]."""
    return MPPI.speed_noise * limits.max_speed, MPPI.turn_noise * limits.max_turn


def _smooth_noise(rng: np.random.Generator, count: int, steps: int) -> NDArray[np.float64]:
    """Return (count, steps, 2) of unit deviation, drawn at knots and linear between them."""
    knots = math.ceil(steps / MPPI.knot_steps) + 1
    drawn = rng.standard_normal((count, knots, 2))
    at = np.arange(steps) / MPPI.knot_steps
    drawn[::2] *= MPPI.narrow_share
    low = np.floor(at).astype(np.int64)
    share = (at - low)[None, :, None]
    return np.ascontiguousarray((1.0 - share) * drawn[:, low] + share * drawn[:, low + 1])


def _shifted(controls: NDArray[np.float64], steps: float) -> NDArray[np.float64]:
    """Return the rest of a sequence (n, 2) after some steps, its last command repeated."""
    last = len(controls) - 1
    at = np.minimum(np.arange(len(controls)) + max(steps, 0.0), last)
    index = np.arange(len(controls))
    return np.stack([np.interp(at, index, controls[:, axis]) for axis in range(2)], axis=1)


@kernel
def optimize(
    controls: NDArray[np.float64],
    samples: NDArray[np.float64],
    noise: NDArray[np.float64],
    deviations: tuple[float, float],
    start: NDArray[np.float64],
    scene: Scene,
) -> float:
    """Improve a control sequence by one iteration; return its cost.

    Args:
        controls: (steps, 2) the last solution, shifted by the time that passed; replaced.
        samples: (samples, steps, 2), overwritten.
        noise: (samples, steps, 2) of unit deviation.
        deviations: of the sampled speeds [m/s] and turn rates [rad/s].
        start: (5,) state.
        scene: what rollouts need.
    """
    descent = np.empty_like(controls)
    descent_cost = best_plain_into(descent, start, scene)
    generate_samples(samples, controls, descent, noise, deviations)
    costs = np.empty(samples.shape[0])
    rollouts_into(costs, samples, start, scene)
    return update_control_sequence(controls, samples, costs, descent, descent_cost, start, scene)


@kernel
def generate_samples(
    out_samples: NDArray[np.float64],
    last: NDArray[np.float64],
    descent: NDArray[np.float64],
    noise: NDArray[np.float64],
    deviations: tuple[float, float],
) -> None:
    """Write one half of the samples around the last solution, the other around the descent."""
    half = noise.shape[0] // 2
    for index in range(noise.shape[0]):
        centre = last if index < half else descent
        for step in range(noise.shape[1]):
            out_samples[index, step, 0] = centre[step, 0] + deviations[0] * noise[index, step, 0]
            out_samples[index, step, 1] = centre[step, 1] + deviations[1] * noise[index, step, 1]


@kernel
def update_control_sequence(
    controls: NDArray[np.float64],
    samples: NDArray[np.float64],
    costs: NDArray[np.float64],
    descent: NDArray[np.float64],
    descent_cost: float,
    start: NDArray[np.float64],
    scene: Scene,
) -> float:
    """Replace the sequence by the best of the averages, the last solution and the descent.

    Where a single sample is cheaper than the average around it, the sample counts instead.
    """
    half = samples.shape[0] // 2
    trials, trial_costs = np.empty((3, *controls.shape)), np.empty(3)
    trials[0] = controls
    average_into(trials[1], samples[:half], costs[:half])
    average_into(trials[2], samples[half:], costs[half:])
    rollouts_into(trial_costs, trials, start, scene)
    controls[:, :] = trials[0]
    best_cost = trial_costs[0]
    for around in range(2):
        trial, cost = trials[1 + around], trial_costs[1 + around]
        first, end = (0, half) if around == 0 else (half, samples.shape[0])
        sample = first + np.argmin(costs[first:end])
        if costs[sample] < cost:
            trial, cost = samples[sample], costs[sample]
        if cost < best_cost:
            controls[:, :] = trial
            best_cost = cost
    if descent_cost < best_cost:
        controls[:, :] = descent
        best_cost = descent_cost
    return best_cost


@kernel
def average_into(
    out_average: NDArray[np.float64], samples: NDArray[np.float64], costs: NDArray[np.float64]
) -> None:
    """Write the weighted average of samples.

    Args:
        out_average: (steps, 2), overwritten.
        samples: (n, steps, 2).
        costs: (n,).
    """
    lowest = costs.min()
    total = 0.0
    out_average[:, :] = 0.0
    for index in range(samples.shape[0]):
        weight = math.exp((lowest - costs[index]) / MPPI.temperature_m)
        if weight > MPPI.least_weight:
            total += weight
            for step in range(samples.shape[1]):
                out_average[step, 0] += weight * samples[index, step, 0]
                out_average[step, 1] += weight * samples[index, step, 1]
    out_average /= total


@kernel
def best_plain_into(
    out_controls: NDArray[np.float64], start: NDArray[np.float64], scene: Scene
) -> float:
    """Write the cheapest of the descents and primitives (steps, 2); return its cost."""
    num_plain = DESCENTS.shape[0] + PRIMITIVES.shape[0]
    num_aside = ASIDE.shape[0] if scene.field.walkers.shape[0] > 0 else 0
    trials = np.empty((num_plain + num_aside, *out_controls.shape))
    for index in range(trials.shape[0]):
        if index < DESCENTS.shape[0]:
            descend_into(trials[index], start, scene, DESCENTS[index])
        elif index < num_plain:
            trials[index] = PRIMITIVES[index - DESCENTS.shape[0]]
        else:
            descend_into(trials[index], start, scene, ASIDE[index - num_plain])
    costs = np.empty(trials.shape[0])
    rollouts_into(costs, trials, start, scene)
    best = np.argmin(costs)
    out_controls[:, :] = trials[best]
    return costs[best]


@kernel
def descend_into(
    out_controls: NDArray[np.float64],
    start: NDArray[np.float64],
    scene: Scene,
    manner: NDArray[np.float64],
) -> None:
    """Write the commands (steps, 2) that follow the cost-to-go downhill.

    Where there is no room to turn, the path down begins backwards.

    Args:
        out_controls: (steps, 2), overwritten.
        start: (5,) state.
        scene: what rollouts need.
        manner: (6,) a row of `DESCENTS`.
    """
    field, body, limits = scene.field, scene.body, scene.limits
    lookahead_m, share, backwards_s = manner[0], manner[1], manner[2]
    aside_rad, aside_s = manner[3], manner[4]
    state = start.copy()
    for step in range(out_controls.shape[0]):
        clearance = clearance_at(field, body, state[0], state[1], state[2], limits.caution_m)
        allowed = allowed_speed(field, limits, state[0], state[1], clearance)
        x, y = downhill_point(field, state[0], state[1], lookahead_m)
        distance = math.hypot(x - state[0], y - state[1])
        wanted_v, wanted_w = 0.0, 0.0
        if distance > 0.5 * field.coarse_m:
            error = wrapped(math.atan2(y - state[1], x - state[0]) - state[2])
            if aside_s > 0.0 and step * limits.dt < aside_s:
                error += aside_rad
            elif aside_s > 0.0:
                share = manner[5]
            wanted_w = MPPI.descent_turn_gain * error
            if abs(error) < MPPI.turn_in_place_rad:
                wanted_v = share * allowed * math.cos(error) ** 2
        if step * limits.dt < backwards_s:
            wanted_v, wanted_w = -limits.max_reverse, 0.0
        state[3], state[4] = followed(state[3], state[4], (wanted_v, wanted_w), limits, allowed)
        out_controls[step, 0], out_controls[step, 1] = state[3], state[4]
        advance(state, limits.dt)
