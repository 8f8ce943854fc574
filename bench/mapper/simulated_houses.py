"""How accurate the mapper's maps of simulated houses are: walls, closed rooms, memory, time.

    python -m bench.mapper.simulated_houses [--areas 30 100 300] [--seeds 2] [--full]

A robot with 4 % odometry error and a lidar of 8 m reach is driven once past everything in a house
drawn at random, while two people walk about. "Walls" is the share of the walls that the lidar
could see which lie within one cell (0.05 m, or the diagonal of it) of a wall of the map; "false"
the share of the map's walls farther than that from a true one; "leaks" free floor drawn behind
walls. Pictures go to out/: walls that are missing on the map are red.
"""

import argparse
import math
import resource
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from bench.harness.figures import at_least, at_most, show, table
from bench.harness.mapping import MappedDrive, map_drive
from bench.harness.paths import OUT
from bench.mapper.house_tours import House, drive, make_house
from bench.mapper.map_metrics import alignment, errors_m
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage, optimize

from trolley.config.mapper import MapperConfig
from trolley.geometry import Pose2D
from trolley.gridmap import GridMap, distance_transform
from trolley.gridmap.kernels import cast_ray
from trolley.jit import kernel
from trolley.scanning import ScanInput
from trolley_base.world.spec import LidarSpec
from trolley_mapper.slam.mapper import Mapper

# A wall that was met by fewer beams than this was not seen.
SEEN_TIMES = 10
DEEP_CELLS = 2

LIDARS = {
    "360 beams": LidarSpec(),
    "180°, 180 beams": LidarSpec(beams=180, field_of_view=math.pi),
    "72 beams": LidarSpec(beams=72),
}


@dataclass(frozen=True)
class Result:
    """The outcome of one drive."""

    name: str
    house: House
    grid: GridMap
    drive: MappedDrive
    seconds: float
    """Robot time of the drive [s]."""
    keyframes: int
    memory_bytes: int
    loops: int
    error_m: float
    """Mean error of the poses, after a rigid fit of all of them [m]."""
    wall_share: float
    false_share: float
    leaks: int
    missing: NDArray[np.bool_]

    @property
    def cpu_share(self) -> float:
        """Share of one core at real time."""
        return float(self.drive.step_s.sum() + self.drive.slice_s.sum()) / self.seconds


def run(name: str, house: House, seed: int, config: MapperConfig | None = None) -> Result:
    """Drive through a house, map it, and compare the map with the house."""
    mapper = Mapper(config or MapperConfig(), house.start)
    truths: list[Pose2D] = []

    def scans() -> Iterator[ScanInput]:
        for scan, truth in drive(house, seed):
            truths.append(truth)
            yield scan

    mapped = map_drive(mapper, scans())
    seen = seen_walls(house, truths)
    fit, error_m = fitted(mapped.poses, truths)
    wall_share, false_share, leaks, missing = compare(mapper.grid(), house, seen, fit)
    return Result(
        name, house, mapper.grid(), mapped, len(truths) / 10.0,
        mapper.num_keyframes, mapper.memory_bytes, mapper.num_loops, error_m,
        wall_share, false_share, leaks, missing,
    )  # fmt: skip


def fitted(poses: list[Pose2D], truths: list[Pose2D]) -> tuple[Pose2D, float]:
    """Turn and shift poses onto the true ones; returns truth_T_map and the mean error [m]."""
    found = np.array([p.as_array() for p in poses])
    true = np.array([p.as_array() for p in truths])
    return alignment(found[:, :2], true[:, :2]), float(errors_m(found, true).mean())


@kernel
def count_hits(
    out_hits: NDArray[np.int32],
    occupied: NDArray[np.uint8],
    poses_grid: NDArray[np.float64],
    angles: NDArray[np.float64],
    reach: float,
) -> None:
    """Count in each wall cell the exact beams that end there, from poses (n, 3) in cells."""
    rows, cols = occupied.shape
    for i in range(poses_grid.shape[0]):
        x, y = poses_grid[i, 0], poses_grid[i, 1]
        for angle in angles:
            heading = poses_grid[i, 2] + angle
            away = cast_ray(occupied, x, y, heading, reach)
            if away < reach:
                row = math.floor(y + (away + 0.01) * math.sin(heading))
                col = math.floor(x + (away + 0.01) * math.cos(heading))
                if 0 <= row < rows and 0 <= col < cols:
                    out_hits[row, col] += 1


def seen_walls(house: House, truths: list[Pose2D]) -> NDArray[np.bool_]:
    """The wall cells (rows, cols) that the lidar met often enough."""
    grid, lidar = house.grid, house.spec.lidar
    laser = np.array([(grid.origin.inverse() @ p).as_array() for p in truths[::5]])
    laser[:, :2] /= grid.resolution
    half = 0.5 * lidar.field_of_view
    angles = np.linspace(-half, half, lidar.beams, endpoint=False)
    hits = np.zeros(grid.cells.shape, np.int32)
    occupied = grid.occupied_mask()
    count_hits(hits, occupied, laser, angles, 0.95 * lidar.range_max_m / grid.resolution)
    # The corner between two seen walls is not met itself, nor are the ends of beams exact.
    return (hits >= SEEN_TIMES) & (occupied == 1)


def compare(
    found: GridMap, house: House, seen: NDArray[np.bool_], fit: Pose2D
) -> tuple[float, float, int, NDArray[np.bool_]]:
    """Share of seen walls found, share of false walls, leaked cells, and the walls not found."""
    truth = house.grid
    walls = truth.occupied_mask()
    away = distance_transform(walls, truth.resolution)
    points = found.cell_to_world(np.column_stack(np.nonzero(found.occupied_mask())))

    def cost(change: NDArray[np.float64]) -> float:
        moved = (Pose2D(*change) @ fit).transform_points(points)
        return float(np.minimum(sampled(away, truth, moved), 0.3).mean())

    simplex = [[0, 0, 0], [0.02, 0, 0], [0, 0.02, 0], [0, 0, 0.004]]
    best = optimize.minimize(
        cost, np.zeros(3), method="Nelder-Mead", options={"initial_simplex": simplex}
    )
    fit = Pose2D(*best.x) @ fit
    placed = fit.transform_points(points)
    near = truth.resolution * math.sqrt(2.0) + 1e-6
    drawn = np.zeros_like(walls)
    cells = truth.world_to_cell(placed)
    cells = cells[truth.contains_cell(cells)]
    drawn[cells[:, 0], cells[:, 1]] = 1
    missing = seen & (distance_transform(drawn, truth.resolution) > near)
    # People are not walls, but drawing those who stood still at the end is correct.
    is_false = sampled(away, truth, placed) > near
    free = fit.transform_points(found.cell_to_world(np.column_stack(np.nonzero(found.free_mask()))))
    inside = ndimage.binary_dilation(_floor(house), iterations=DEEP_CELLS)
    leaks = int(np.count_nonzero(sampled(inside.astype(np.float32), truth, free, 0.0) == 0.0))
    return 1.0 - missing.sum() / max(seen.sum(), 1), float(is_false.mean()), leaks, missing


def _floor(house: House) -> NDArray[np.bool_]:
    """The free cells that belong to what can be reached."""
    regions, _ = ndimage.label(house.grid.free_mask())
    return np.isin(regions, np.unique(regions[house.reachable]))


def sampled(
    field: NDArray[np.float32], grid: GridMap, points: NDArray[np.float64], outside: float = 1.0
) -> NDArray[np.float64]:
    """Values of a field on the grid's cells under points (n, 2) of the map frame."""
    cells = grid.world_to_cell(points)
    inside = grid.contains_cell(cells)
    values = np.full(len(points), outside)
    values[inside] = field[cells[inside, 0], cells[inside, 1]]
    return values


def draw(result: Result, file: Path) -> None:
    """Draw the map, and beside it the house with the walls that are missing in red."""
    truth = result.house.grid
    house = np.repeat(_shades(truth)[..., None], 3, axis=2)
    house[result.missing] = (230, 30, 30)
    made = np.repeat(_shades(result.grid)[..., None], 3, axis=2)
    height = max(len(house), len(made))
    both = np.full((height, made.shape[1] + house.shape[1] + 10, 3), 128, np.uint8)
    both[-len(made) :, : made.shape[1]] = made[::-1]
    both[-len(house) :, -house.shape[1] :] = house[::-1]
    file.parent.mkdir(exist_ok=True)
    image = Image.fromarray(both)
    image.resize((2 * both.shape[1], 2 * height), Image.Resampling.NEAREST).save(file)


def _shades(grid: GridMap) -> NDArray[np.uint8]:
    return np.where(grid.cells < 0, 205, np.where(grid.cells >= 65, 0, 255)).astype(np.uint8)


HEADS = [
    "house", "m²", "s", "walls %", "false %", "leaks", "pose m", "mapping %", "loops",
    "keyframes", "MB", "step ms", "99 %", "core %",
]  # fmt: skip


def row(one: Result) -> list[str]:
    """The line of a drive in the table."""
    return [
        one.name,
        f"{one.house.area_m2:.0f}",
        f"{one.seconds:.0f}",
        f"{100.0 * one.wall_share:.1f}",
        f"{100.0 * one.false_share:.1f}",
        str(one.leaks),
        f"{one.error_m:.3f}",
        f"{100.0 * one.drive.mapping_share:.1f}",
        str(one.loops),
        str(one.keyframes),
        f"{one.memory_bytes / 1e6:.1f}",
        f"{1e3 * one.drive.step_s.mean():.2f}",
        f"{1e3 * np.quantile(one.drive.step_s, 0.99):.1f}",
        f"{100.0 * one.cpu_share:.1f}",
    ]


def main() -> None:
    """Map houses with several lidars and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--areas", type=float, nargs="+", default=[30.0, 100.0, 300.0])
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--lidars", nargs="+", default=list(LIDARS), choices=list(LIDARS))
    parser.add_argument("--error", type=float, default=0.04, help="of the odometry")
    parser.add_argument("--full", action="store_true", help="5 seeds")
    options = parser.parse_args()
    results: list[Result] = []
    for lidar in options.lidars:
        for area_m2 in options.areas:
            for seed in range(5 if options.full else options.seeds):
                house = make_house(area_m2, seed, LIDARS[lidar], options.error, 2)
                results.append(run(f"{lidar}, {area_m2:.0f} m², {seed}", house, seed))
                draw(results[-1], OUT / f"house-{lidar.split()[0]}-{area_m2:.0f}-{seed}.png")
                table(HEADS, [row(results[-1])])
    table(HEADS, [row(one) for one in results])
    rss_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    show(
        [
            at_least(
                "walls within a cell, worst", 100 * min(r.wall_share for r in results), 95.0, "%", 1
            ),
            at_most("false walls, worst", 100 * max(r.false_share for r in results), 2.0, "%", 1),
            at_most(
                "floor drawn behind walls, worst", max(r.leaks for r in results), 0, "cells", 0
            ),
            at_most(
                "core at real time, worst", 100 * max(r.cpu_share for r in results), 50.0, "%", 1
            ),
            at_most("memory of this process, world included", rss_mb, 300.0, "MB", 0),
        ]
    )


if __name__ == "__main__":
    main()
