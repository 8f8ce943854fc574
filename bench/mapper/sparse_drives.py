"""How well the mapper maps what it sees too seldom: large buildings, few scans, half a view.

    python -m bench.mapper.sparse_drives [--only NAME ...] [--seeds 1 2 3] [--pictures FOLDER]

Recorded drives, all their scans and thinned to one a few decimetres (TROLLEY_DATA names their
folder), and drives through generated buildings of 500 to 5000 m², a scan a metre, 180°, 8 m of
reach, odometry 5 % off. "Wrong" are revisits that the map shows more than 0.5 m from where they
truly lie to what was seen there before, "unsaid" those of them at which the mapper said that all
was well, "doubted" the places of the finished map of which it is said that they may be wrong.
"Loops" are those that close on the map, of those that were driven; "edges" the closures that the
mapper found, joins among them; "step" and "slice" the 99th percentile and the greatest CPU time of
one step and one slice of a search. "+MB" is what this process grew by at most; what a
drive before it left free counts too little, so measure it with one drive.
Peers' figures stand where they are known, and are those of a drive of that kind, not the same one.
"""

import argparse
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from bench.harness.figures import Figure, at_least, at_most, recordings_folder, show, table
from bench.harness.mapping import MappedDrive, map_drive
from bench.harness.recorded import CREATE3, FREIBURG, Recording, read_recording
from bench.mapper import map_metrics
from bench.mapper.buildings import Building, Drive, Plan, draw_building, record
from bench.mapper.recorded_drives import relation_errors
from numpy.typing import NDArray
from PIL import Image

from trolley.config.mapper import MapperConfig
from trolley.geometry import Pose2D
from trolley.gridmap import UNKNOWN, GridMap
from trolley_mapper.slam.mapper import Mapper
from trolley_mapper.warmup import warm_up

FREIBURG_STEPS_M = (0.3, 0.6, 1.0)
MIB = 1024.0

GMAPPING_LAB = "GMapping 0 %, 0.05/0.18"
"""Revisits off by more than 0.5 m, mean and greatest error [m] of the best peer, measured on public
logs: a research lab's floor, 500 m of loops."""
GMAPPING_OFFICES = "GMapping 0 %, 0.23/0.74"
"""The same on a floor of offices, 380 m."""
KARTO_WINGS = "Karto 0 %, 0.09/0.36"
"""The same in a building of 66 x 60 m with wings."""
ALL_FAIL = "all fail"
"""Wheels that miss a turn of 80°: no peer was right."""
CARTOGRAPHER_RELATIONS_M = 0.045
"""Mean error of the relations of freiburg-079 that is published for Cartographer [m]."""


@dataclass(frozen=True)
class Case:
    """One kind of drive through one kind of building."""

    plan: Plan
    drive: Drive
    peer: str = ""
    known_share: float = 0.0
    """It begins lost on a map of so much of the building, from its left."""


CASES = {
    "offices-500": Case(Plan((2, 1)), Drive(way_m=250.0), GMAPPING_OFFICES),
    "offices-800": Case(Plan((2, 2)), Drive(way_m=380.0), GMAPPING_OFFICES),
    "lab-1800": Case(
        Plan((3, 3), glass_share=0.2, clutter_per_m2=0.2, people=5),
        Drive(way_m=500.0),
        GMAPPING_LAB,
    ),
    "wings-2300": Case(Plan((2, 5), (22.0, 10.0), is_alike=True), Drive(way_m=600.0), KARTO_WINGS),
    "hall-5000": Case(Plan((5, 5), people=10), Drive(way_m=800.0)),
    "glass": Case(Plan((2, 2), glass_share=0.8), Drive(way_m=300.0)),
    "missed-turns": Case(Plan((2, 2)), Drive(way_m=300.0, missed_turns=2), ALL_FAIL),
    "ten-rooms": Case(Plan((1, 1), (22.5, 10.0), (4.2, 4.2), is_identical=True), Drive(200.0, 0.9)),
    "starts-lost": Case(Plan((3, 2)), Drive(way_m=250.0), known_share=0.5),
    "no-gyro": Case(Plan((2, 2)), Drive(way_m=300.0, turn_error=0.15, noise=0.05)),
    "2-hz": Case(Plan((2, 2)), Drive(way_m=300.0, step_m=0.25, step_rad=0.5)),
    "covered": Case(Plan((2, 2)), Drive(way_m=300.0, covered_s=60.0)),
}


@dataclass(frozen=True)
class Result:
    """What became of one drive."""

    name: str
    recording: Recording
    grid: GridMap
    drive: MappedDrive
    edges: int
    num_doubtful: int
    """Places of the finished map of which it is said that they may be wrong."""
    grown_mb: float
    peer: str
    relations_m: float | None = None

    @property
    def found(self) -> NDArray[np.float64]:
        """(n, 3) the poses as the finished map has them."""
        return np.array([pose.as_array() for pose in self.drive.poses])

    @property
    def is_sure(self) -> NDArray[np.bool_]:
        """(n,) where the mapper said that all was well."""
        return np.array(self.drive.states) == "mapping"

    @property
    def revisits(self) -> map_metrics.Revisits:
        """Where the drive came back to places."""
        return map_metrics.revisits(self.found, self.recording.reference)

    @property
    def errors_m(self) -> NDArray[np.float64]:
        """(n,) how far each pose is off after alignment [m]."""
        return map_metrics.errors_m(self.found, self.recording.reference)

    @property
    def unsaid_share(self) -> float:
        """Share of the revisits that are wrong without a word of the mapper."""
        return self.revisits.unsaid_share(self.is_sure)


def follow(
    name: str,
    recording: Recording,
    peer: str = "",
    prior: GridMap | None = None,
    start: Pose2D | None = None,
) -> Result:
    """Map a drive, a new map or one that begins lost on a map that is there."""
    begin_mb = _forget_peak_mb()
    mapper = Mapper(MapperConfig(), start, prior)
    drive = map_drive(mapper, (recording.scan(row) for row in range(len(recording.stamps))))
    grown_mb = memory_mb("VmHWM") - begin_mb
    num_doubtful = len(mapper.doubtful())
    return Result(
        name, recording, mapper.grid(), drive, mapper.num_loops, num_doubtful, grown_mb, peer
    )


def memory_mb(what: str) -> float:
    """What this process takes now (`VmRSS`) or took at most (`VmHWM`) [MB]."""
    status = Path("/proc/self/status").read_text()
    found = re.search(rf"^{what}:\s+(\d+) kB$", status, re.MULTILINE)
    assert found is not None, f"{what} is not in /proc/self/status"
    return int(found.group(1)) / MIB


def _forget_peak_mb() -> float:
    """Let the greatest memory count anew from now on; returns what is taken now [MB]."""
    Path("/proc/self/clear_refs").write_text("5")
    return memory_mb("VmRSS")


def known_part(building: Building, share: float, resolution_m: float) -> GridMap:
    """The true map of a share of the building, from its left; the rest is unknown."""
    grid = building.grid
    times = round(grid.resolution / resolution_m)
    cells = np.kron(grid.cells, np.ones((times, times), np.int8))
    cells[:, round(share * cells.shape[1]) :] = UNKNOWN
    return GridMap(grid.name, grid.resolution / times, grid.origin, cells)


def from_recordings(folder: Path) -> dict[str, Callable[[], Result]]:
    """The recorded drives by name."""

    def dense() -> Result:
        result = follow("freiburg", read_recording(folder, *FREIBURG))
        metres, _ = relation_errors(folder, result.drive.poses)
        return replace(result, relations_m=float(metres.mean()))

    def thinned(name: str, step_m: float) -> Result:
        return follow(name, read_recording(folder, *FREIBURG).thinned(step_m, 0.0, 0))

    runs: dict[str, Callable[[], Result]] = {"freiburg": dense}
    for step_m in FREIBURG_STEPS_M:
        name = f"freiburg-{step_m:g}"
        runs[name] = lambda name=name, step_m=step_m: thinned(name, step_m)
    runs["create3"] = lambda: follow("create3", read_recording(folder, *CREATE3))
    return runs


def through_building(name: str, seed: int) -> Result:
    """Draw a building and map a drive through it."""
    case = CASES[name]
    building = draw_building(case.plan, seed)
    recording = record(building, case.drive, seed)
    prior = None
    if case.known_share:
        prior = known_part(building, case.known_share, MapperConfig().resolution_m)
    return follow(f"{name} {seed}", recording, case.peer, prior)


HEADS = [
    "drive", "scans", "way m", "1-10 m", "wrong %", "unsaid %", "doubted", "mean m", "max m",
    "loops", "edges", "lost %", "CPU ms", "step ms", "slice ms", "+MB", "best peer",
]  # fmt: skip


def row(one: Result) -> list[str]:
    """The line of a drive in the table."""
    revisits, errors_m = one.revisits, one.errors_m
    cpu_s = one.drive.step_s.sum() + one.drive.slice_s.sum()
    truth = one.recording.reference
    return [
        one.name,
        str(len(truth)),
        f"{map_metrics.way_m(truth)[-1]:.0f}",
        f"{map_metrics.relative_error_m(one.found, truth):.3f}",
        f"{100.0 * revisits.wrong_share:.0f}",
        f"{100.0 * one.unsaid_share:.0f}",
        str(one.num_doubtful),
        f"{errors_m.mean():.2f}",
        f"{errors_m.max():.2f}",
        f"{revisits.num_closed}/{revisits.num_loops}",
        str(one.edges),
        f"{100.0 * one.drive.states.count('lost') / len(truth):.0f}",
        f"{1e3 * cpu_s / len(truth):.1f}",
        _p99_max(one.drive.step_s),
        _p99_max(one.drive.slice_s),
        f"{one.grown_mb:.0f}",
        one.peer,
    ]


def _p99_max(seconds: NDArray[np.float64]) -> str:
    """The 99th percentile and the greatest of times, in ms."""
    return f"{1e3 * np.quantile(seconds, 0.99):.0f}/{1e3 * seconds.max():.0f}"


def figures(results: list[Result]) -> list[Figure]:
    """The figures that have targets."""
    found = [
        at_most(f"{one.name}: relations", one.relations_m, CARTOGRAPHER_RELATIONS_M, "m", 4)
        for one in results
        if one.relations_m is not None
    ]
    drawn = [one for one in results if one.name.split()[0] in CASES]
    if drawn:
        right = sum(not one.revisits.is_wrong.any() for one in drawn)
        unsaid = 100.0 * max(one.unsaid_share for one in drawn)
        found += [
            at_least("buildings without a wrong revisit", 100.0 * right / len(drawn), 95.0, "%", 0),
            at_most("wrong and unsaid revisits, worst", unsaid, 0.0, "%", 1),
        ]
    doubted_wrongly = sum(
        one.num_doubtful > 0 and not one.revisits.is_wrong.any() for one in results
    )
    not_doubted = sum(one.num_doubtful == 0 and one.unsaid_share > 0.0 for one in results)
    step_s = max(float(np.quantile(one.drive.step_s, 0.99)) for one in results)
    slice_s = max(float(one.drive.slice_s.max()) for one in results)
    return [
        *found,
        at_most("right maps that are doubted", doubted_wrongly, 0.0, "", 0),
        at_most("maps wrong and unsaid that are not doubted", not_doubted, 0.0, "", 0),
        at_most("step, 99 of 100, worst drive", 1e3 * step_s, 50.0, "ms CPU", 0),
        at_most("slice of a search, longest of all", 1e3 * slice_s, 50.0, "ms CPU", 0),
        at_most("growth of memory, worst", max(one.grown_mb for one in results), 300.0, "MB", 0),
    ]


def draw(one: Result, file: Path) -> None:
    """Draw the map, the true path (green), the found one (blue) and its wrong revisits (red)."""
    shades = np.where(one.grid.cells < 0, 205, np.where(one.grid.cells >= 65, 0, 255))
    image = np.repeat(shades.astype(np.uint8)[..., None], 3, axis=2)
    truth = one.recording.reference[:, :2]
    fit: Pose2D = map_metrics.alignment(truth, one.found[:, :2])
    revisits = one.revisits
    wrong = one.found[revisits.scans[revisits.is_wrong], :2]
    for points, colour in (
        (fit.transform_points(truth), (0, 170, 0)),
        (one.found[:, :2], (40, 80, 255)),
        (wrong, (255, 0, 0)),
    ):
        cells = one.grid.world_to_cell(points)
        for shift in ((0, 0), (0, 1), (1, 0), (1, 1)):
            dots = cells + np.array(shift)
            dots = dots[one.grid.contains_cell(dots)]
            image[dots[:, 0], dots[:, 1]] = colour
    file.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(image[::-1]).save(file)


def main() -> None:
    """Map the drives one after the other and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    names = ["freiburg", *(f"freiburg-{step_m:g}" for step_m in FREIBURG_STEPS_M), "create3"]
    parser.add_argument("--only", nargs="+", choices=[*names, *CASES], metavar="NAME")
    parser.add_argument("--seeds", nargs="+", type=int, default=[1], help="of the buildings")
    parser.add_argument("--pictures", type=Path, help="folder for pictures of wrong maps")
    options = parser.parse_args()
    wanted: list[str] = options.only or [*names, *CASES]
    runs: dict[str, Callable[[], Result]] = {}
    folder = recordings_folder() if set(wanted) & set(names) else None
    if folder is not None:
        runs = {name: run for name, run in from_recordings(folder).items() if name in wanted}
    for name in CASES:
        if name in wanted:
            for seed in options.seeds:
                runs[f"{name} {seed}"] = lambda name=name, seed=seed: through_building(name, seed)
    warm_up()
    results: list[Result] = []
    for run in runs.values():
        results.append(run())
        print("  ".join(row(results[-1])), flush=True)
        if options.pictures and results[-1].revisits.is_wrong.any():
            draw(results[-1], options.pictures / f"{results[-1].name.replace(' ', '-')}.png")
    print()
    if results:
        table(HEADS, [row(one) for one in results])
        show(figures(results))


if __name__ == "__main__":
    main()
