"""Speed of the particle filter beside the textbook's, on the same map, scan and particles.

    python -m bench.localizer.speed [--repeats 60] [--full]

400 × 400 cells at 5 cm, 2000 particles × 60 beams, one thread; the shortest time of many. "Cold" is
the median with all caches overwritten before each update, as they are at 10 Hz. Peers on
one x86-64 core, a whole update: ROS 1 AMCL 6.7 ms, Beluga 1.43 ms; the weights per particle and
beam: AMCL 41 ns, Beluga 7.0 ns. Distance transform: AMCL 22 ms and 9.6 s.
"""

import argparse
import math
import time
from collections.abc import Callable

import numpy as np
from bench.harness.figures import Figure, at_least, at_most, show
from bench.harness.houses import draw_house, free_poses, seen_from
from bench.localizer import textbook
from numpy.typing import NDArray

from trolley.config.localizer import LocalizerConfig
from trolley.geometry import Pose2D
from trolley.gridmap import GridMap, distance_transform
from trolley.scanning import Points
from trolley_localizer.filter.motion_model import split_step
from trolley_localizer.filter.particle_filter import ParticleFilter
from trolley_localizer.matching.likelihood_field import MAX_DISTANCE_M, LikelihoodField, build_field

PARTICLES, BEAMS, REACH_M = 2000, 60, 12.0
DEVIATION = np.array([0.15, 0.15, 0.1])
STEP = Pose2D(0.1, 0.01, 0.05)
CONFIG = LocalizerConfig(min_particles=PARTICLES, max_particles=PARTICLES, num_beams=BEAMS)


def shortest_s(work: Callable[[], object], repeats: int) -> float:
    """The shortest of many runs [s]."""
    times: list[float] = []
    for _ in range(repeats):
        began_s = time.perf_counter()
        work()
        times.append(time.perf_counter() - began_s)
    return min(times)


class Textbook:
    """The book's filter on a map."""

    def __init__(self, grid: GridMap, pose: Pose2D, beams: NDArray[np.float64]) -> None:
        distance = distance_transform(grid.occupied_mask(), grid.resolution, MAX_DISTANCE_M)
        self._distance = distance.astype(np.float64)
        self._resolution = grid.resolution
        self._beams = beams
        self._pose = pose
        power = min(BEAMS, CONFIG.independent_beams) / BEAMS
        self._model = np.array([1.0 - CONFIG.z_rand, CONFIG.z_rand, CONFIG.sigma_hit_m, power])
        self._alphas = np.array([CONFIG.alpha1, CONFIG.alpha2, CONFIG.alpha3, CONFIG.alpha4])
        turn = math.atan2(STEP.y, STEP.x)
        self._step = np.array([turn, math.hypot(STEP.x, STEP.y), STEP.yaw - turn])
        self._table = np.empty(8192, np.int64)
        self._mean, self._covariance = np.empty(3), np.empty((2, 2))
        self.weights = np.empty(PARTICLES)
        self.reset()

    def reset(self) -> None:
        """Draw all particles anew, the same each time."""
        rng = np.random.default_rng(1)
        self.poses = self._pose.as_array() + DEVIATION * rng.standard_normal((PARTICLES, 3))
        self._spare = np.empty_like(self.poses)

    def weigh(self) -> None:
        """Weigh the particles as they are."""
        textbook.weigh(
            self.weights, self.poses, self._beams, self._distance, self._resolution, self._model
        )

    def update(self) -> None:
        """Motion, weights, estimate, resampling."""
        textbook.move(self.poses, self._step, self._alphas)
        self.weigh()
        textbook.estimate(self._mean, self._covariance, self.poses, self.weights)
        textbook.resample(
            self._spare,
            self.poses,
            self.weights,
            self._table,
            CONFIG.kld_error,
            CONFIG.kld_quantile,
        )
        self.poses, self._spare = self._spare, self.poses


class Ours:
    """Trolley's filter on the same map with the same scan."""

    def __init__(self, field: LikelihoodField, pose: Pose2D, beams: NDArray[np.float64]) -> None:
        self._scale = 1.0 / field.resolution
        ranges, angles = beams.T * np.array([[self._scale], [1.0]])
        self._points = Points(ranges * np.cos(angles), ranges * np.sin(angles))
        self.mean = field.to_cells(pose)
        self.filter = ParticleFilter(field, CONFIG, 1)
        self.filter.reset(self.mean, np.diag((DEVIATION * [self._scale, self._scale, 1.0]) ** 2))

    def take(self, poses: NDArray[np.float64]) -> None:
        """Put the particles at poses (n, 3) [m, rad], equally weighted."""
        for part, column in zip(self.filter.cloud, poses.T, strict=True):
            part[:] = column
        self.filter.cloud.x[:] *= self._scale
        self.filter.cloud.y[:] *= self._scale
        self.filter.weights[:] = 1.0 / PARTICLES

    def weigh(self) -> None:
        """Weigh the particles as they are."""
        self.filter.weigh(self._points)

    def update(self) -> None:
        """Motion, weights, estimate, resampling."""
        self.observe()
        self.redraw()
        self.filter.spread_m()

    def observe(self) -> None:
        """Motion, weights, estimate."""
        self.filter.observe(split_step(STEP, CONFIG), self._points)

    def redraw(self) -> None:
        """Resampling."""
        self.filter.redraw(self.mean)


def same_scan(seed: int) -> tuple[Textbook, Ours]:
    """Both filters on the same map with the same scan and particles."""
    grid = draw_house(20.0, seed)
    pose = free_poses(grid, 0.5, 1, np.random.default_rng(seed))[0]
    ranges = seen_from(grid, pose, BEAMS, REACH_M).astype(np.float64)
    angles = -math.pi + np.arange(BEAMS) * (2.0 * math.pi / BEAMS)
    # A beam without an echo would be left out of both.
    beams = np.empty((BEAMS, 2))
    beams[:, 0], beams[:, 1] = np.where(np.isfinite(ranges), ranges, REACH_M), angles
    book, ours = Textbook(grid, pose, beams), Ours(build_field(grid, CONFIG), pose, beams)
    ours.take(book.poses)
    return book, ours


def measure_difference(scans: int) -> list[Figure]:
    """How far our weights lie from the textbook's."""
    greatest: list[float] = []
    for seed in range(scans):
        book, ours = same_scan(seed)
        book.weigh()
        ours.weigh()
        greatest.append(np.abs(ours.filter.weights - book.weights).max() / book.weights.max())
    name = f"difference of weights relative to the largest, {scans} scans"
    return [
        at_most(f"greatest {name}", 100.0 * max(greatest), 1.5, "%", 3),
        Figure(f"median of the greatest {name}", f"{100.0 * float(np.median(greatest)):.4f} %"),
        Figure("scans where it is at most 1.5 %", f"{sum(g <= 0.015 for g in greatest)}"),
    ]


def measure_filter(repeats: int) -> list[Figure]:
    """Weights and whole update beside the textbook's, and the parts of ours."""
    book, ours = same_scan(3)
    pairs = PARTICLES * BEAMS
    slow_ns = shortest_s(book.weigh, repeats) / pairs * 1e9
    fast_ns = shortest_s(ours.weigh, 20 * repeats) / pairs * 1e9
    whole_slow_s = whole_s(book.update, book.reset, repeats)
    book.reset()
    whole_fast_s = whole_s(ours.update, lambda: ours.take(book.poses), 20 * repeats)
    parts: dict[str, Callable[[], object]] = {
        "motion, weights, estimate": ours.observe,
        "weights": ours.weigh,
        "resampling, spread": ours.redraw,
    }
    is_like = 26.0 / 1.5 <= slow_ns <= 26.0 * 1.5
    return [
        Figure(
            "textbook: weights per particle and beam", f"{slow_ns:.1f} ns", "17 to 39 ns", is_like
        ),
        Figure("ours: weights per particle and beam", f"{fast_ns:.3f} ns", "0.53 ns once"),
        at_least("weights: times as fast as the textbook", slow_ns / fast_ns, 30.0, digits=1),
        Figure("textbook: whole update", f"{whole_slow_s * 1e3:.3f} ms"),
        Figure("ours: whole update", f"{whole_fast_s * 1e3:.3f} ms", "0.095 ms once"),
        at_least("whole update: times as fast", whole_slow_s / whole_fast_s, 32.0, digits=1),
        *(
            Figure(
                f"ours: {name}",
                f"{whole_s(work, lambda: ours.take(book.poses), 10 * repeats) * 1e6:.1f} µs",
            )
            for name, work in parts.items()
        ),
    ]


def whole_s(work: Callable[[], object], reset: Callable[[], object], repeats: int) -> float:
    """Shortest of many runs [s], each from the same particles, which would drift off otherwise."""
    times: list[float] = []
    for _ in range(repeats):
        reset()
        times.append(shortest_s(work, 1))
    return min(times)


EVICTING_MB = 96
"""More than the caches of any processor that this runs on hold [MB]."""


def measure_cold(repeats: int) -> list[Figure]:
    """The whole update with hot and with cold caches: medians, since a cold one is never short."""
    book, ours = same_scan(3)
    waste = np.zeros(EVICTING_MB << 17)

    def evict() -> None:
        ours.take(book.poses)
        waste[:] += 1.0

    def keep() -> None:
        ours.take(book.poses)

    hot_s, cold_s = (
        float(np.median([whole_s(ours.update, reset, 1) for _ in range(repeats)]))
        for reset in (keep, evict)
    )
    return [
        at_most("ours: whole update, hot, median", hot_s * 1e6, 100.0, "µs", 0),
        at_most("ours: cold, times as long as hot", cold_s / hot_s, 1.6, digits=2),
    ]


def measure_distances(is_full: bool) -> list[Figure]:
    """The exact distance transform, and all tables of a map."""
    figures: list[Figure] = []
    for cells, limit_ms in ((400, 1.2), (4000, 165.0)):
        grid = draw_house(cells * 0.05, 5)
        mask = grid.occupied_mask()
        repeats = 20 if cells < 1000 or is_full else 2

        def exact(mask: NDArray[np.uint8] = mask) -> object:
            return distance_transform(mask, 0.05)

        def cut(mask: NDArray[np.uint8] = mask) -> object:
            return distance_transform(mask, 0.05, MAX_DISTANCE_M)

        def tables(grid: GridMap = grid) -> object:
            return build_field(grid, CONFIG)

        name = f"{cells} × {cells}"
        figures += [
            at_most(f"distances {name}", shortest_s(exact, repeats) * 1e3, limit_ms, "ms", 2),
            Figure(
                f"distances {name}, cut off at 2 m as the localizer does",
                f"{shortest_s(cut, repeats) * 1e3:.2f} ms",
            ),
            Figure(f"all tables of a map {name}", f"{shortest_s(tables, repeats) * 1e3:.2f} ms"),
        ]
    return figures


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=60)
    parser.add_argument("--full", action="store_true", help="more repeats")
    options = parser.parse_args()
    repeats = 300 if options.full else options.repeats
    show(
        [
            *measure_filter(repeats),
            *measure_cold(repeats),
            *measure_difference(200 if options.full else 20),
        ]
    )
    show(measure_distances(options.full))


if __name__ == "__main__":
    main()
