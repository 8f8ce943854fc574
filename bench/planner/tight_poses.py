"""How long the search over poses takes in tight windows.

    python -m bench.planner.tight_poses [--seeds 5] [--each]

In every place of `situations.py` a way from the start to the goals is searched first; then pieces
of it of random length up to 1.6 m are searched anew as the planner does it while it drives: in a
window of 4.8 m around the robot, distances and all else included. Processor time of each search's
second run.
"""

import argparse
import time

import numpy as np
from bench.harness.figures import Figure, at_most, show, table
from bench.planner.situations import STATIC, Scene
from numpy.typing import NDArray

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D
from trolley_planner.context.planning_context import PlanningContext
from trolley_planner.costmap.footprint import Footprint
from trolley_planner.driving.maneuvering import MANEUVER
from trolley_planner.paths.hybrid_astar.pose_search import Task

TARGET_MS = 30.0
PIECES = 12
WHOLE_M = 8.0
"""Half of a window that holds the whole place."""
WANTED_M = 0.05


def main() -> None:
    """Time, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5, help="of each place")
    parser.add_argument("--each", action="store_true", help="a line for each search")
    given = parser.parse_args()
    rows: list[list[str]] = []
    every: list[float] = []
    num_missed = 0
    for row in STATIC:
        times: list[float] = []
        states: list[int] = []
        missed = 0
        for seed in range(given.seeds):
            found, num_states, num_none = _timed(row.scene(seed), seed, given.each)
            times += found
            states += num_states
            missed += num_none
        every += times
        num_missed += missed
        p50, p95, worst = np.percentile(times, [50, 95, 100])
        rows.append(
            [row.name, str(len(times)), f"{p50:.1f}", f"{p95:.1f}", f"{worst:.1f}",
             f"{np.median(states):.0f}", f"{max(states)}", str(missed)]
        )  # fmt: skip
    table(["", "searches", "ms p50", "p95", "max", "states p50", "max", "none found"], rows)
    show(
        [
            at_most("all, p50", float(np.percentile(every, 50)), TARGET_MS, "ms", 1),
            at_most("all, p95", float(np.percentile(every, 95)), TARGET_MS, "ms", 1),
            Figure("all, max", f"{max(every):.1f} ms"),
            at_most("none found", float(num_missed), 0.0, digits=0),
        ]
    )


def _timed(scene: Scene, seed: int, each: bool) -> tuple[list[float], list[int], int]:
    """Times of pieces [ms], the states that each reached, and how many found no way."""
    rng = np.random.default_rng(seed)
    footprint = Footprint.from_polygon(list(scene.body.corners))
    context = PlanningContext(scene.map(), footprint, PlannerConfig(), 0.5)
    to_grid = context.costmap.to_grid
    times: list[float] = []
    states: list[int] = []
    missed = 0
    here = to_grid(scene.start)
    for goal in map(to_grid, scene.goals):
        way = context.find_maneuver(Task(here, goal, False, 0.02, 0.03, WANTED_M), WHOLE_M)
        here = goal
        if way is None:
            missed += 1
            continue
        for _ in range(PIECES):
            task = _piece(way.poses, rng)
            for _ in range(2):
                before, begun = context.pose_search.num_states, time.thread_time()
                found = context.find_maneuver(task, MANEUVER.half_m)
                took_ms = 1e3 * (time.thread_time() - begun)
            times.append(took_ms)
            states.append(context.pose_search.num_states - before)
            missed += found is None
            if each:
                print(
                    f"{scene.name:24} {took_ms:6.1f} ms {states[-1]:7} states {found is not None}"
                )
    return times, states, missed


def _piece(poses: NDArray[np.float64], rng: np.random.Generator) -> Task:
    """The task of a piece of a way (n, 3)."""
    along = np.append(0.0, np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T)))
    first = int(rng.integers(len(poses) - 1))
    length = rng.uniform(0.3, MANEUVER.reach_m)
    last = min(int(np.searchsorted(along, along[first] + length)), len(poses) - 1)
    start, end = poses[first].tolist(), poses[max(last, first + 1)].tolist()
    return Task(Pose2D(*start), Pose2D(*end), False, 0.02, 0.03, WANTED_M)


if __name__ == "__main__":
    main()
