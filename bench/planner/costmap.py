"""How long the costmap takes for a scan: mark, clear, and update distances and weights.

A robot drives through a house of 20 x 20 m at 5 cm whose map lacks some of the furniture, past
people who walk. The reference takes the same scans, but recomputes the distances and weights of
the whole house after each, as a costmap that does not know what changed must. Times are processor
times of one thread, so other work on the machine matters little.

    python -m bench.planner.costmap [--full]
"""

import argparse
import math
import time
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from bench.harness.figures import Figure, at_most, show
from bench.harness.houses import draw_house, free_poses
from numpy.typing import NDArray

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D
from trolley.gridmap import OCCUPIED, GridMap, cast_rays
from trolley_planner.costmap.costmap import Costmap
from trolley_planner.costmap.footprint import Footprint
from trolley_planner.paths.global_planner import GlobalPlanner
from trolley_planner.sensing.beams import ScanShape, Sweep

SIZE_M = 20.0
RANGE_MAX_M = 12.0
NOISE_M = 0.015
SPEED_MPS, WALKING_MPS = 0.5, 1.0
LEG_RADIUS_M, STRIDE_M = 0.07, 0.3
SCAN_S = 0.1
LIMIT_MS = 5.0
FOOTPRINT = Footprint.from_polygon([(0.15, 0.12), (-0.15, 0.12), (-0.15, -0.12), (0.15, -0.12)])


class Case(NamedTuple):
    """One drive."""

    beams: int
    people: int


class Timing(NamedTuple):
    """How long each scan took [ms]."""

    scan: NDArray[np.float64]
    refresh: NDArray[np.float64]
    whole: NDArray[np.float64]
    """Distances and weights of the whole house."""

    @property
    def both(self) -> NDArray[np.float64]:
        """The scan and the update after it."""
        return self.scan + self.refresh


def main() -> None:
    """Time all cases."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--full", action="store_true", help="1200 scans each instead of 150")
    scans = 1200 if parser.parse_args().full else 150
    for case in (Case(360, 0), Case(360, 6), Case(1440, 0), Case(1440, 6)):
        timing = drive(case, scans)
        name = f"{case.beams} beams, {case.people} people"
        whole = timing.scan + timing.whole
        show(
            [
                at_most(f"{name}: a scan", float(np.mean(timing.both)), LIMIT_MS, "ms", 2),
                at_most("  95th of 100", float(np.percentile(timing.both, 95)), LIMIT_MS, "ms", 2),
                Figure("  of it mark and clear", f"{np.mean(timing.scan):.2f} ms"),
                Figure("  all computed anew", f"{np.mean(whole):.2f} ms"),
                Figure("  times as long", f"{np.mean(whole) / np.mean(timing.both):.1f}"),
            ]
        )


def drive(case: Case, scans: int) -> Timing:
    """Take in the scans of one drive."""
    house = draw_house(SIZE_M, seed=1)
    costmap = Costmap(house, FOOTPRINT, PlannerConfig(), unknown_is_free=False)
    reference = Costmap(house, FOOTPRINT, PlannerConfig(), unknown_is_free=False)
    times = np.zeros((scans, 3))
    for number, sweep in enumerate(_sweeps(house, case, scans + 3)):
        now_ns = round(number * SCAN_S * 1e9)
        began = time.thread_time()
        costmap.add_scan(sweep, now_ns)
        added = time.thread_time()
        costmap.refresh()
        refreshed = time.thread_time()
        reference.add_scan(sweep, now_ns)
        before = time.thread_time()
        reference.recompute()
        if number >= 3:  # The first scans compile the kernels.
            whole = time.thread_time() - before
            times[number - 3] = 1e3 * np.array([added - began, refreshed - added, whole])
    if not np.array_equal(costmap.weights, reference.weights):
        raise SystemExit("what was brought up to date differs from what was computed anew")
    return Timing(*times.T)


def _sweeps(house: GridMap, case: Case, count: int) -> Iterator[Sweep]:
    """The scans of a drive through the house."""
    rng = np.random.default_rng(7)
    truth = _furnished(house, rng).occupied_mask()
    way = _way(house, rng)
    shape = ScanShape(0.0, 2.0 * math.pi / case.beams, 0.1, RANGE_MAX_M)
    angles = np.arange(case.beams, dtype=np.float64) * shape.angle_increment
    walks = [(_way(house, rng), float(rng.uniform(0.0, 20.0))) for _ in range(case.people)]
    for number in range(count):
        here = _at(way, number * SCAN_S * SPEED_MPS)
        ranges = cast_rays(truth, house.resolution, (here.x, here.y), angles + here.yaw, 12.0)
        for walk, ahead in walks:
            along = ahead + number * SCAN_S * WALKING_MPS
            for foot in (0.0, STRIDE_M):
                leg = here.inverse() @ _at(walk, along + foot)
                ranges = np.minimum(ranges, _to_leg(leg, angles))
        noisy = ranges + rng.normal(0.0, NOISE_M, ranges.size)
        yield Sweep(noisy.astype(np.float32), shape, here, here, FOOTPRINT.polygon)


def _furnished(house: GridMap, rng: np.random.Generator) -> GridMap:
    """The house with 40 things in it that are not on its map."""
    cells = house.cells.copy()
    for pose in free_poses(house, 0.5, 40, rng):
        row, col = int(pose.y / house.resolution), int(pose.x / house.resolution)
        cells[row - 3 : row + 4, col - 3 : col + 4] = OCCUPIED
    return GridMap(house.name, house.resolution, house.origin, cells)


def _way(house: GridMap, rng: np.random.Generator) -> NDArray[np.float64]:
    """A path (n, 2) [m] through the house, from one random place to the next."""
    planner = GlobalPlanner(Costmap(house, FOOTPRINT, PlannerConfig(), unknown_is_free=False))
    costmap = planner._costmap
    legs: list[NDArray[np.float64]] = []
    here = None
    while sum(len(leg) for leg in legs) < 4000:
        there = free_poses(house, 0.4, 1, rng)[0]
        if here is not None:
            path = planner.plan(
                (here.x, here.y), [(there.x, there.y)], costmap.weights, costmap.distance_m
            )
            if path is None:
                continue
            legs.append(path.points)
        here = there
    return np.concatenate(legs)


def _at(way: NDArray[np.float64], along_m: float) -> Pose2D:
    """The pose at a distance along a path, which starts over at its end."""
    lengths = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(way, axis=0).T))])
    along_m %= float(lengths[-1]) - 0.1
    x, y = (float(np.interp(along_m, lengths, way[:, axis])) for axis in (0, 1))
    ahead = [float(np.interp(along_m + 0.1, lengths, way[:, axis])) for axis in (0, 1)]
    return Pose2D(x, y, math.atan2(ahead[1] - y, ahead[0] - x))


def _to_leg(leg: Pose2D, angles: NDArray[np.float64]) -> NDArray[np.float64]:
    """How far each beam goes to a leg, given in the frame of the lidar."""
    along = leg.x * np.cos(angles) + leg.y * np.sin(angles)
    beside = leg.x * np.sin(angles) - leg.y * np.cos(angles)
    inside = (along > 0.0) & (np.abs(beside) < LEG_RADIUS_M)
    depth = np.sqrt(np.maximum(LEG_RADIUS_M**2 - beside**2, 0.0))
    return np.where(inside, along - depth, np.inf)


if __name__ == "__main__":
    main()
