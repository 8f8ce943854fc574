"""How long the rollouts take: 2000 of 56 steps, with all that they cost.

    python -m bench.planner.rollouts [--full]

A robot at random places in ten furnished houses, among people and beside a speed zone, with the
samples that its controller draws there. Two figures: in an empty house, and among three people and
another robot. The reference rolls the same samples out bare, one after the other, in the same run
and by turns: the motion and one look-up of the distance at each step, and nothing else. Times are
processor times, so other work on the machine matters little.
"""

import argparse
import math
import time
from typing import NamedTuple

import numpy as np
from bench.harness.figures import Figure, at_most, show
from bench.harness.houses import draw_house, free_poses
from numpy.typing import NDArray

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D
from trolley.gridmap.kernels import interpolate
from trolley.jit import kernel
from trolley_planner.context.planning_context import PlanningContext
from trolley_planner.control.controller import limits_of
from trolley_planner.control.critics import Target
from trolley_planner.control.robot_motion import followed, moved
from trolley_planner.control.rollout import Scene, rollouts_into
from trolley_planner.costmap.footprint import Footprint

SAMPLES, STEPS = 2000, 56
LIMIT_MS = 5.0
FOOTPRINT = Footprint.from_polygon([(0.15, 0.12), (-0.15, 0.12), (-0.15, -0.12), (0.15, -0.12)])
PEOPLE, SPEED_MPS, WALKING_MPS = 3, 0.5, 1.0


class Case(NamedTuple):
    """One place of the robot."""

    scene: Scene
    start: NDArray[np.float64]
    """(5,) state."""
    samples: NDArray[np.float64]
    """(samples, steps, 2)."""


@kernel
def roll_bare(
    out_m: NDArray[np.float64],
    samples: NDArray[np.float64],
    start: NDArray[np.float64],
    scene: Scene,
) -> None:
    """Write the least distance that the centre comes to along each sample [m]."""
    field, limits = scene.field, scene.limits
    for index in range(samples.shape[0]):
        x, y, v, w = start[0], start[1], start[3], start[4]
        cos, sin = math.cos(start[2]), math.sin(start[2])
        nearest = math.inf
        for step in range(samples.shape[1]):
            wanted = samples[index, step, 0], samples[index, step, 1]
            v, w = followed(v, w, wanted, limits, limits.max_speed)
            x, y, cos, sin = moved(x, y, (cos, sin), (v, w), limits.dt)
            col, row = (x - field.x) / field.fine_m, (y - field.y) / field.fine_m
            nearest = min(nearest, interpolate(field.distance_m, col - 0.5, row - 0.5))
        out_m[index] = nearest


def draw_case(seed: int, is_busy: bool) -> Case:
    """A place in a house; busy: with people, another robot and a speed zone."""
    rng = np.random.default_rng(seed)
    house = draw_house(20.0, seed % 10)
    context = PlanningContext(house, FOOTPRINT, PlannerConfig(), SPEED_MPS)
    here, there = free_poses(house, 0.25, 2, rng)
    costmap, local = context.costmap, context.local_costmap
    found = None
    while found is None:
        here, there = free_poses(house, 0.25, 2, rng)
        found = context.planner.plan(
            (here.x, here.y), [(there.x, there.y)], costmap.weights, costmap.distance_m
        )
    local.update(here.x, here.y)
    local.compute_cost_to_go(found.points, found.remaining_m)
    ahead = found.points[min(40, len(found.points) - 1)]
    bearing = math.atan2(*(ahead - found.points[0])[::-1])
    here = Pose2D(here.x, here.y, bearing + float(rng.normal(0.0, 0.4)))
    limits = limits_of(PlannerConfig(), SPEED_MPS, 1.5, 1.0)
    field = local.field
    if is_busy:
        away = rng.uniform(0.8, 2.5, PEOPLE), rng.uniform(-1.2, 1.2, PEOPLE) + here.yaw
        heading = rng.uniform(-math.pi, math.pi, PEOPLE)
        walkers = np.column_stack(
            [
                here.x + away[0] * np.cos(away[1]),
                here.y + away[0] * np.sin(away[1]),
                WALKING_MPS * np.cos(heading),
                WALKING_MPS * np.sin(heading),
                np.full(PEOPLE, 0.25),
                np.full(PEOPLE, 0.05),
                np.full(PEOPLE, np.inf),
            ]
        )
        line = np.linspace(0.0, 2.5, 60)[:, None] * (math.cos(heading[0]), math.sin(heading[0]))
        discs = np.concatenate([line + here.as_array()[:2] + 1.0, np.full((60, 1), 0.2)], axis=1)
        zones = np.full(costmap.shape, np.inf, dtype=np.float32)
        zones[:200] = 0.4
        field = field._replace(walkers=walkers, robots=discs[None], speed_mps=zones)
    end = found.points[-1]
    scene = Scene(field, local.body, limits, Target(float(end[0]), float(end[1]), 0.1, False))
    knots = rng.standard_normal((SAMPLES, STEPS // 6 + 2, 2)) * (0.35 * SPEED_MPS, 0.45 * 1.5)
    at = np.arange(STEPS) / 6.0
    low, share = np.floor(at).astype(int), (at % 1.0)[None, :, None]
    noise = (1.0 - share) * knots[:, low] + share * knots[:, low + 1]
    start = np.array([here.x, here.y, here.yaw, 0.3, 0.0])
    noise[:, :, 0] += 0.8 * SPEED_MPS
    return Case(scene, start, noise)


def measure(is_busy: bool, count: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Processor times of ours and of the reference in each case [ms]."""
    ours, bare = np.empty(count), np.empty(count)
    costs, nearest = np.empty(SAMPLES), np.empty(SAMPLES)
    for number in range(-1, count):
        case = draw_case(max(number, 0), is_busy)
        times: list[tuple[float, float]] = []
        for _ in range(3):
            samples = case.samples.copy()
            began = time.thread_time()
            rollouts_into(costs, samples, case.start, case.scene)
            between = time.thread_time()
            samples = case.samples.copy()
            before = time.thread_time()
            roll_bare(nearest, samples, case.start, case.scene)
            times.append((between - began, time.thread_time() - before))
        if number >= 0:  # The first case compiles the kernels.
            ours[number], bare[number] = 1e3 * np.array(times).min(axis=0)
    return ours, bare


def main() -> None:
    """Time both kinds of cases."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--full", action="store_true", help="100 places instead of 20")
    count = 100 if parser.parse_args().full else 20
    for name, is_busy in (("in an empty house", False), ("among people", True)):
        ours, bare = measure(is_busy, count)
        show(
            [
                at_most(f"{SAMPLES} x {STEPS} {name}", float(ours.mean()), LIMIT_MS, "ms", 2),
                Figure("  the slowest place", f"{ours.max():.2f} ms"),
                Figure("  the bare rollouts", f"{bare.mean():.2f} ms"),
                Figure("  times as long as these", f"{ours.mean() / bare.mean():.1f}"),
            ]
        )


if __name__ == "__main__":
    main()
