"""How exactly the robot stops: random goals in the demo's apartment, by the estimate and the truth.

    python -m bench.planner.stops [--count 20] [--full] [--fast]

Base, localizer and planner run in lock-step on the simulated robot of the demo, whose wheels, lidar
and motors err as they do there. The goal's tolerances hold for the pose that the localizer gives;
the truth differs by its error and is printed besides. `--full` drives 200 goals; `--fast` lets the
robot drive at up to 2 m/s.
"""

import argparse
import math
import multiprocessing
import tempfile
import tomllib
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from bench.harness.drives import make_config
from bench.harness.figures import Figure, at_least, at_most, show, table
from bench.harness.houses import free_poses
from bench.harness.paths import WORLDS

from trolley import codes, requests, topics
from trolley.geometry import Pose2D, wrap_angle
from trolley.gridmap import load_map
from trolley.messages.request_params import SendGoal
from trolley.runtime.lockstep import Lockstep
from trolley_base.service import BaseService
from trolley_localizer.service import LocalizerService
from trolley_planner.service import PlannerService

MAP = WORLDS / "apartment.yaml"
START = Pose2D(0.549, 0.218, 0.2579)
TOLERANCE_M, TOLERANCE_DEG = 0.05, 3.0
FREE_M, LIMIT_S, SETTLE_S = 0.35, 150.0, 1.0
NEAR_M = 0.6
ENDED = ("arrived", "failed", "canceled")
FULL, GOALS_IN_A_RUN = 200, 20
FAST = """
[base.limits]
max_speed_mps = 2.0
max_wz_radps = 3.0
acceleration_mps2 = 2.0
deceleration_mps2 = 2.0
angular_acceleration_radps2 = 8.0
[planner]
max_speed_mps = 2.0
acceleration_mps2 = 2.0
max_turn_radps = 3.0
angular_acceleration_radps2 = 6.0
"""
FAST_MOTORS = """
[limits]
max_speed_mps = 2.0
max_wz_radps = 3.0
acceleration_mps2 = 2.5
deceleration_mps2 = 2.5
angular_acceleration_radps2 = 8.0
angular_deceleration_radps2 = 8.0
"""


@dataclass(frozen=True)
class Stop:
    """One goal: distance [m] and turn [deg] that the robot stood off it."""

    ending: str
    seconds: float
    told: tuple[float, float] = (math.nan, math.nan)
    """By the newest estimate."""
    true: tuple[float, float] = (math.nan, math.nan)


def things() -> list[tuple[float, float]]:
    """Where things stand in the apartment that are not on the map; goals there are refused."""
    world = tomllib.loads((WORLDS / "apartment.toml").read_text())
    return [(one["x"], one["y"]) for kind in ("box", "circle") for one in world[kind]]


def drive(seed: int, count: int, is_fast: bool) -> list[Stop]:
    """Drive from goal to goal."""
    goals = [
        goal
        for goal in free_poses(load_map(MAP), FREE_M, 3 * count, np.random.default_rng(seed))
        if all(math.dist((goal.x, goal.y), thing) > NEAR_M for thing in things())
    ]
    stops: list[Stop] = []
    with tempfile.TemporaryDirectory() as folder:
        world = Path(folder) / "apartment.toml"
        text = (WORLDS / "apartment.toml").read_text().replace('"apartment.yaml"', f'"{MAP}"')
        # Top-level tables may come in any order, but not before the keys without one.
        world.write_text(text + FAST_MOTORS * is_fast)
        rest = f'[base.simulated]\nworld = "{world}"\nseed = {seed}\n' + FAST * is_fast
        with Lockstep("trolley", seed) as lockstep:
            config = make_config(MAP, START, rest)
            for service in (BaseService, LocalizerService, PlannerService):
                lockstep.add(service(config))
            truths, poses = lockstep.record(topics.SIM_TRUTH), lockstep.record(topics.POSE)
            said = lockstep.record(topics.GOAL)
            lockstep.run_until(lambda: bool(poses) and poses[-1].state == "localized", 30.0)
            for goal in goals:
                if len(stops) == count:
                    break
                try:
                    lockstep.ask(requests.GOAL_SEND, SendGoal(pose=goal))
                except codes.Refused:
                    continue  # In a room that cannot be reached, or too near to something.
                began_s = lockstep.now_s
                lockstep.run_until(lambda: said[-1].state in ENDED, LIMIT_S)
                seconds = lockstep.now_s - began_s
                lockstep.run(SETTLE_S)
                if said[-1].state != "arrived":
                    stops.append(Stop(said[-1].reason or said[-1].state, seconds))
                    continue
                told = poses[-1].pose
                true = _off(goal, truths[-1].pose)
                stops.append(
                    Stop("arrived", seconds, true if told is None else _off(goal, told), true)
                )
    return stops


def _off(goal: Pose2D, pose: Pose2D) -> tuple[float, float]:
    return goal.distance_to(pose), math.degrees(abs(wrap_angle(goal.yaw - pose.yaw)))


def main() -> None:
    """Drive, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--full", action="store_true")
    parser.add_argument("--fast", action="store_true")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--each", action="store_true", help="a line for each goal")
    given = parser.parse_args()
    left = FULL if given.full else given.count
    sizes = [min(GOALS_IN_A_RUN, left - done) for done in range(0, left, GOALS_IN_A_RUN)]
    context = multiprocessing.get_context("spawn")
    stops: list[Stop] = []
    with ProcessPoolExecutor(given.processes, mp_context=context) as pool:
        for run in pool.map(drive, range(len(sizes)), sizes, [given.fast] * len(sizes)):
            stops += run
            for stop in run if given.each else ():
                print(stop, flush=True)
    _report(stops)


def _report(stops: list[Stop]) -> None:
    """Print medians, 95 % and the worst beside the targets."""
    reached = [stop for stop in stops if stop.ending == "arrived"]
    print(f"{len(stops)} goals; not reached: {[s.ending for s in stops if s.ending != 'arrived']}")
    if not reached:
        return
    rows: list[list[str]] = []
    figures: list[Figure] = [at_least("arrived", 100.0 * len(reached) / len(stops), 99.0, "%", 1)]
    for name in ("told", "true"):
        for k, unit in ((0, "m"), (1, "deg")):
            off = np.array([getattr(stop, name)[k] for stop in reached])
            limit = (TOLERANCE_M, TOLERANCE_DEG)[k]
            what = "by the estimate" if name == "told" else "by the truth"
            cells = [f"{value:.3f}" for value in (*np.quantile(off, [0.5, 0.95]), off.max())]
            rows.append([f"{what} [{unit}]", *cells, f"{np.mean(off <= limit):.1%}"])
            figures.append(at_most(f"{what}, 95 %", float(np.quantile(off, 0.95)), limit, unit))
    table(["", "median", "95 %", "worst", "within"], rows)
    show(figures)


if __name__ == "__main__":
    main()
