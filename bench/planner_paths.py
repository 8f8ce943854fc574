"""Speed of the global planner beside NavFn, and its paths beside the best there are.

    python bench/planner_paths.py [--full]

A building of furnished rooms at 5 cm, inflated, planned across from corner to corner: 400 × 400
cells, with --full also 4000 × 4000. Both sides take the shortest of several runs; ours from the
costmap to the smooth path, with nothing kept; NavFn's without its path. Peer on one x86-64 core:
NavFn, compiled by -O2, 5.0 ms and 710 ms.
"""

import argparse
import time
from collections.abc import Callable

import navfn
import numpy as np
from figures import Figure, at_least, show
from mazes import draw_maze, furnish

from trolley.config import PlannerConfig
from trolley_planner.costmap import Costmap
from trolley_planner.footprint import Footprint
from trolley_planner.global_planner import GlobalPlanner
from trolley_planner.kernels.layers import LETHAL

FOOTPRINT = Footprint.from_polygon([(0.15, 0.12), (-0.15, 0.12), (-0.15, -0.12), (0.15, -0.12)])
PEER_MS = {20.0: 5.0, 200.0: 710.0}
TARGETS = {20.0: 4.0, 200.0: 8.0}


def shortest_ms(work: Callable[[], object], repeats: int) -> float:
    """The shortest of many runs [ms]."""
    times: list[float] = []
    for _ in range(repeats):
        began_s = time.perf_counter()
        work()
        times.append(time.perf_counter() - began_s)
    return min(times) * 1e3


def ros_costs(weights: np.ndarray) -> np.ndarray:
    """Weights as costs of ROS: lethal 254, else 0 to 252."""
    extra = (weights.astype(np.float64) - 4.0) / 32.0
    costs = np.clip(extra * 252.0, 0.0, 252.0).astype(np.uint8)
    costs[weights == LETHAL] = 254
    return costs


def speed(size_m: float, repeats: int) -> list[Figure]:
    """Time of a plan on a new map of this size, ours and NavFn's."""
    grid = furnish(draw_maze(size_m, 4.0, 1, door_m=1.0, open_share=0.6), 0.15, 1)
    costmap = Costmap(grid, FOOTPRINT, PlannerConfig(), unknown_is_free=False)
    weights, cols = costmap.weights, costmap.shape[1]
    rows, columns = np.nonzero(weights)
    corners = [int(np.argmin(rows + columns)), int(np.argmax(rows + columns))]
    start, goal = (int(rows[k] * cols + columns[k]) for k in corners)
    edge = costmap.resolution_m

    def point(cell: int) -> tuple[float, float]:
        return (cell % cols + 0.5) * edge, (cell // cols + 0.5) * edge

    costs = ros_costs(weights)
    nav = navfn.make_navfn(*costmap.shape)
    planner = GlobalPlanner(costmap)
    distance_m = costmap.distance_m
    # By turns to two goals a cell apart, so that nothing kept is of use.
    goals = [point(goal), point(goal - 1)]
    turn = 0

    def ours() -> None:
        nonlocal turn
        turn += 1
        path = planner.plan(point(start), [goals[turn % 2]], weights, distance_m)
        assert path is not None

    def theirs() -> None:
        assert navfn.plan(nav, costs, goal, start)

    ours()
    theirs()
    pairs = [(shortest_ms(theirs, repeats), shortest_ms(ours, repeats)) for _ in range(4)]
    their_ms, our_ms = (min(times) for times in zip(*pairs, strict=True))
    kept_ms = shortest_ms(
        lambda: planner.plan(point(start), [goals[0]], weights, distance_m), repeats
    )
    name = f"{costmap.shape[0]} × {cols}"
    return [
        Figure(f"{name}: NavFn", f"{their_ms:.2f} ms", f"{PEER_MS[size_m]:g} ms of -O2"),
        Figure(f"{name}: ours", f"{our_ms:.2f} ms"),
        Figure(f"{name}: ours, kept cost-to-go", f"{kept_ms:.2f} ms"),
        at_least(f"{name}: times faster", their_ms / our_ms, TARGETS[size_m], digits=1),
    ]


def main() -> None:
    """Print figures beside their targets."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--full", action="store_true", help="the large map, too")
    args = parser.parse_args()
    show(speed(20.0, 8))
    if args.full:
        show(speed(200.0, 2))


if __name__ == "__main__":
    main()
