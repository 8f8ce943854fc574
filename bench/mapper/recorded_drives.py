"""How well the mapper maps recorded drives, against relations that were measured by hand.

    TROLLEY_DATA=/path/to/recordings python -m bench.mapper.recorded_drives [--drives NAME ...]

On freiburg-079 the error of the relative poses (Kümmerle et al., On Measuring the Accuracy of SLAM
Algorithms, 2009): published are 0.056 m for graph mapping and 0.045 m for Cartographer. Its own
`reference_refined` reaches 0.041 m. One set of settings for all. Pictures of the maps go to
out/.
"""

import argparse
import resource
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from bench.harness.figures import Figure, at_most, recordings_folder, show, table
from bench.harness.mapping import MappedDrive, map_drive
from bench.harness.paths import OUT
from bench.harness.recorded import CREATE3, FREIBURG, FREIBURG_RAW, Recording, read_recording
from bench.mapper.simulated_houses import fitted
from numpy.typing import NDArray
from PIL import Image

from trolley.config.mapper import MapperConfig
from trolley.geometry import Pose2D, angle_difference
from trolley.gridmap import GridMap
from trolley_mapper.slam.mapper import Mapper


@dataclass(frozen=True)
class Result:
    """The outcome of one drive."""

    drive: MappedDrive
    grid: GridMap
    loops: int
    keyframes: int


def follow(recording: Recording, config: MapperConfig | None = None) -> Result:
    """Map a drive; loops are searched and closed at once."""
    mapper = Mapper(config or MapperConfig())
    drive = map_drive(mapper, (recording.scan(index) for index in range(len(recording.stamps))))
    return Result(drive, mapper.grid(), mapper.num_loops, mapper.num_keyframes)


def relation_errors(
    folder: Path, poses: list[Pose2D]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Errors [m] and [rad] of all relations whose times lie within the poses."""
    with np.load(folder / "freiburg-079.npz") as data:
        # Their times count from the first scan.
        stamps, relations = data["stamps"] - data["stamps"][0], data["relations"]
    metres, radians = [], []
    for t_a, t_b, dx, dy, dyaw in relations:
        a, b = (int(np.argmin(np.abs(stamps - t))) for t in (t_a, t_b))
        if max(a, b) < len(poses):
            found = poses[a].inverse() @ poses[b]
            metres.append(np.hypot(found.x - dx, found.y - dy))
            radians.append(abs(angle_difference(found.yaw, dyaw)))
    return np.array(metres), np.array(radians)


def backwards(recording: Recording) -> Recording:
    """The same drive, from its end to its beginning."""
    return replace(
        recording,
        stamps=recording.stamps[-1] - recording.stamps[::-1],
        odom=recording.odom[::-1],
        reference=recording.reference[::-1],
        ranges=np.ascontiguousarray(recording.ranges[::-1]),
    )


def sparse(recording: Recording, every: int) -> Recording:
    """The same drive with every n-th beam only."""
    return replace(
        recording,
        ranges=np.ascontiguousarray(recording.ranges[:, ::every]),
        angle_increment=every * recording.angle_increment,
    )


def without_scans(recording: Recording, each_s: float, long_s: float) -> Recording:
    """The same drive with the lidar cut off repeatedly."""
    kept = recording.stamps % each_s >= long_s
    kept[: int(np.argmax(recording.stamps >= each_s))] = True
    return replace(
        recording,
        stamps=recording.stamps[kept],
        odom=recording.odom[kept],
        reference=recording.reference[kept],
        ranges=recording.ranges[kept],
    )


def drives(folder: Path) -> dict[str, Recording]:
    """All drives by name."""
    freiburg = read_recording(folder, *FREIBURG)
    return {
        "freiburg": freiburg,
        "freiburg-raw": read_recording(folder, *FREIBURG_RAW),
        "freiburg-backwards": backwards(freiburg),
        "freiburg-60-beams": sparse(freiburg, 6),
        "freiburg-cut": without_scans(freiburg, 60.0, 5.0),
        "create3": read_recording(folder, *CREATE3),
    }


HEADS = [
    "drive", "relations m", "std", "rad", "std", "to reference m", "mapping %", "loops",
    "keyframes", "step ms", "99 %", "core %",
]  # fmt: skip


def row(folder: Path, name: str, recording: Recording, one: Result) -> list[str]:
    """The line of a drive in the table."""
    reference = [recording.reference_at(k) for k in range(len(recording.stamps))]
    _, away_m = fitted(one.drive.poses, reference)
    related = ["", "", "", ""]
    if name.startswith("freiburg") and name != "freiburg-cut":
        poses = one.drive.poses[::-1] if name.endswith("backwards") else one.drive.poses
        metres, radians = relation_errors(folder, poses)
        related = [f"{v:.4f}" for v in (metres.mean(), metres.std(), radians.mean(), radians.std())]
    cpu = (one.drive.step_s.sum() + one.drive.slice_s.sum()) / recording.stamps[-1]
    return [
        name,
        *related,
        f"{away_m:.3f}",
        f"{100.0 * one.drive.mapping_share:.1f}",
        str(one.loops),
        str(one.keyframes),
        f"{1e3 * one.drive.step_s.mean():.2f}",
        f"{1e3 * np.quantile(one.drive.step_s, 0.99):.1f}",
        f"{100.0 * cpu:.1f}",
    ]


def draw(one: Result, file: Path) -> None:
    """Draw the map and the path on it."""
    shades = np.where(one.grid.cells < 0, 205, np.where(one.grid.cells >= 65, 0, 255))
    image = np.repeat(shades.astype(np.uint8)[..., None], 3, axis=2)
    cells = one.grid.world_to_cell(np.array([(p.x, p.y) for p in one.drive.poses]))
    cells = cells[one.grid.contains_cell(cells)]
    image[cells[:, 0], cells[:, 1]] = (40, 80, 255)
    file.parent.mkdir(exist_ok=True)
    Image.fromarray(image[::-1]).save(file)


def figures(folder: Path, results: dict[str, Result]) -> list[Figure]:
    """The figures that have targets."""
    found: list[Figure] = []
    for name in ("freiburg", "freiburg-raw"):
        if name in results:
            metres, _ = relation_errors(folder, results[name].drive.poses)
            found.append(at_most(f"{name}: relations, mean", float(metres.mean()), 0.056, "m", 4))
            found.append(at_most(f"{name}: as Cartographer", float(metres.mean()), 0.045, "m", 4))
    rss_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    return [*found, at_most("memory of this process, recordings included", rss_mb, 300.0, "MB", 0)]


def main() -> None:
    """Map the drives and print the table."""
    folder = recordings_folder()
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--drives", nargs="+")
    options = parser.parse_args()
    if folder is None:
        return
    rows: list[list[str]] = []
    results: dict[str, Result] = {}
    for name, recording in drives(folder).items():
        if options.drives and name not in options.drives:
            continue
        results[name] = follow(recording)
        draw(results[name], OUT / f"map-{name}.png")
        rows.append(row(folder, name, recording, results[name]))
    table(HEADS, rows)
    show(figures(folder, results))


if __name__ == "__main__":
    main()
