"""Whether hours in one room smear its map, and whether they cost memory.

    python -m bench.mapper.one_room [--minutes 120] [--seed 1]

A robot drives to and fro on the floor of one room of a generated building with people in its
corridor, two scans a second over 270 degrees, odometry 5 % off, in lock-step. Each ten minutes: how
far the walls of the map, 95 of 100 cells, are from true ones, how many of its wall cells lie beside
true walls (more within them is no smear: these are thicker than a cell), how many keyframes and
edges there are, and what the map and the process take.
"""

import argparse
import itertools

import numpy as np
from bench.harness.figures import at_most, show, table
from bench.harness.mapping import JOB_EVERY_NS
from bench.harness.recorded import Recording
from bench.mapper.buildings import Building, Drive, Plan, draw_building, record_along
from bench.mapper.house_tours import Roads
from bench.mapper.sparse_drives import memory_mb
from numpy.typing import NDArray

from trolley.config.mapper import MapperConfig
from trolley.geometry import Pose2D
from trolley.gridmap import OCCUPIED_FROM, GridMap, distance_transform
from trolley.slices import whole
from trolley_mapper.slam.estimate import MapEstimate
from trolley_mapper.slam.mapper import Mapper
from trolley_mapper.warmup import warm_up

PLAN = Plan((1, 1), block_m=(14.0, 10.0), people=4)
DRIVE = Drive(step_m=0.25, step_rad=0.5, field_rad=1.5 * np.pi, beams=360)
METRES_PER_MINUTE = 26.0
"""About as much is driven, turns on the spot counted in [m/min]."""
ROOM_M = 1.5
"""It drives to places so far from the middle of the room at most, along each axis [m]."""
REPORT_S = 600.0


def wander(building: Building, metres: float, seed: int) -> Recording:
    """Drive about in the first room."""
    rng = np.random.default_rng([seed, 1])
    roads = Roads(building.house)
    middle = building.rooms[0]
    at = roads.nearest(Pose2D(float(middle[0]), float(middle[1]), 0.0))
    parts: list[NDArray[np.float64]] = []
    length_m = 0.0
    while length_m < metres:
        x, y = (middle + rng.uniform(-ROOM_M, ROOM_M, 2)).tolist()
        goal = roads.nearest(Pose2D(x, y, 0.0))
        if goal == at or np.abs(roads.point(goal) - middle).max() > ROOM_M:
            continue
        way = roads.way(at, goal)
        at = goal
        parts.append(way)
        length_m += float(np.hypot(*np.diff(way, axis=0).T).sum())
    return record_along(building, np.vstack(parts), DRIVE, seed, rng)


def wall_error_m(found: GridMap, truth: GridMap) -> float:
    """How far 95 of 100 wall cells are from true walls at most [m]."""
    away = distance_transform(truth.occupied_mask(), truth.resolution)
    cells = truth.world_to_cell(found.cell_to_world(np.argwhere(found.occupied_mask())))
    cells = cells[truth.contains_cell(cells)]
    return float(np.quantile(away[cells[:, 0], cells[:, 1]], 0.95))


def cells_beside(found: GridMap, truth: GridMap) -> int:
    """How many wall cells of a map lie beside the true walls."""
    walls = found.cell_to_world(np.argwhere(found.occupied_mask()))
    return int(np.count_nonzero(truth.values_at(walls) < OCCUPIED_FROM))


def main() -> None:
    """Map the room and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=120.0)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    building = draw_building(PLAN, options.seed)
    recording = wander(building, METRES_PER_MINUTE * options.minutes, options.seed)
    warm_up()
    mapper = Mapper(MapperConfig(), recording.reference_at(0))
    rows: list[tuple[float, float, int, int, int, float, float]] = []
    report_s = itertools.count(REPORT_S, REPORT_S)
    next_s = next(report_s)
    not_mapping, far_m, last_ns = 0, 0.0, 0
    for row in range(len(recording.stamps)):
        scan = recording.scan(row)
        estimate = mapper.step(scan)
        assert isinstance(estimate, MapEstimate)
        not_mapping += estimate.state != "mapping"
        far_m = max(far_m, estimate.pose.distance_to(recording.reference_at(row)))
        for _ in range(max((scan.stamp_ns - last_ns) // JOB_EVERY_NS, 1)):
            job = mapper.take_job()
            if job is None:
                break
            whole(job.slices())
            mapper.finish(job)
        last_ns = scan.stamp_ns
        if recording.stamps[row] >= next_s or row == len(recording.stamps) - 1:
            grid = mapper.grid()
            rows.append(
                (
                    float(recording.stamps[row]) / 60.0,
                    wall_error_m(grid, building.grid),
                    cells_beside(grid, building.grid),
                    mapper.num_keyframes,
                    len(mapper.snapshot().store.edges),
                    mapper.memory_bytes / 1e6,
                    memory_mb("VmRSS"),
                )
            )
            print("  ".join(f"{value:.3g}" for value in rows[-1]), flush=True)
            next_s = next(report_s)
    print()
    table(
        ["minutes", "walls off m", "cells beside", "keyframes", "edges", "map MB", "process MB"],
        [[f"{value:.3g}" for value in one] for one in rows],
    )
    first, last = rows[0], rows[-1]
    show(
        [
            at_most("walls of the map are off, 95 of 100", last[1], 0.15, "m", 2),
            at_most("pose is off at most", far_m, 0.2, "m"),
            at_most("scans at which it was not mapping", not_mapping, 0.0, "", 0),
            at_most("places of the map that are doubted", len(mapper.doubtful()), 0.0, "", 0),
            at_most("more cells beside walls than after ten minutes", last[2] / first[2], 1.1),
            at_most("more edges for each keyframe", last[4] / last[3] * first[3] / first[4], 1.1),
            at_most("growth of the map since then", last[5] - first[5], 1.0, "MB"),
            at_most("growth of the process since then", last[6] - first[6], 20.0, "MB", 0),
        ]
    )


if __name__ == "__main__":
    main()
