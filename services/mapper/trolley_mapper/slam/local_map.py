"""The surfaces round about the robot, put together from some keyframes."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from trolley_mapper.kernels import correlate, surfels
from trolley_mapper.kernels.align import accumulate, align
from trolley_mapper.kernels.layout import Cloud, Matching, Surfels
from trolley_mapper.slam.keyframe import Keyframe
from trolley_mapper.slam.sweep import Sweep

# Edge of the cells that surfels are averaged in [m].
CELL_M = 0.1
# Deviation of a point from its surface [m], and as how many independent points a scan counts.
_SIGMA_M = 0.03
_INDEPENDENT_POINTS = 60.0
_WIDTH_M = 0.05
_LAST_REACH_M = 0.12
_ITERATIONS = 25
# Share of the information that is noise; a turn by 1 rad counts as a way of so many metres.
_NORMAL_NOISE = 0.01
_TURN_M = 3.0
# A point this near to a surface is explained by it [m].
NEAR_M = 0.08
# Of the grid for correlative matching: cell edge and deviation of a point [m].
FINE_M = 0.05
_BLUR_M = 0.07
_HEIGHTS = 5
_SEARCH_POINTS = 180
# Free space is marked by about so many beams of each keyframe.
_FREE_BEAMS = 120
# The floor of a map made before counts as seen by so many keyframes.
_PRIOR_TIMES = 3


class LocalMap:
    """Surfels within a square, of the keyframes given.

    Args:
        keyframes: those that agree with each other, the oldest first.
        poses: (k, 3) map_T_base of each.
        centre: (2,) x, y [m] of the square in `map`.
        reach_m: half its edge [m].
    """

    def __init__(
        self,
        keyframes: Sequence[Keyframe],
        poses: NDArray[np.float64],
        centre: NDArray[np.float64],
        reach_m: float,
    ) -> None:
        self.keyframes = keyframes
        self.poses = poses
        cells = math.ceil(2.0 * reach_m / CELL_M)
        self._reach_m = reach_m
        capacity = max(sum(len(one.points) for one in keyframes), 1)
        self.surfels = Surfels(
            np.empty((capacity, 2)),
            np.empty((capacity, 2)),
            np.empty(capacity),
            np.empty(capacity, np.int32),
            np.empty(capacity, np.int32),
            np.empty((cells, cells), np.int32),
            np.empty((cells, cells), np.uint8),
            np.array([centre[0] - reach_m, centre[1] - reach_m, 1.0 / CELL_M]),
        )
        surfels.clear_surfels(self.surfels)
        self.count = 0
        for owner, (one, pose) in enumerate(zip(keyframes, poses, strict=True)):
            self.count = surfels.add_surfels(
                self.surfels, self.count, one.points, one.normals, pose, owner
            )
            if one.floor is not None:
                surfels.mark_floor(self.surfels, one.floor, _PRIOR_TIMES)
                continue
            every = max(len(one.points) // _FREE_BEAMS, 1)
            surfels.mark_free(self.surfels, one.points, one.laser, pose, every)
        surfels.normalise_surfels(self.surfels, self.count)
        self._levels: NDArray[np.uint8] | None = None
        self._fine_frame = np.empty(3)

    def align(
        self,
        start: NDArray[np.float64],
        cloud: Cloud,
        prior: NDArray[np.float64],
        prior_information: NDArray[np.float64],
        first_reach_m: float,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Align a scan from a start pose (3,), with a prior (3,), (3, 3).

        Returns:
            The pose (3,) and the information (3, 3) from the scan alone, both in `map`.
        """
        pose, information = start.copy(), np.zeros((3, 3))
        matching = Matching(
            first_reach_m, _LAST_REACH_M, _WIDTH_M, gain_of(len(cloud.points)), _ITERATIONS
        )
        align(pose, information, self.surfels, cloud, prior, prior_information, matching)
        return pose, without_noise(information)

    def shares(
        self, pose: NDArray[np.float64], cloud: Cloud
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Say what each keyframe contributes to the alignment of a scan.

        Returns:
            (k, 3, 3) information in `map`, and (k,) number of points.
        """
        count = len(self.keyframes)
        if count == 1:  # the kernel sums over all where there is room for one
            count = 2
        hessian, number = np.empty((count, 3, 3)), np.empty(count, np.int64)
        accumulate(
            hessian,
            np.empty((count, 3)),
            number,
            self.surfels,
            cloud,
            pose,
            (_LAST_REACH_M, _WIDTH_M, gain_of(len(cloud.points))),
        )
        kept = np.array([without_noise(one) for one in hessian[: len(self.keyframes)]])
        return kept, number[: len(self.keyframes)]

    def classify(
        self, pose: NDArray[np.float64], sweep: Sweep, near_m: float = NEAR_M
    ) -> NDArray[np.uint8]:
        """Return what the surfaces and the free space make of each point (n,) of a scan."""
        classes = np.empty(len(sweep.cloud.points), np.uint8)
        surfels.classify_points(classes, self.surfels, sweep.cloud, sweep.laser, pose, near_m)
        return classes

    def correlate(
        self,
        cloud: Cloud,
        around: NDArray[np.float64],
        window: tuple[float, float],
        least: float,
        pull: float,
    ) -> tuple[NDArray[np.float64], float] | None:
        """Search a window of poses for the one from which the scan fits best.

        Args:
            cloud: the scan.
            around: (3,) the middle of the window, map_T_base.
            window: half its edge [m] and half its range of headings [rad].
            least: scores below this are not looked for, 0 ... 1.
            pull: how much a pose in the window's corner must be better than one in its middle.

        Returns:
            The pose (3,) to about a cell, and its score; None if there is none.
        """
        levels = self._pyramid()
        every = max(len(cloud.points) // _SEARCH_POINTS, 1)
        some = Cloud(*(np.ascontiguousarray(one[::every]) for one in cloud))
        points = some.points
        far = float(np.quantile(np.hypot(*points.T), 0.8)) if len(points) else 1.0
        step = FINE_M / max(far, 1.0)
        turns = min(math.ceil(window[1] / step), math.ceil(math.pi / step))
        yaws = around[2] + np.linspace(-window[1], window[1], 2 * turns + 1)
        cells = np.empty((len(yaws), len(points), 3), np.int32)
        correlate.turn_cloud(cells, some, yaws, self._fine_frame, around[:2])
        best = np.empty(4)
        half = max(math.ceil(window[0] / FINE_M), 1)
        heading = correlate.find_best_shift(best, levels, cells, half, least, pull)
        if heading < 0:
            return None
        shift = np.array([best[2] * FINE_M, best[1] * FINE_M, 0.0])
        pose = np.array([around[0], around[1], yaws[heading]]) + shift
        return pose, float(best[0])

    def _pyramid(self) -> NDArray[np.uint8]:
        """Return the grids for correlative matching, drawn when first needed."""
        if self._levels is None:
            place = self.surfels.place[: self.count]
            low = place.min(axis=0) - 0.5 if self.count else np.zeros(2)
            high = place.max(axis=0) + 0.5 if self.count else np.ones(2)
            cols, rows = np.ceil((high - low) / FINE_M).astype(int)
            self._fine_frame = np.array([low[0], low[1], 1.0 / FINE_M])
            self._levels = np.empty((_HEIGHTS, correlate.LAYERS, rows, cols), np.uint8)
            correlate.draw_likelihood(
                self._levels[0], self.surfels, self.count, self._fine_frame, _BLUR_M
            )
            correlate.fill_pyramid(self._levels)
        return self._levels


def without_noise(information: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return information (3, 3) without what noise in the surfaces' directions feigns.

    Along a straight wall nothing can be told; normals that are off by some degrees seem to.
    """
    scale = np.array([1.0, 1.0, 1.0 / _TURN_M])
    values, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    values = np.maximum(values - _NORMAL_NOISE * values.sum(), 0.0)
    return (vectors * values) @ vectors.T / np.outer(scale, scale)


def gain_of(points: int) -> float:
    """Return the information of one point of a scan [1/m^2]: neighbours err together."""
    return min(1.0, _INDEPENDENT_POINTS / max(points, 1)) / _SIGMA_M**2
