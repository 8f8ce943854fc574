"""Is the localizer honest where the map ends? Second visits of houses, and foreign maps.

    python -m bench.localizer.second_visits [--visits 2] [--late 0] [--keep DIR] [--full]
    nice python -m bench.localizer.second_visits --full --keep DIR --results FILE --minutes 9
    python -m bench.localizer.second_visits --only foreign --drawn --visits 50 --tries 4 --reach 2
    python -m bench.localizer.second_visits --only foreign --drawn --reach 2 --lidar 180

Each number is a house of one storey. A simulated robot drives through it once and the project's
mapper maps it; then another robot drives through all of it again and on to places at random, for 10
minutes, on the map of the first drive, after something has changed (`CASES` in
`bench/harness/second_visits.py`). "Wrong but sure" is the share of the time in which it said
`localized` and was over 0.5 m or 20 degrees off. "Back" is the time from when the map knows half of
what the lidar sees again until the robot is right and says so. On foreign maps, those of other
houses, it begins without a pose and must never be sure; each try is on another map, as the mapper
made it or without errors. With bad inputs (`bench/harness/bad_inputs.py`) it begins with the pose
of the start, and again without. Second visits of recorded drives: a map of one half of the drive,
or one that was cropped.

`--houses odd`: houses by other rules, which nobody tuned the localizer on. `--late`: results of
searches arrive so many scans late. `--keep`: a folder for simulated drives. `--results`: what the
file holds is not run again, what is new is appended, so that the bench can be run in slices of
`--minutes`; use another file after a change of the localizer.
"""

import argparse
import dataclasses
import itertools
import time
from functools import partial
from pathlib import Path

import numpy as np
from bench.harness.bad_inputs import BAD_INPUTS, spoil
from bench.harness.figures import (
    Figure,
    at_most,
    recordings_folder,
    show,
    table,
    wilson_upper,
)
from bench.harness.recorded import CREATE3, FREIBURG, MAPS, Recording, read_recording
from bench.harness.results import Result, Slices
from bench.harness.second_visits import (
    CASES,
    HOUSES,
    LIDARS,
    LONGEST_S,
    Case,
    Track,
    Visit,
    Visits,
    cropped,
    follow,
    sure_on,
    told_at,
    way_m,
)

from trolley.gridmap import UNKNOWN, GridMap, load_map

HEADS = ["visit", "drives", "min", "off map %", "wrong but sure %", "worst", "sure %",
         "unsure but right %", "returns", "back s", "late returns", "median m",
         "core %"]  # fmt: skip
BACK_S = 5.0
REACHES_M = (2.0, 10.0)


def summary(track: Track) -> Result:
    """The figures of a visit."""
    wrong = track.is_sure & ~track.is_right
    unsure = track.is_on_map & track.is_right & ~track.is_sure
    return {
        "min": round(float(track.stamps_s[-1] - track.stamps_s[0]) / 60.0, 2),
        "off_map": round(float(np.mean(~track.is_on_map)), 5),
        "wrong": round(float(np.mean(wrong)), 5),
        "sure": round(float(np.mean(track.is_sure)), 5),
        "unsure": round(float(np.mean(unsure)), 5),
        "back_s": [round(s, 1) for s in track.returns_s()],
        "median_m": round(min(float(np.median(track.error_m)), 1e5), 3),
        "wrongs": track.wrongs(),
    }


def followed(visit: Visit, seed: int, late: int) -> Result:
    """The figures of a visit, and which share of a core it took to locate and to search."""
    began_s = time.process_time()
    track = follow(visit, seed, late)
    used_s = time.process_time() - began_s
    return summary(track) | {"core": round(used_s / float(np.ptp(track.stamps_s)), 5)}


def rows(results: list[Result], name_of: str) -> list[list[str]]:
    """The lines of a table: one for each name, and one for all of them."""
    names = list(dict.fromkeys(one[name_of] for one in results))
    lines = [_row(name, [one for one in results if one[name_of] == name]) for name in names]
    return [*lines, _row("all", results)]


def _row(name: str, results: list[Result]) -> list[str]:
    minutes = np.array([one["min"] for one in results])

    def mean(what: str) -> float:
        return 100.0 * float(np.average([one[what] for one in results], weights=minutes))

    back = [s for one in results for s in one["back_s"]]
    return [
        name,
        str(len(results)),
        f"{minutes.sum():.0f}",
        f"{mean('off_map'):.1f}",
        f"{mean('wrong'):.3f}",
        f"{100.0 * max(one['wrong'] for one in results):.2f}",
        f"{mean('sure'):.1f}",
        f"{mean('unsure'):.1f}",
        str(len(back)),
        f"{max(back):.1f}" if back else "-",
        str(sum(s > BACK_S for s in back)),
        f"{np.median([one['median_m'] for one in results]):.3f}",
        f"{mean('core'):.2f}",
    ]


def show_visits(results: list[Result], name_of: str, what: str) -> None:
    """Print the table of visits, and whether they meet the goals."""
    if not results:
        return
    lines = rows(results, name_of)
    table(HEADS, lines)
    back = [s for one in results for s in one["back_s"]]
    late = sum(s > BACK_S for s in back)
    show(
        [
            at_most(f"{what}: wrong but sure", float(lines[-1][4]), 0.1, "%", 3),
            at_most(f"{what}: right again after {BACK_S:g} s, of {len(back)}", late, 0, digits=0),
        ]
    )


@dataclasses.dataclass(frozen=True)
class Bench:
    """What is visited, and where the results go."""

    visits: Visits
    slices: Slices
    ident: Result
    """What is the same for all of it."""
    lates: list[int]
    """Results of searches arrive so many scans late."""

    def simulated(self, numbers: range, names: list[str]) -> None:
        """Visit simulated houses again, in all the cases."""
        for number, case, late in itertools.product(numbers, CASES, self.lates):
            # Where walls are round there is nothing to build a corridor on to.
            is_possible = not case.is_extended or self.ident["houses"] == "square"
            if is_possible and is_wanted(case.name, names):
                key = self.ident | {"visit": case.name, "number": number, "late": late}
                self.slices.run(key, partial(self._visit, case, number, late))
        show_visits(self.slices.having("visit"), "visit", "visits")

    def _visit(self, case: Case, number: int, late: int) -> Result:
        visit = self.visits.make(case, number)
        return self._seed(number) | followed(visit, number, late)

    def bad_inputs(self, numbers: range, names: list[str]) -> None:
        """Visit simulated houses again with maps that were mixed up, and a blind lidar."""
        for number, name, is_told in itertools.product(numbers, BAD_INPUTS, (True, False)):
            bad = name + ("" if is_told else ", no pose")
            late = self.lates[number % len(self.lates)]
            if is_wanted(bad, names):
                key = self.ident | {"bad": bad, "number": number, "late": late}
                self.slices.run(key, partial(self._spoilt, name, number, late, is_told=is_told))
        show_visits(self.slices.having("bad"), "bad", "bad inputs")

    def _spoilt(self, name: str, number: int, late: int, *, is_told: bool) -> Result:
        visit = spoil(name, self.visits, number, is_told=is_told)
        return self._seed(number) | followed(visit, number, late)

    def _seed(self, number: int) -> Result:
        return {"house": self.visits.seed_of(number)}

    def foreign_maps(
        self, numbers: range, tries: int, reach_m: float, lidar: str, *, drawn_only: bool
    ) -> None:
        """Search on maps of other houses, from scans all over a drive."""
        for number, k in itertools.product(numbers, range(tries)):
            # Mapping takes long: a map of the mapper serves several tries, one without errors one.
            is_drawn = drawn_only or k % 2 == 1
            other = number + 1 + (k if is_drawn else k % 4)
            key = self.ident | {"foreign": other, "drawn": is_drawn, "number": number, "try": k}
            key |= {"tries": tries, "reach_m": reach_m, "late": self.lates[k % len(self.lates)]}
            key["lidar"] = lidar
            self.slices.run(key, partial(self._search, key))
        results = self.slices.having("foreign")
        for reach_m, share in zip(REACHES_M, (0.0, 0.01), strict=True):
            found = [one["sure_m"] for one in results if one["reach_m"] >= reach_m]
            sure_m = [np.inf if m is None else m for m in found]
            sure = sum(m < reach_m for m in sure_m)
            name = f"foreign maps: sure within {reach_m:g} m, of {len(sure_m)}"
            most = f"≤ {100.0 * wilson_upper(sure, len(sure_m)):.1f} %"
            show(
                [
                    at_most(name, sure, share * len(sure_m), digits=0),
                    Figure(f"{name}: share, at 95 % confidence", most),
                ]
            )

    def _search(self, key: Result) -> Result:
        visits, other = self.visits, key["foreign"]
        grid = visits.plan(visits.seed_of(other)).built() if key["drawn"] else visits.mapped(other)
        visit = visits.on_map(grid, key["number"], LIDARS[key["lidar"]])
        way = way_m(visit.truths)
        last = np.searchsorted(way, way[-1] - key["reach_m"]) - 1
        first = int(np.linspace(0, last, key["tries"])[key["try"]])
        sure = sure_on(visit, first, key["reach_m"], key["late"])
        return self._seed(key["number"]) | {"scan": first} | sure


def is_wanted(name: str, parts: list[str]) -> bool:
    """Whether a name contains one of the parts, if there are any."""
    return not parts or any(part in name for part in parts)


def recorded(slices: Slices, folder: Path, seeds: int, lates: list[int]) -> None:
    """Second visits out of recorded drives."""
    for fields in (FREIBURG, CREATE3):
        recording = read_recording(folder, *fields)
        grid = load_map(folder / MAPS[fields[0]])
        maps = {"cropped": cropped(grid, recording.reference_at(0))}
        if fields is not CREATE3:
            maps["map of its first third"] = seen_in(grid, recording, len(recording.stamps) // 3)
        for what, part in maps.items():
            visit = as_visit(recording, part)
            for late, seed in itertools.product(lates, range(seeds)):
                key: Result = {"recorded": f"{fields[0]}, {fields[1]}: {what}"}
                key |= {"number": seed, "late": late}
                slices.run(key, partial(_summarize, visit, seed, late))
    show_visits(slices.having("recorded"), "recorded", "recorded")


def _summarize(visit: Visit, seed: int, late: int) -> Result:
    return followed(visit, seed, late)


def as_visit(recording: Recording, grid: GridMap) -> Visit:
    """A recorded drive as a visit."""
    count = len(recording.stamps)
    truths = [recording.reference_at(k) for k in range(count)]
    return Visit(grid, [recording.scan(k) for k in range(count)], truths, told_at(truths[0]))


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
    parser.add_argument("--first", type=int, default=0, help="number of the first house")
    parser.add_argument("--houses", choices=list(HOUSES), default="square")
    parser.add_argument("--area", type=float, default=90.0, help="of a house [m^2]")
    parser.add_argument("--seconds", type=float, default=LONGEST_S, help="of a drive")
    parser.add_argument("--late", type=int, nargs="+", default=[0])
    parser.add_argument("--case", nargs="*", default=[], help="only cases whose names contain this")
    parser.add_argument("--only", choices=["simulated", "foreign", "bad", "recorded"])
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--results", type=Path)
    parser.add_argument("--minutes", type=float, default=np.inf, help="begin nothing after that")
    parser.add_argument("--tries", type=int, default=20, help="on foreign maps, from each drive")
    parser.add_argument(
        "--reach", type=float, default=REACHES_M[-1], help="driven on a foreign map at most [m]"
    )
    parser.add_argument(
        "--lidar", choices=list(LIDARS), default="360", help="of the robot on foreign maps"
    )
    parser.add_argument("--drawn", action="store_true", help="foreign maps without errors only")
    parser.add_argument("--full", action="store_true", help="22 visits of each case")
    options = parser.parse_args()
    count = 22 if options.full else options.visits
    numbers = range(options.first, options.first + count)
    bench = Bench(
        Visits(options.area, options.keep, options.houses, options.seconds),
        Slices(options.results, options.minutes),
        {"houses": options.houses, "area": options.area, "seconds": options.seconds},
        options.late,
    )
    if options.only in (None, "simulated"):
        bench.simulated(numbers, options.case)
    if options.only in (None, "foreign"):
        houses = numbers if options.drawn else numbers[:10]
        bench.foreign_maps(
            houses, options.tries, options.reach, options.lidar, drawn_only=options.drawn
        )
    if options.only in (None, "bad"):
        bench.bad_inputs(numbers[:3], options.case)
    folder = recordings_folder() if options.only in (None, "recorded") else None
    if folder is not None:
        recorded(bench.slices, folder, min(count, 3), options.late)
    if bench.slices.left:
        print(f"time is over: {bench.slices.left} left; run it again with the same --results")


if __name__ == "__main__":
    main()
