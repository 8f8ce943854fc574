"""Speed of the global planner beside NavFn, and its paths beside the best there are.

    python -m bench.planner.paths [--full]

A building of furnished rooms at 5 cm, inflated, planned across from corner to corner: 400 × 400
cells, with --full also 4000 × 4000. Both sides take the shortest of several runs; ours from the
costmap to the smooth path, with nothing kept; NavFn's without its path. Peer on one x86-64 core:
NavFn, compiled by -O2, 5.0 ms and 710 ms.

First plans between random places in houses follow, beside NavFn in the same run.

Then the paths through mazes, rooms and houses, with --full ten times as many. Without inflation,
where all floor costs the same, their length beside the shortest there is in any direction; with
it, their cost and their least distance from obstacles beside the cheapest along eight directions.
"""

import argparse
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from bench.harness.figures import Figure, at_least, at_most, show
from bench.harness.houses import draw_house
from bench.planner import best_paths, navfn
from bench.planner.mazes import draw_maze, furnish

from trolley.config import PlannerConfig
from trolley.gridmap import GridMap
from trolley_planner.costmap.costmap import Costmap
from trolley_planner.costmap.footprint import Footprint
from trolley_planner.costmap.inflation import LETHAL, WEIGHT_UNIT
from trolley_planner.paths.global_planner import GlobalPlanner
from trolley_planner.paths.path import polyline_cost

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
    # Alternates between two goals a cell apart, so that nothing kept is of use.
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


def first_plans(houses: int) -> list[Figure]:
    """Time of first plans between ten random pairs of places in each of some houses.

    Both sides by turns, each the shortest of three; processor time of one thread.
    """
    ours_s: list[float] = []
    theirs_s: list[float] = []
    for seed in range(houses):
        costmap = Costmap(draw_house(20.0, seed), FOOTPRINT, PlannerConfig(), False)
        nav, costs = navfn.make_navfn(*costmap.shape), ros_costs(costmap.weights)
        rng, cols, edge = np.random.default_rng(seed), costmap.shape[1], costmap.resolution_m
        free = np.flatnonzero(costmap.weights.reshape(-1))
        planners = [GlobalPlanner(costmap) for _ in range(3)]
        pairs = 0
        while pairs < 10:
            ends = [int(cell) for cell in rng.choice(free, 2)]
            if not navfn.plan(nav, costs, ends[1], ends[0]):
                continue
            points = [((cell % cols + 0.5) * edge, (cell // cols + 0.5) * edge) for cell in ends]
            times: list[tuple[float, float]] = []
            for planner in planners:  # Each has planned to another goal before.
                began = time.thread_time()
                planner.plan(points[0], points[1:], costmap.weights, costmap.distance_m)
                between = time.thread_time()
                navfn.plan(nav, costs, ends[1], ends[0])
                times.append((between - began, time.thread_time() - between))
            if seed + pairs > 0:  # The first one compiles.
                ours_s.append(min(one for one, _ in times))
                theirs_s.append(min(one for _, one in times))
            pairs += 1
    ours, theirs = 1e3 * np.array(ours_s), 1e3 * np.array(theirs_s)
    return [
        Figure(f"first plans in {houses} houses: NavFn", f"{theirs.mean():.2f} ms"),
        Figure("  ours", f"{ours.mean():.2f} ms"),
        at_least("  times faster, mean", float((theirs / ours).mean()), 4.0, digits=1),
        at_least("  times faster, the least", float((theirs / ours).min()), 1.0, digits=1),
    ]


def drawn(kind: str, seed: int) -> GridMap:
    """A map of a kind."""
    if kind == "mazes":
        return draw_maze(12.0, 0.8, seed)
    if kind == "rooms":
        return furnish(draw_maze(16.0, 3.2, seed, door_m=0.8, open_share=0.4), 0.15, seed)
    return draw_house(14.0, seed)


@dataclass
class Quality:
    """Ratios of the planner's paths to the best."""

    length: list[float] = field(default_factory=list)
    grid_cost: list[float] = field(default_factory=list)
    cost: list[float] = field(default_factory=list)
    nearer_m: list[float] = field(default_factory=list)
    """By how much the path comes nearer to something than the cheapest does."""
    num_wrong: int = 0
    """Refused though there is a path, or a path through a lethal cell."""


def judge(kind: str, seed: int, quality: Quality) -> None:
    """Compare some paths on one map, without inflation and with it."""
    rng = np.random.default_rng(seed)
    for height in (0.0, PlannerConfig().inflation_height):
        config = PlannerConfig(inflation_height=height)
        costmap = Costmap(drawn(kind, seed), FOOTPRINT, config, unknown_is_free=False)
        planner = GlobalPlanner(costmap)
        weights, cols, edge = costmap.weights, costmap.shape[1], costmap.resolution_m
        free = np.flatnonzero(weights.reshape(-1))
        for _ in range(4):
            start, goal = (int(cell) for cell in rng.choice(free, 2))
            ends = [(cell % cols + 0.5, cell // cols + 0.5) for cell in (start, goal)]
            best, way = best_paths.grid_way(weights, start, goal)
            if math.isinf(best) or math.dist(*ends) * edge < 2.0:
                continue
            points = [(x * edge, y * edge) for x, y in ends]
            path = planner.plan(points[0], points[1:], weights, costmap.distance_m)
            if path is None:
                quality.num_wrong += 1
                continue
            cost = polyline_cost(weights, path.points / edge, math.inf)
            quality.num_wrong += math.isinf(cost)
            if height == 0.0:
                shortest = best_paths.taut_length(weights, *ends)
                quality.length.append(path.length_m / edge / shortest)
                continue
            quality.grid_cost.append(path.cost * WEIGHT_UNIT / edge / best)
            quality.cost.append(cost / best)
            cells = np.floor(path.points / edge).astype(int)
            ours_m = costmap.distance_m[cells[:, 1], cells[:, 0]].min()
            quality.nearer_m.append(float(costmap.distance_m.reshape(-1)[way].min() - ours_m))


def quality_of(kind: str, maps: int) -> list[Figure]:
    """Figures of the paths on so many maps of a kind."""
    quality = Quality()
    for seed in range(maps):
        judge(kind, seed, quality)
    length, grid, cost = (
        np.array(one) for one in (quality.length, quality.grid_cost, quality.cost)
    )
    return [
        at_most(f"{kind}: wrong of {len(length) + len(cost)}", quality.num_wrong, 0, digits=0),
        at_most(f"{kind}: length / shortest, mean", length.mean(), 1.02, digits=4),
        at_most(f"{kind}: the longest", length.max(), 1.02, digits=4),
        Figure(f"{kind}: share at most 2 % longer", f"{100 * (length <= 1.02).mean():.1f} %"),
        at_most(f"{kind}: cost along cells / cheapest, mean", grid.mean(), 1.005, digits=4),
        at_most(f"{kind}: cost of the path / cheapest, worst", cost.max(), 1.02, digits=4),
        Figure(f"{kind}: the same, mean", f"{cost.mean():.4f}"),
        at_most(f"{kind}: nearer to obstacles, mean", float(np.mean(quality.nearer_m)), 0.02, "m"),
        Figure(f"{kind}: the same, worst", f"{max(quality.nearer_m):.3f} m"),
    ]


def main() -> None:
    """Print figures beside their targets."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--full", action="store_true", help="the large map and ten times as many paths, too"
    )
    args = parser.parse_args()
    show(speed(20.0, 8))
    show(first_plans(10))
    if args.full:
        show(speed(200.0, 2))
    for kind in ("mazes", "rooms", "houses"):
        show(quality_of(kind, 60 if args.full else 6))


if __name__ == "__main__":
    main()
