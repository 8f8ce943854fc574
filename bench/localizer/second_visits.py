"""Is the localizer honest where the map ends? Second visits of houses, and foreign maps.

    python -m bench.localizer.second_visits [--visits 2] [--late 0] [--keep DIR] [--full]

Each seed draws a house of one storey. A simulated robot drives through it once and the project's
mapper maps it; then another robot drives through all of it again, on the map of the first drive,
after something has changed (`CASES` in `bench/harness/second_visits.py`). "Wrong but sure" is the
share of the time in which it said `localized` and was over 0.5 m or 20 degrees off. "Back" is the
time from when the map knows half of what the lidar sees again until the robot is right and says
so. On foreign maps, those of other houses, it begins without a pose and must never be sure.
Second visits of recorded drives: a map of one half of the drive, or one that was cropped.

`--late`: results of searches arrive so many scans late. `--keep`: a folder for simulated drives.
"""

import argparse
import dataclasses
from pathlib import Path

import numpy as np
from bench.harness.figures import at_most, recordings_folder, show, table
from bench.harness.recorded import CREATE3, FREIBURG, MAPS, Recording, read_recording
from bench.harness.second_visits import (
    CASES,
    Track,
    Visit,
    Visits,
    cropped,
    follow,
    sure_after_m,
    way_m,
)

from trolley.gridmap import UNKNOWN, GridMap, load_map

HEADS = ["visit", "drives", "min", "off map %", "wrong but sure %", "worst", "sure %",
         "unsure but right %", "returns", "back s", "late returns", "median m"]  # fmt: skip
BACK_S = 5.0


def row(name: str, tracks: list[Track]) -> list[str]:
    """The line of a case."""
    wrong = [float(np.mean(one.is_sure & ~one.is_right)) for one in tracks]
    back = [s for one in tracks for s in one.returns_s()]
    known = np.concatenate([one.is_on_map for one in tracks])
    sure = np.concatenate([one.is_sure for one in tracks])
    right = np.concatenate([one.is_right for one in tracks])
    error_m = np.concatenate([one.error_m for one in tracks])
    minutes = sum(one.stamps_s[-1] - one.stamps_s[0] for one in tracks) / 60.0
    return [
        name,
        str(len(tracks)),
        f"{minutes:.0f}",
        f"{100.0 * np.mean(~known):.1f}",
        f"{100.0 * np.mean(wrong):.2f}",
        f"{100.0 * np.max(wrong):.2f}",
        f"{100.0 * np.mean(sure):.1f}",
        f"{100.0 * np.mean(known & right & ~sure):.1f}",
        str(len(back)),
        f"{np.max(back):.1f}" if back else "-",
        str(sum(s > BACK_S for s in back)),
        f"{np.median(error_m):.3f}",
    ]


def wrong_share(tracks: list[Track]) -> float:
    """Time wrong but sure, as a share of all [%]."""
    return 100.0 * float(np.mean(np.concatenate([t.is_sure & ~t.is_right for t in tracks])))


def simulated(visits: Visits, count: int, names: list[str], lates: list[int]) -> None:
    """Visit simulated houses again, in all the cases."""
    rows: list[list[str]] = []
    every: list[Track] = []
    for case in CASES:
        if names and not any(name in case.name for name in names):
            continue
        made = [visits.make(case, seed) for seed in range(count)]
        for late in lates:
            tracks = [follow(one, seed, late) for seed, one in enumerate(made)]
            every += tracks
            rows.append(row(case.name + (f", {late} scans late" if late else ""), tracks))
            print(rows[-1], flush=True)
    table(HEADS, rows)
    back = [s for one in every for s in one.returns_s()]
    show(
        [
            at_most("wrong but sure", wrong_share(every), 0.1, "%", 2),
            at_most("right again after coming back, longest", max(back, default=0.0), BACK_S, "s"),
        ]
    )


def foreign_maps(visits: Visits, houses: int, tries: int, lates: list[int]) -> None:
    """Search on maps of other houses, from scans all over a drive."""
    made = [visits.make(CASES[1], seed) for seed in range(houses)]
    reaches_m = (2.0, 10.0)
    sure_m: list[float] = []
    for number, visit in enumerate(made):
        grid = made[(number + 1) % houses].grid
        way = way_m(visit.truths)
        starts = np.linspace(0, np.searchsorted(way, way[-1] - reaches_m[-1]) - 1, tries)
        for first in starts.astype(int):
            late = lates[len(sure_m) % len(lates)]
            sure_m.append(sure_after_m(grid, visit, int(first), reaches_m[-1], late))
        print(number, [f"{m:.1f}" for m in sure_m[-tries:] if m < np.inf], flush=True)
    for reach_m, share in zip(reaches_m, (0.0, 0.01), strict=True):
        sure = int(np.sum(np.array(sure_m) < reach_m))
        name = f"foreign maps: sure within {reach_m:g} m, of {len(sure_m)}"
        show([at_most(name, sure, share * len(sure_m), digits=0)])


def recorded(folder: Path, seeds: int, lates: list[int]) -> None:
    """Second visits out of recorded drives."""
    rows: list[list[str]] = []
    every: list[Track] = []
    for fields in (FREIBURG, CREATE3):
        recording = read_recording(folder, *fields)
        grid = load_map(folder / MAPS[fields[0]])
        maps = {"cropped": cropped(grid, recording.reference_at(0))}
        if fields is not CREATE3:
            maps["map of its first third"] = seen_in(grid, recording, len(recording.stamps) // 3)
        for what, part in maps.items():
            visit = as_visit(recording, part)
            for late in lates:
                tracks = [follow(visit, seed, late) for seed in range(seeds)]
                every += tracks
                name = f"{fields[0]}, {fields[1]}: {what}"
                rows.append(row(name + (f", {late} late" if late else ""), tracks))
                print(rows[-1], flush=True)
    table(HEADS, rows)
    show([at_most("recorded: wrong but sure", wrong_share(every), 0.1, "%", 2)])


def as_visit(recording: Recording, grid: GridMap) -> Visit:
    """A recorded drive as a visit."""
    count = len(recording.stamps)
    return Visit(
        grid,
        [recording.scan(k) for k in range(count)],
        [recording.reference_at(k) for k in range(count)],
    )


def seen_in(grid: GridMap, recording: Recording, count: int) -> GridMap:
    """What the first scans of a drive saw of a map; the rest is unknown."""
    seen = np.zeros(grid.cells.shape, bool)
    steps = np.arange(0.0, 1.0, 0.5 * grid.resolution / 8.0)
    for k in range(0, count, 5):
        scan, pose = recording.scan(k), recording.reference_at(k)
        ranges = np.minimum(scan.ranges, 8.0) + 2 * grid.resolution
        angles = scan.angle_min + np.arange(ranges.size) * scan.angle_increment
        along = np.outer(ranges, steps).ravel()
        turned = np.repeat(angles, steps.size)
        points = np.column_stack([along * np.cos(turned), along * np.sin(turned)])
        cells = grid.world_to_cell((pose @ scan.base_T_laser).transform_points(points))
        cells = cells[grid.contains_cell(cells)]
        seen[cells[:, 0], cells[:, 1]] = True
    return dataclasses.replace(grid, cells=np.where(seen, grid.cells, UNKNOWN).astype(np.int8))


def main() -> None:
    """Visit and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--visits", type=int, default=2, help="of each case")
    parser.add_argument("--area", type=float, default=90.0, help="of a house [m^2]")
    parser.add_argument("--late", type=int, nargs="+", default=[0])
    parser.add_argument("--case", nargs="*", default=[], help="only cases whose names contain this")
    parser.add_argument("--only", choices=["simulated", "foreign", "recorded"])
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--tries", type=int, default=20, help="on each foreign map")
    parser.add_argument("--full", action="store_true", help="22 visits of each case")
    options = parser.parse_args()
    visits = Visits(options.area, options.keep)
    count = 22 if options.full else options.visits
    if options.only in (None, "simulated"):
        simulated(visits, count, options.case, options.late)
    if options.only in (None, "foreign"):
        foreign_maps(visits, max(2, min(count, 10)), options.tries, options.late)
    folder = recordings_folder() if options.only in (None, "recorded") else None
    if folder is not None:
        recorded(folder, min(count, 3), options.late)


if __name__ == "__main__":
    main()
