"""How long the planner takes to look again for a path on its way, beside a search anew.

    python -m bench.planner.replans [--full]

A robot drives along its path through ten furnished houses of 20 x 20 m, to random goals, and plans
again from each place that it comes to, up to three cells beside the path: first with the map as it
was, then with a thing of 15 x 15 cm on the path ahead, which appears at random and stays. The
reference is the same planner, told to forget what it knows, from the same place in the same run and
by turns. Times are processor times of one thread, so other work on the machine matters little.

What is found is judged, too: its cost beside that of the search anew.
"""

import argparse
import time
from dataclasses import dataclass, field

import numpy as np
from bench.harness.figures import Figure, at_most, show
from bench.harness.houses import draw_house
from bench.planner.paths import FOOTPRINT
from numpy.typing import NDArray

from trolley.config import PlannerConfig
from trolley_planner.costmap.costmap import Costmap
from trolley_planner.paths.corridor import Terrain
from trolley_planner.paths.cost_to_go import COST_OF_CELL, CostToGo

HOUSES, SIZE_M = 10, 20.0
LIMIT_MS = 0.5
STEP_CELLS, ASIDE_CELLS = 5, 3
THING_CELLS = 3


@dataclass
class Tally:
    """What was measured."""

    kept_ms: list[float] = field(default_factory=list)
    anew_ms: list[float] = field(default_factory=list)
    dearer: list[float] = field(default_factory=list)
    """Cost of the path by what was kept beside that of the search anew."""
    num_searches: int = 0


def terrain(
    weights: NDArray[np.uint8], distance_m: NDArray[np.float32], start: int, goal: int
) -> Terrain:
    """What is searched, for a start and a goal that are free."""
    cols = weights.shape[1]
    places = [(cell % cols + 0.5, cell // cols + 0.5, 0.0) for cell in (start, goal)]
    return Terrain(weights, distance_m, np.array(places), 240)


def drive(seed: int, with_things: bool, tally: Tally) -> None:
    """Drive to one goal."""
    rng = np.random.default_rng(seed)
    costmap = Costmap(draw_house(SIZE_M, seed % HOUSES), FOOTPRINT, PlannerConfig(), False)
    weights, distance_m, cols = costmap.weights.copy(), costmap.distance_m.copy(), costmap.shape[1]
    kept, anew = CostToGo(costmap.shape), CostToGo(costmap.shape)
    found = None
    start = goal = 0
    while found is None or len(found[0]) < 60:
        start, goal = (int(cell) for cell in rng.choice(np.flatnonzero(weights), 2))
        found = kept.cheapest_path(start, terrain(weights, distance_m, start, goal))
    while len(found[0]) > 30:
        cells = found[0]
        if with_things and rng.random() < 0.3:
            costmap.close(*_thing(cells, cols, costmap.resolution_m, rng))
            costmap.refresh()
            weights = costmap.weights.copy()
        ahead = int(cells[min(STEP_CELLS, len(cells) - 1)])
        start = ahead + int(rng.integers(-ASIDE_CELLS, ASIDE_CELLS + 1)) * int(
            rng.choice([1, cols])
        )
        if not weights.reshape(-1)[start]:
            start = ahead
        if not weights.reshape(-1)[[start, goal]].all():
            return
        land = terrain(weights, costmap.distance_m, start, goal)
        searches, times = kept.searches, [0.0, 0.0]
        began = time.thread_time()
        found = kept.cheapest_path(start, land)
        times[0] = time.thread_time() - began
        anew.forget()
        began = time.thread_time()
        best = anew.cheapest_path(start, land)
        times[1] = time.thread_time() - began
        if (found is None) != (best is None):
            raise SystemExit("what was kept and a search anew disagree whether there is a path")
        if found is None or best is None:
            return
        tally.num_searches += kept.searches - searches
        tally.kept_ms.append(1e3 * times[0])
        tally.anew_ms.append(1e3 * times[1])
        tally.dearer.append(found[1] / max(best[1], COST_OF_CELL))


def _thing(
    cells: NDArray[np.int32], cols: int, edge_m: float, rng: np.random.Generator
) -> tuple[float, float, float, int]:
    """A place on the path ahead where something appears: x, y, radius [m], time."""
    at = int(cells[min(int(rng.integers(20, 50)), len(cells) - 12)])
    return (at % cols + 0.5) * edge_m, (at // cols + 0.5) * edge_m, 0.5 * THING_CELLS * edge_m, 0


def main() -> None:
    """Time both kinds of drives."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--full", action="store_true", help="100 drives instead of 20")
    count = 100 if parser.parse_args().full else 20
    drive(0, True, Tally())  # Compiles the kernels.
    for name, with_things in (("the map as it was", False), ("things that appear", True)):
        tally = Tally()
        for seed in range(count):
            drive(seed, with_things, tally)
        kept, anew = np.array(tally.kept_ms), np.array(tally.anew_ms)
        show(
            [
                at_most(f"{name}: a plan again", float(kept.mean()), LIMIT_MS, "ms", 2),
                Figure("  the slowest of 100", f"{np.percentile(kept, 99):.2f} ms"),
                Figure("  a search anew", f"{anew.mean():.2f} ms"),
                Figure("  times faster", f"{anew.mean() / kept.mean():.1f}"),
                Figure("  searched anew", f"{100.0 * tally.num_searches / len(kept):.0f} %"),
                at_most(
                    "  cost / that of the search anew, mean", float(np.mean(tally.dearer)), 1.002
                ),
                Figure("  the same, worst", f"{max(tally.dearer):.3f}"),
                Figure("  plans", f"{len(kept)}"),
            ]
        )


if __name__ == "__main__":
    main()
