"""The surfaces near the robot, put together from some keyframes."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.config.mapper import MapperConfig
from trolley.scan_matching import surfels
from trolley.scan_matching.align import accumulate, align
from trolley.scan_matching.information import gain_of, without_noise
from trolley.scan_matching.layout import AlignmentParams, Cloud, Surfels
from trolley.scan_matching.sweep import Sweep
from trolley.slices import Slices
from trolley_mapper.kernels import correlate
from trolley_mapper.slam.keyframe import Keyframe
from trolley_mapper.slam.keyframe_store import KeyframeStore
from trolley_mapper.slam.pose_graph import between


@dataclass(frozen=True, slots=True)
class LocalMapParams:
    """How scans are compared with surfaces. Found with bench/mapper/ unless stated otherwise."""

    cell_m: float = 0.1
    """Edge of the cells that surfels are averaged in [m]."""
    width_m: float = 0.05
    """Residual at which a point counts half, about [m]."""
    last_reach_m: float = 0.12
    """Distance within which points have partners in the last steps [m]."""
    max_iterations: int = 25
    """Number of Gauss-Newton steps of an alignment at most."""
    near_m: float = 0.08
    """Distance from a surface within which a point is explained by it [m]."""
    fine_cell_m: float = 0.05
    """Cell edge of the grid for correlative matching [m]."""
    blur_m: float = 0.07
    """Standard deviation of a point in that grid [m]."""
    num_levels: int = 5
    """Levels of its pyramid."""
    search_far_m: float = 12.0
    """Distance from the robot beyond which points are left out of the search; the alignment after
    it takes them [m]."""
    search_spare_m: float = 1.0
    """Extra reach of the grid beyond a search, for the next one nearby [m]."""
    search_points: int = 180
    """Approximate number of a scan's points that are searched with."""
    free_beams: int = 120
    """Approximate number of each keyframe's beams that mark free space."""
    prior_times: int = 3
    """Number of keyframes that the floor of an earlier map counts as seen by (by hand)."""


PARAMS = LocalMapParams()


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
        cells = math.ceil(2.0 * reach_m / PARAMS.cell_m)
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
            np.array([centre[0] - reach_m, centre[1] - reach_m, 1.0 / PARAMS.cell_m]),
        )
        surfels.clear_surfels(self.surfels)
        self.count = 0
        for owner, (one, pose) in enumerate(zip(keyframes, poses, strict=True)):
            self.count = surfels.add_surfels(
                self.surfels, self.count, one.points, one.normals, pose, owner
            )
            if one.floor is not None:
                surfels.mark_floor(self.surfels, one.floor, PARAMS.prior_times)
                continue
            every = max(len(one.points) // PARAMS.free_beams, 1)
            surfels.mark_free(self.surfels, one.points, one.laser, pose, every)
        surfels.normalise_surfels(self.surfels, self.count)
        self._levels = np.empty((PARAMS.num_levels, correlate.LAYERS + 1, 0, 0), np.uint8)
        self._fine_frame = np.empty(3)
        # Corners (2, 2) of what the levels show [m].
        self._drawn = np.zeros((2, 2))

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
        params = AlignmentParams(
            first_reach_m,
            PARAMS.last_reach_m,
            PARAMS.width_m,
            gain_of(len(cloud.points)),
            PARAMS.max_iterations,
        )
        align(pose, information, self.surfels, cloud, prior, prior_information, params)
        return pose, without_noise(information)

    def contributions(
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
            (PARAMS.last_reach_m, PARAMS.width_m, gain_of(len(cloud.points))),
        )
        kept = np.array([without_noise(one) for one in hessian[: len(self.keyframes)]])
        return kept, number[: len(self.keyframes)]

    def classify(
        self, pose: NDArray[np.float64], sweep: Sweep, near_m: float = PARAMS.near_m
    ) -> NDArray[np.uint8]:
        """Classify each point (n,) of a scan by the surfaces and the free space."""
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
    ) -> Slices[tuple[NDArray[np.float64], float] | None]:
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
        levels = self._pyramid(around[:2], window[0] + PARAMS.search_far_m)
        yield
        near = np.flatnonzero(np.hypot(*cloud.points.T) <= PARAMS.search_far_m)
        every = max(len(near) // PARAMS.search_points, 1)
        some = Cloud(*(np.ascontiguousarray(one[near[::every]]) for one in cloud))
        points = some.points
        far = float(np.quantile(np.hypot(*points.T), 0.8)) if len(points) else 1.0
        step = PARAMS.fine_cell_m / max(far, 1.0)
        turns = min(math.ceil(window[1] / step), math.ceil(math.pi / step))
        yaws = around[2] + np.linspace(-window[1], window[1], 2 * turns + 1)
        cells = np.empty((len(yaws), len(points), 3), np.int32)
        correlate.turn_cloud(cells, some, yaws, self._fine_frame, around[:2])
        half = max(math.ceil(window[0] / PARAMS.fine_cell_m), 1)
        best = yield from correlate.find_best_shift(levels, cells, half, least, pull)
        heading = int(best[4])
        if heading < 0:
            return None
        shift = np.array([best[2] * PARAMS.fine_cell_m, best[1] * PARAMS.fine_cell_m, 0.0])
        pose = np.array([around[0], around[1], yaws[heading]]) + shift
        return pose, float(best[0])

    def _pyramid(self, centre: NDArray[np.float64], reach_m: float) -> NDArray[np.uint8]:
        """Return the grids for correlative matching, drawn round a place (2,) when first needed."""
        place = self.surfels.place[: self.count] if self.count else centre[None]
        bounds = np.array([place.min(axis=0) - 0.5, place.max(axis=0) + 0.5])
        wanted = np.clip([centre - reach_m, centre + reach_m], bounds[0], bounds[1])
        if (wanted[0] >= self._drawn[0]).all() and (wanted[1] <= self._drawn[1]).all():
            return self._levels
        spare = np.array([[-PARAMS.search_spare_m], [PARAMS.search_spare_m]])
        low, high = self._drawn = np.clip(wanted + spare, bounds[0], bounds[1])
        cols, rows = np.maximum(np.ceil((high - low) / PARAMS.fine_cell_m), 1).astype(int)
        self._fine_frame = np.array([low[0], low[1], 1.0 / PARAMS.fine_cell_m])
        self._levels = np.empty((PARAMS.num_levels, correlate.LAYERS + 1, rows, cols), np.uint8)
        correlate.draw_likelihood(
            self._levels[0], self.surfels, self.count, self._fine_frame, PARAMS.blur_m
        )
        correlate.fill_pyramid(self._levels)
        return self._levels


class Neighbourhood:
    """The local map around the robot, rebuilt when the robot has moved on."""

    def __init__(self, config: MapperConfig) -> None:
        self._config = config
        self._local: LocalMap | None = None
        self._centre = np.zeros(3)

    def invalidate(self) -> None:
        """Rebuild it at the next chance: keyframes have come, gone or moved."""
        self._local = None

    def around(
        self, store: KeyframeStore, pose: NDArray[np.float64], newest: int | None
    ) -> LocalMap:
        """Return the surfaces near a pose (3,).

        Args:
            store: the keyframes.
            pose: map_T_base.
            newest: the keyframe that the robot came from; None: the nearest.
        """
        config = self._config
        away = between(self._centre, pose)
        has_moved = math.hypot(away[0], away[1]) > 2.0 * config.keyframe_distance_m
        if self._local is None or has_moved:
            start = store.nearest(pose) if newest is None else newest
            numbers = store.around(start, pose, config.local_way_m, config.local_keyframes)
            keyframes = [store.keyframes[store.rows[n]] for n in numbers]
            poses = np.array([store.pose(n) for n in numbers])
            self._local = LocalMap(keyframes, poses, pose[:2], config.local_reach_m)
            self._centre = pose.copy()
        return self._local
