"""The global planner on MovingAI maps: length of its paths beside the optimum, and time.

    python -m bench.planner.movingai_maps FOLDER [--queries 200] [--seed 0]
    python -m bench.planner.movingai_maps [--full]   # on random maps of 256² or 1024² cells

FOLDER is searched with all folders in it for `.scen` files; their maps lie beside them or
anywhere in FOLDER. A point robot plans over free weights without inflation. For each map and for
all: the grid paths and the smooth paths as shares of the optimum, queries without a path though
there is one, paths found though there is none, and the time of a query from weights to smooth
path, nothing kept. The grid paths keep to eight directions as the optimum does; smooth paths
may be shorter. Each query that went wrong is named.
"""

import argparse
import math
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from bench.harness.figures import Figure, at_most, show, table
from bench.planner import best_paths
from bench.planner.movingai import (
    GROUND,
    WATER,
    Query,
    find_map,
    read_map,
    read_scen,
    write_map,
    write_scen,
)
from numpy.typing import NDArray

from trolley_planner.costmap.inflation import LETHAL, WEIGHT_UNIT
from trolley_planner.paths.corridor import Terrain
from trolley_planner.paths.cost_to_go import CostToGo
from trolley_planner.paths.path import polyline_cost, straighten

MOST_NAMED = 20
CELLS_PER_M = 20.0
"""Cells of 5 cm, as at home."""


@dataclass
class Tally:
    """The results of the queries on a map."""

    grid_ratios: list[float] = field(default_factory=list)
    smooth_ratios: list[float] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    missed: int = 0
    """No path found though there is one."""
    wrong: int = 0
    """Starts or ends elsewhere, touches a cell that is not passable, or is shorter than can be."""
    failures: list[str] = field(default_factory=list)
    """Of each of these, the query's line and what went wrong."""

    def add(self, other: "Tally") -> None:
        """Add another map's counts."""
        self.grid_ratios += other.grid_ratios
        self.smooth_ratios += other.smooth_ratios
        self.seconds += other.seconds
        self.missed += other.missed
        self.wrong += other.wrong
        self.failures += other.failures

    def row(self, name: str) -> list[str]:
        """Cells of a table."""
        if not self.grid_ratios:
            return [name, "0", "", "", "", "", str(self.missed), str(self.wrong), "", ""]
        grid, smooth = np.array(self.grid_ratios), np.array(self.smooth_ratios)
        times = 1e3 * np.array(self.seconds)
        return [
            name,
            str(len(grid)),
            f"{grid.mean():.5f}",
            f"{grid.max():.4f}",
            f"{smooth.mean():.4f}",
            f"{smooth.max():.4f}",
            str(self.missed),
            str(self.wrong),
            f"{times.mean():.2f}",
            f"{times.max():.2f}",
        ]


HEADS = (
    *("map", "queries", "grid mean", "max", "smooth mean", "max"),
    *("missed", "wrong", "mean ms", "max ms"),
)


class Runner:
    """Asks the planner on one map, which gets a rim that is not passable."""

    def __init__(self, cells: NDArray[np.uint8]) -> None:
        rows, cols = (size + 2 for size in cells.shape)
        self._weights = {kind: np.full((rows, cols), LETHAL, np.uint8) for kind in (GROUND, WATER)}
        for kind, weights in self._weights.items():
            weights[1:-1, 1:-1][cells == kind] = WEIGHT_UNIT
        self._cells = cells
        self._nowhere = np.zeros((rows, cols), np.float32)
        self._fields = CostToGo((rows, cols), near_cells=-1.0)

    def ask(self, query: Query, tally: Tally) -> None:
        """Plan, and count the result."""
        weights = self._weights[int(self._cells[query.start[1], query.start[0]])]
        cols = weights.shape[1]
        start, goal = ((x + 1.5, y + 1.5) for x, y in (query.start, query.goal))
        discs = np.array([[*goal, 0.0]])
        terrain = Terrain(weights, self._nowhere, discs, WEIGHT_UNIT)
        self._fields.forget()
        began_s = time.perf_counter()
        found = self._fields.cheapest_path(int(start[1]) * cols + int(start[0]), terrain)
        if found is None:
            if query.start == query.goal or query.optimum > 0.0:
                tally.missed += 1
                tally.failures.append(f"{query.place}: no path found")
            return
        cells = found[0]
        points = np.stack([cells % cols, cells // cols], axis=1).astype(np.float64) + 0.5
        if len(points) == 1:
            points = np.repeat(points, 2, axis=0)
        smooth = straighten(points, weights, CELLS_PER_M)
        tally.seconds.append(time.perf_counter() - began_s)
        grid_length, smooth_length = (
            float(np.hypot(*np.diff(path, axis=0).T).sum()) for path in (points, smooth)
        )
        touches = math.isinf(polyline_cost(weights, smooth, math.inf))
        ends = math.dist(smooth[0], start) + math.dist(smooth[-1], goal)
        too_short = grid_length < query.optimum - 1e-3
        if touches or ends > 1e-6 or too_short or (query.optimum == 0.0 and start != goal):
            tally.wrong += 1
            tally.failures.append(f"{query.place}: a wrong path of {smooth_length:.3f} cells")
        if query.optimum > 0.0:
            tally.grid_ratios.append(grid_length / query.optimum)
            tally.smooth_ratios.append(smooth_length / query.optimum)


def run(folder: Path, most: int, seed: int) -> tuple[dict[str, Tally], Tally]:
    """Tallies by map, and of all.

    Args:
        folder: with `.scen` and `.map` files, also in folders of its own.
        most: so many queries of a map at most, drawn at random; 0: all.
        seed: of that.

    Raises:
        ValueError: a file that cannot be used, or none at all.
    """
    maps = sorted(folder.rglob("*.map"))
    queries: dict[Path, list[Query]] = {}
    for path in sorted(folder.rglob("*.scen")):
        for query in read_scen(path):
            queries.setdefault(find_map(query, path, maps), []).append(query)
    if not queries:
        raise ValueError(f"{folder} holds no .scen files with queries")
    tallies: dict[str, Tally] = {}
    total = Tally()
    for path, asked in queries.items():
        cells = read_map(path)
        for query in asked:
            query.check(cells, path)
        runner = Runner(cells)
        if 0 < most < len(asked):
            chosen = np.random.default_rng(seed).permutation(len(asked))[:most]
            asked = [asked[int(index)] for index in chosen]
        runner.ask(asked[0], Tally())  # The first touches memory and may compile.
        tally = tallies[str(path.relative_to(folder))] = Tally()
        for query in asked:
            runner.ask(query, tally)
        total.add(tally)
    return tallies, total


def draw_files(folder: Path, size: int, queries: int, seed: int) -> None:
    """Write maps like those of the benchmark, with queries, into a folder."""
    rng = np.random.default_rng(seed)
    for name, passable in drawn_maps(size, rng).items():
        rows, cols = np.nonzero(passable)
        asked: list[Query] = []
        weights = np.pad(np.where(passable, WEIGHT_UNIT, LETHAL), 1).astype(np.uint8)
        while len(asked) < queries:
            a, b = rng.integers(0, len(rows), 2)
            start, goal = ((int(rows[k]) + 1) * (size + 2) + int(cols[k]) + 1 for k in (a, b))
            optimum = best_paths.grid_cost(weights, start, goal) / WEIGHT_UNIT
            if 0.0 < optimum < math.inf:
                ends = [(int(cols[k]), int(rows[k])) for k in (a, b)]
                asked.append(Query(f"{name}.map", ends[0], ends[1], optimum))
        write_map(folder / f"{name}.map", passable)
        write_scen(folder / f"{name}.map.scen", asked, passable.shape)


def drawn_maps(size: int, rng: np.random.Generator) -> dict[str, NDArray[np.bool_]]:
    """Maps (size, size) as the benchmark has them: random cells, rooms, mazes, blobs."""
    scattered = rng.random((size, size)) > 0.3
    rooms = np.ones((size, size), np.bool_)
    for at in range(16, size, 16):
        rooms[at] = rooms[:, at] = False
    for row in range(8, size, 16):
        for at in range(16, size, 16):
            if rng.random() < 0.85:
                rooms[min(row + int(rng.integers(-7, 8)), size - 1), at] = True
            if rng.random() < 0.85:
                rooms[at, min(row + int(rng.integers(-7, 8)), size - 1)] = True
    rough = rng.standard_normal((size, size))
    for _ in range(12):
        rough = sum(np.roll(rough, step, axis) for axis in (0, 1) for step in (-2, 1, 2)) / 6.0
    return {
        "random": scattered,
        "rooms": rooms,
        "dense": rng.random((size, size)) > 0.4,
        "maze 1": _thin_maze(size, rng),
        "maze 2": np.kron(_thin_maze(size // 2, rng), np.ones((2, 2), np.bool_)),
        "maze 4": np.kron(_thin_maze(size // 4, rng), np.ones((4, 4), np.bool_)),
        "blobs": rough < np.quantile(rough, 0.65),
    }


def _thin_maze(size: int, rng: np.random.Generator) -> NDArray[np.bool_]:
    """A maze of passages and walls of one cell, with a few loops."""
    passable = np.zeros((size, size), np.bool_)
    count = size // 2
    passable[0 : 2 * count : 2, 0 : 2 * count : 2] = True
    stack = [(0, 0)]
    seen = {(0, 0)}
    while stack:
        row, col = stack[-1]
        sides = ((row + 1, col), (row - 1, col), (row, col + 1), (row, col - 1))
        fresh = [one for one in sides if min(one) >= 0 and max(one) < count and one not in seen]
        if not fresh:
            stack.pop()
            continue
        side = fresh[int(rng.integers(len(fresh)))]
        passable[row + side[0], col + side[1]] = True
        seen.add(side)
        stack.append(side)
    passable |= rng.random((size, size)) < 0.01
    return passable


def _ratios(what: str, ratios: list[float]) -> list[Figure]:
    if not ratios:
        return []
    return [
        at_most(f"{what} / optimum, mean", float(np.mean(ratios)), 1.0, digits=5),
        at_most(f"{what} / optimum, longest", max(ratios), 1.02, digits=4),
    ]


def main() -> None:
    """Print a row for each map, and figures of all beside their targets."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?", help="with .scen and .map files")
    parser.add_argument("--queries", type=int, default=0, help="of each map at most; 0: all")
    parser.add_argument("--seed", type=int, default=0, help="of the choice of queries")
    parser.add_argument("--full", action="store_true", help="draw larger maps")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as drawn:
        if args.folder is None:
            draw_files(Path(drawn), 1024 if args.full else 256, 60, args.seed)
        try:
            tallies, total = run(args.folder or Path(drawn), args.queries, args.seed)
        except ValueError as error:
            sys.exit(str(error))
    rows = [tally.row(name) for name, tally in sorted(tallies.items())]
    table(HEADS, [*rows, total.row("all")])
    print("\n".join(total.failures[:MOST_NAMED]), end="\n" if total.failures else "")
    show(
        [
            at_most("no path found though there is one", total.missed, 0, digits=0),
            at_most("wrong paths", total.wrong, 0, digits=0),
            *_ratios("along cells", total.grid_ratios),
            *_ratios("smooth", total.smooth_ratios),
        ]
    )


if __name__ == "__main__":
    main()
