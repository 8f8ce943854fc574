"""How well the robot drives at home: doors, corners, corridors, dead ends and people.

    python -m bench.planner.home [--row door wall] [--seeds 3] [--lidar 360] [--each]
        [--stop-field] [--off-grid] [--draw-all] [--processes 1]

Base (simulated) and planner run in lock-step; the map and the true pose are given to the planner, so
that only it is judged. The base's stop field is off, unless `--stop-field` is given: the planner
must not need it. Unless a row says otherwise the robot is 0.35 x 0.30 m with its axle in the middle,
drives at up to 0.5 m/s and turns at up to 1.5 rad/s, on a map of 5 cm cells, with the settings of a
fresh robot.toml. Goals are kept to 5 cm and 3 degrees. Walls lie on borders of the map's cells;
`--off-grid` moves the cells by a random part of one, as a map made by a robot has them.

| row | group | what it is |
|---|---|---|
| door +5, +10, +15 cm | door | two rooms of 3 x 3 m, a door so much wider than the robot; from a random pose in one to a random pose in the other, and back |
| 0.60 x 0.60, door 0.70 | square | the same with a robot of 0.60 x 0.60 m |
| 2-5 cm beside a wall | wall | a goal so near to a wall, along it, in a room of 3 x 3 m; and away again |
| corner, 5 cm | corner | front and side 5 cm from walls; and away again |
| dead end 0.55, facing out | dead-end | 1.2 m deep, too wide to be no choice: in, looking out at the end (it can turn there); out |
| dead end 0.40, out again | dead-end | 1.2 m deep, too narrow to turn: in, looking in; out |
| L, Z, axle at the rear | bend | a corridor 0.60, 0.65 or 0.70 m wide with one bend or two, a robot of 0.60 x 0.42 m whose axle is 0.10 m from its back; in and back. Only where an exhaustive search finds a way that keeps 3 cm |

Time / ideal: the ideal is the shortest time of the footprint at full speed, turning included, by an
exhaustive search over poses (`all_poses.py`), 5 mm from the walls.

A run fails that does not reach all its goals within 120 s each, stands elsewhere than it says, or
touches anything while moving. Each failure is drawn into out/home/: walls grey, the map's cells light,
the robot once a second from blue (early) to red (late), goals green, contacts black.
"""  # noqa: E501  # a row of a table is one line

import argparse
import multiprocessing
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
from bench.harness.figures import table
from bench.planner.draw_visit import draw
from bench.planner.situations import CELL_M, STATIC, Row, Scene
from bench.planner.visit import LIDARS, Visit, drive

OUT = Path(__file__).resolve().parents[2] / "out" / "home"
ROWS = STATIC


def scene_of(row: Row, seed: int, *, is_off_grid: bool) -> Scene:
    """The scene of a row and a seed."""
    scene = row.scene(seed)
    if not is_off_grid:
        return scene
    x, y = np.random.default_rng((10, seed)).uniform(0.0, CELL_M, 2).tolist()
    return replace(scene, grid_shift=(x, y))


def run(name: str, seed: int, given: argparse.Namespace) -> Visit:
    """Drive one scene, and draw it if it failed."""
    row = next(row for row in ROWS if row.name == name)
    scene = scene_of(row, seed, is_off_grid=given.off_grid)
    visit = drive(scene, seed, given.lidar, has_stop_field=given.stop_field)
    visit.ideal_s = scene.ideal_s()
    if given.draw_all or not visit.is_success:
        OUT.mkdir(parents=True, exist_ok=True)
        label = "".join(sign if sign.isalnum() else "-" for sign in name)
        draw(visit, OUT / f"{label}-{seed}.png")
    return visit


def main() -> None:
    """Drive, and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    groups = list(dict.fromkeys(row.group for row in ROWS))
    parser.add_argument("--row", nargs="*", choices=groups, help="groups of rows; all if not given")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--lidar", choices=sorted(LIDARS), default="360")
    parser.add_argument("--stop-field", action="store_true")
    parser.add_argument("--off-grid", action="store_true", help="walls off the map's cells")
    parser.add_argument("--draw-all", action="store_true", help="pictures of successes, too")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--each", action="store_true", help="a line for each run")
    given = parser.parse_args()
    rows = [row for row in ROWS if given.row is None or row.group in given.row]
    seeds = range(given.first_seed, given.first_seed + given.seeds)
    jobs = [(row.name, seed, given) for row in rows for seed in seeds]
    visits: dict[str, list[Visit]] = {row.name: [] for row in rows}
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(given.processes, mp_context=context) as pool:
        for job, visit in zip(jobs, pool.map(run, *zip(*jobs, strict=True)), strict=True):
            visits[job[0]].append(visit)
            if given.each:
                print(line(job[0], visit), flush=True)
    where = f"lidar {given.lidar}, stop field {'on' if given.stop_field else 'off'}"
    print(f"{where}, {given.seeds} seeds{', off the grid' if given.off_grid else ''}")
    table(HEADS, [cells(row, visits[row.name]) for row in rows])


HEADS = ("", "reached", "time/ideal", "worst", "wanted", "", "recoveries", "contacts", "closest m",
         "why not")  # fmt: skip


def cells(row: Row, visits: Sequence[Visit]) -> list[str]:
    """A row of the table."""
    reached = [visit for visit in visits if visit.is_success]
    ratios = [visit.ratio for visit in reached]
    why = sorted({visit.ending for visit in visits if not visit.is_success})
    is_met = len(reached) == len(visits) and max(ratios) <= row.limit
    return [
        row.name,
        f"{len(reached)}/{len(visits)}",
        f"{np.mean(ratios):.2f}" if ratios else "-",
        f"{max(ratios):.2f}" if ratios else "-",
        f"≤ {row.limit:g}",
        "met" if is_met else "MISSED",
        f"{np.mean([visit.recoveries for visit in visits]):.1f}",
        str(sum(visit.touched for visit in visits)),
        f"{min(visit.closest_m for visit in visits):.3f}",
        ", ".join(why),
    ]


def line(name: str, visit: Visit) -> str:
    """One run."""
    return (
        f"{name:26} seed {visit.seed:3} {visit.ending:20} {visit.seconds:6.1f} s of "
        f"{visit.ideal_s:5.1f}, {visit.driven_m:5.1f} m, {visit.recoveries} recoveries, "
        f"closest {visit.closest_m:.3f} m"
    )


if __name__ == "__main__":
    main()
