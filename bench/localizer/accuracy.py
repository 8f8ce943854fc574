"""How exactly the localizer follows recorded drives, and a simulated robot that turns quickly.

    TROLLEY_DATA=/path/to/recordings python -m bench.localizer.accuracy [--seeds 2] [--full]

Each seed starts 0.3 m and 10 degrees off. "Lost" is the share of scans with an error over 0.5 m or
20 degrees. Plots of the first seed go to out/. Peers (median / 95 %, lost; lost with raw
odometry) on freiburg-079: ROS 1 AMCL 0.08 / 0.19 m, 1.5 %, 39 %; Nav2's AMCL 0.23 / 1.8 m, 23 %,
34 %; Beluga 0.17 / 1.1 m, 15 %, 22 %. On create3: 0 %, 0.08 / 0.3 m for all three. On drives with
one scan a metre and odometry errors of tens of degrees: lost in 80 to 98 % of the scans.
"""

import argparse
import math
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from bench.harness.drives import position_errors, simulated
from bench.harness.figures import at_most, recordings_folder, show, table
from bench.harness.paths import OUT, WORLDS
from bench.harness.recorded import (
    CREATE3,
    FREIBURG,
    FREIBURG_RAW,
    MAPS,
    Recording,
    Score,
    read_recording,
    relation_errors,
    score,
    start_nearby,
)
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from trolley import topics
from trolley.config.localizer import LocalizerConfig
from trolley.geometry import Pose2D, Twist2D
from trolley.gridmap import GridMap, load_map
from trolley.messages import VelocityCommand
from trolley.runtime.lockstep import Lockstep
from trolley_base.service import BaseService
from trolley_localizer.core import Localizer
from trolley_localizer.estimate import Estimate
from trolley_localizer.service import LocalizerService

APARTMENT_START = Pose2D(0.549, 0.218, 0.2579)
# Headings per metre of a thinned drive are off by this standard deviation [degrees].
THINNED_DEG = (0.0, 10.0, 20.0, 30.0)


@dataclass(frozen=True)
class Run:
    """One drive with one seed."""

    score: Score
    step_s: NDArray[np.float64]
    """Time of each update without searches [s]."""
    particles: NDArray[np.int64]
    """Hypotheses after each scan."""
    searches: int


def run(recording: Recording, map_file: Path, seed: int) -> Run:
    """Follow a drive from a start nearby."""
    localizer = Localizer(load_map(map_file), [], LocalizerConfig(), seed)
    localizer.set_pose(start_nearby(recording, seed))
    found: list[tuple[Pose2D | None, str]] = []
    count = len(recording.stamps)
    step_s, particles, searches = np.empty(count), np.empty(count, np.int64), 0
    for index in range(count):
        scan = recording.scan(index)
        began_s = time.perf_counter()
        estimate = localizer.step(scan)
        step_s[index] = time.perf_counter() - began_s
        assert isinstance(estimate, Estimate)
        found.append((estimate.map_T_base, estimate.state))
        particles[index] = len(localizer.particles()[1])
        job = localizer.take_job()
        if job is not None:
            searches += 1
            localizer.finish(job.run())
    return Run(score(recording, found), step_s, particles, searches)


def row(name: str, runs: list[Run]) -> list[str]:
    """The line of a drive in the table, over all seeds."""
    scores = [one.score for one in runs]
    step_ms = np.concatenate([one.step_s for one in runs]) * 1e3
    localized = [np.mean([state == "localized" for state in one.states]) for one in scores]
    return [
        name,
        str(len(runs)),
        f"{np.median([one.median_m for one in scores]):.3f}",
        f"{np.max([one.median_m for one in scores]):.3f}",
        f"{np.max([one.p95_m for one in scores]):.3f}",
        f"{np.max([np.nanmax(one.error_m) for one in scores]):.2f}",
        f"{100.0 * np.mean([one.far_share for one in scores]):.2f}",
        f"{100.0 * np.max([one.far_share for one in scores]):.2f}",
        f"{100.0 * np.mean(localized):.1f}",
        f"{100.0 * np.mean([_wrong_share(one) for one in scores]):.2f}",
        f"{np.mean([one.particles.mean() for one in runs]):.0f}",
        f"{np.mean([one.searches for one in runs]):.1f}",
        f"{step_ms.mean():.2f}",
        f"{np.quantile(step_ms, 0.99):.2f}",
    ]


HEADS = [
    "drive", "seeds", "median", "worst", "95 %", "max m", "lost %", "worst", "localized %",
    "wrong %", "particles", "searches", "ms", "99 %",
]  # fmt: skip


def _wrong_share(one: Score) -> float:
    """Share of the scans where a lost robot said that it was localized."""
    said = np.array([state == "localized" for state in one.states])
    return float(np.mean(said & one.is_far))


def recorded_drives(folder: Path, seeds: int) -> None:
    """Follow the recordings with all seeds."""
    rows: list[list[str]] = []
    results: dict[str, list[Run]] = {}
    drives = {"freiburg": FREIBURG, "freiburg, raw": FREIBURG_RAW, "create3": CREATE3}
    for name, fields in drives.items():
        recording, map_file = read_recording(folder, *fields), folder / MAPS[fields[0]]
        runs = [run(recording, map_file, seed) for seed in range(seeds)]
        draw(load_map(map_file), recording, runs[0].score, OUT / f"{name.replace(', ', '-')}.png")
        rows.append(row(name, runs))
        results[name] = runs
    table(HEADS, rows)
    related = [np.mean(relation_errors(folder, r.score.poses)) for r in results["freiburg"]]
    show(
        [
            *_limits("freiburg", results["freiburg"], 0.06, 0.0),
            at_most("freiburg: 95 %", _worst_p95(results["freiburg"]), 0.13, "m"),
            at_most("freiburg: mean error of relations", float(np.max(related)), 0.10, "m"),
            at_most(
                "freiburg, raw: lost",
                100.0 * max(r.score.far_share for r in results["freiburg, raw"]),
                2.0,
                "%",
                2,
            ),
            *_limits("create3", results["create3"], 0.06, 0.0),
        ]
    )


def _worst_p95(runs: list[Run]) -> float:
    return max(one.score.p95_m for one in runs)


def _limits(name: str, runs: list[Run], median_m: float, lost_percent: float) -> list:
    worst_m = max(one.score.median_m for one in runs)
    lost = 100.0 * max(one.score.far_share for one in runs)
    return [
        at_most(f"{name}: median, worst seed", worst_m, median_m, "m"),
        at_most(f"{name}: lost, worst seed", lost, lost_percent, "%", 2),
    ]


def thinned_drives(folder: Path, seeds: int) -> None:
    """Follow freiburg-079 with one scan a metre and ever worse odometry."""
    recording, map_file = read_recording(folder, *FREIBURG), folder / MAPS[FREIBURG[0]]
    rows: list[list[str]] = []
    for deg in THINNED_DEG:
        thin = [recording.thinned(1.0, math.radians(deg), seed) for seed in range(seeds)]
        runs = [run(one, map_file, seed) for seed, one in enumerate(thin)]
        name = f"a scan a metre, {deg:.0f}° off"
        draw(load_map(map_file), thin[0], runs[0].score, OUT / f"thinned-{deg:.0f}.png")
        rows.append(row(name, runs))
    table(HEADS, rows)


def turning_quickly(seeds: int, seconds: float) -> None:
    """Turn a simulated robot at 1 rad/s on the spot with a lidar of either sense."""
    rows: list[list[str]] = []
    worst: dict[str, float] = {}
    for sense in ("clockwise", "counter-clockwise"):
        errors = [turn_once(sense == "clockwise", seed, seconds) for seed in range(seeds)]
        every = np.concatenate(errors)
        worst[sense] = float(every.max())
        shares = np.quantile(every, [0.5, 0.95, 1.0])
        rows.append([f"1 rad/s, {sense}", str(seeds), *(f"{value:.4f}" for value in shares)])
    table(["simulated lidar", "seeds", "median m", "95 %", "max"], rows)
    show([at_most("1 rad/s, clockwise: greatest error", worst["clockwise"], 0.03, "m")])


def turn_once(is_clockwise: bool, seed: int, seconds: float) -> NDArray[np.float64]:
    """Position errors [m] of a robot that turns in the apartment for so long [s]."""
    with tempfile.TemporaryDirectory() as folder:
        world = Path(folder) / "apartment.toml"
        text = (WORLDS / "apartment.toml").read_text()
        text = text.replace('"apartment.yaml"', f'"{WORLDS / "apartment.yaml"}"')
        world.write_text(f"{text}\n[lidar]\nclockwise = {str(is_clockwise).lower()}\n")
        config = simulated(world, WORLDS / "apartment.yaml", APARTMENT_START, seed)
        with Lockstep(config.robot.name, seed) as lockstep:
            truths, poses = lockstep.record(topics.SIM_TRUTH), lockstep.record(topics.POSE)
            base = lockstep.add(BaseService(config))
            lockstep.add(LocalizerService(config))
            lockstep.run(2.0)
            poses.clear()
            for _ in range(round(10 * seconds)):
                command = VelocityCommand(
                    stamp_ns=base.stamp_ns, twist=Twist2D(0.0, 0.0, 1.0), valid_for=0.3
                )
                lockstep.publish(topics.COMMAND, command, "teleop")
                lockstep.run(0.1)
            return position_errors(truths, poses)


def draw(grid: GridMap, recording: Recording, result: Score, file: Path) -> None:
    """Draw a drive over its map: the reference green, the estimate blue, red where lost."""
    shades = np.where(grid.cells < 0, 205, np.where(grid.cells >= 65, 0, 255)).astype(np.uint8)
    scale = 2
    image = Image.fromarray(shades[::-1]).convert("RGB")
    image = image.resize((scale * grid.cols, scale * grid.rows), Image.Resampling.NEAREST)
    pen = ImageDraw.Draw(image)

    def pixels(points: NDArray[np.float64]) -> list[tuple[float, float]]:
        cells = grid.world_to_grid(points) / grid.resolution
        return [(scale * float(x), scale * (grid.rows - float(y))) for x, y in cells]

    pen.line(pixels(recording.reference[:, :2]), fill=(0, 170, 0), width=3)
    known = [k for k, pose in enumerate(result.poses) if pose is not None]
    found = np.array([(p.x, p.y) for p in result.poses if p is not None]).reshape(-1, 2)
    dots, is_far = pixels(found), result.is_far
    pen.line(dots, fill=(40, 80, 255), width=1)
    for k, (x, y) in zip(known, dots, strict=True):
        if is_far[k]:
            pen.ellipse((x - 3, y - 3, x + 3, y + 3), fill=(230, 30, 30))
    file.parent.mkdir(exist_ok=True)
    image.save(file)


def main() -> None:
    """Follow all drives and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--full", action="store_true", help="20 seeds")
    options = parser.parse_args()
    seeds = 20 if options.full else options.seeds
    turning_quickly(seeds, 20.0)
    folder = recordings_folder()
    if folder is not None:
        thinned_drives(folder, seeds)
        recorded_drives(folder, seeds)


if __name__ == "__main__":
    main()
