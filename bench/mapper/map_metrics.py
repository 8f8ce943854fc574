"""What is wrong with a map, by the poses along a drive: found ones beside true ones.

Each function takes poses (n, 3) x, y [m], yaw [rad] of the same scans, in two frames that need not
be the same. It uses nothing of the mapper: it judges any.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import spatial

from trolley.geometry import Pose2D

Poses = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class MetricParams:
    """What counts as a revisit, and as a wrong one. Set by hand."""

    near_m: float = 1.0
    """Distance within which a scan revisits where an earlier one was taken [m]."""
    since_m: float = 20.0
    """Distance that must have been driven between the two [m]."""
    wrong_m: float = 0.5
    """Error of the two scans' relative pose on the map from which on a revisit is wrong [m]."""
    same_loop_m: float = 5.0
    """Distance between revisits below which they close one loop [m]."""
    relative_m: tuple[float, ...] = tuple(float(d) for d in range(1, 11))
    """Distances driven over which the relative error is taken [m]."""


PARAMS = MetricParams()


def way_m(poses: Poses) -> NDArray[np.float64]:
    """The distance driven until each pose (n,) [m]."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])


def relative_errors(
    found: Poses, truth: Poses, first: NDArray[np.int64], second: NDArray[np.int64]
) -> NDArray[np.float64]:
    """By how much the second pose lies elsewhere as seen from the first, (m,) [m]."""
    return np.hypot(*(_seen_from(found, first, second) - _seen_from(truth, first, second)).T)


def _seen_from(
    poses: Poses, first: NDArray[np.int64], second: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Places (m, 2) of the second poses in the frames of the first."""
    away = poses[second, :2] - poses[first, :2]
    cos, sin = np.cos(poses[first, 2]), np.sin(poses[first, 2])
    return np.column_stack(
        [cos * away[:, 0] + sin * away[:, 1], -sin * away[:, 0] + cos * away[:, 1]]
    )


def relative_error_m(found: Poses, truth: Poses) -> float:
    """Mean error of relative poses over 1 to 10 m driven [m]; NaN where less was driven.

    Source:
        Kümmerle et al., On Measuring the Accuracy of SLAM Algorithms (2009).
    """
    way = way_m(truth)
    means: list[float] = []
    for distance_m in PARAMS.relative_m:
        second = np.searchsorted(way, way + distance_m - 1e-9)
        first = np.flatnonzero(second < len(way))
        if len(first):
            means.append(float(relative_errors(found, truth, first, second[first]).mean()))
    return float(np.mean(means)) if means else math.nan


@dataclass(frozen=True, slots=True)
class Revisits:
    """Scans taken where the robot had been before.

    Attributes:
        scans: (m,) their rows.
        before: (m,) the row of the nearest scan of those before.
        error_m: (m,) how far the map has the two from how they truly lie to each other [m].
        loop: (m,) number of the loop that each closes, from 0.
    """

    scans: NDArray[np.int64]
    before: NDArray[np.int64]
    error_m: NDArray[np.float64]
    loop: NDArray[np.int64]

    @property
    def is_wrong(self) -> NDArray[np.bool_]:
        """(m,) where the map shows a place twice, or two places as one."""
        return self.error_m > PARAMS.wrong_m

    @property
    def wrong_share(self) -> float:
        """Share of the revisits that are wrong; 0 where there are none."""
        return float(self.is_wrong.mean()) if len(self.scans) else 0.0

    def unsaid_share(self, is_sure: NDArray[np.bool_]) -> float:
        """Share of the revisits that are wrong, with the mapper sure (n,) of both scans."""
        unsaid = self.is_wrong & is_sure[self.scans] & is_sure[self.before]
        return float(unsaid.mean()) if len(self.scans) else 0.0

    @property
    def num_loops(self) -> int:
        """How often the drive came back to where it had been."""
        return int(self.loop.max()) + 1 if len(self.loop) else 0

    @property
    def num_closed(self) -> int:
        """How many of these loops close on the map: half of their revisits at least are right."""
        return sum(
            float(np.median(self.error_m[self.loop == k])) <= PARAMS.wrong_m
            for k in range(self.num_loops)
        )


def revisits(found: Poses, truth: Poses) -> Revisits:
    """Find where a drive came back to places, and how well the map knows it."""
    way = way_m(truth)
    tree = spatial.KDTree(truth[:, :2])
    scans: list[int] = []
    before: list[int] = []
    for row in range(len(truth)):
        near: list[int] = tree.query_ball_point(truth[row, :2], PARAMS.near_m)
        older = np.array([k for k in near if way[row] - way[k] > PARAMS.since_m], np.int64)
        if len(older):
            away = np.hypot(*(truth[older, :2] - truth[row, :2]).T)
            scans.append(row)
            before.append(int(older[np.argmin(away)]))
    second, first = np.array(scans, np.int64), np.array(before, np.int64)
    error_m = relative_errors(found, truth, first, second)
    begins = np.diff(way[second], prepend=-math.inf) > PARAMS.same_loop_m
    return Revisits(second, first, error_m, np.cumsum(begins) - 1)


def alignment(found: NDArray[np.float64], true: NDArray[np.float64]) -> Pose2D:
    """Return true_T_found, which turns and shifts points (n, 2) onto the true ones best.

    Source:
        Umeyama, Least-Squares Estimation of Transformation Parameters (1991).
    """
    middle_found, middle_true = found.mean(axis=0), true.mean(axis=0)
    u, _, vt = np.linalg.svd((found - middle_found).T @ (true - middle_true))
    turn = (u @ np.diag([1.0, np.sign(np.linalg.det(u @ vt))]) @ vt).T
    shift = middle_true - turn @ middle_found
    return Pose2D(float(shift[0]), float(shift[1]), math.atan2(turn[1, 0], turn[0, 0]))


def errors_m(found: Poses, truth: Poses) -> NDArray[np.float64]:
    """How far each pose is off after the best alignment of all (n,) [m]."""
    fit = alignment(found[:, :2], truth[:, :2])
    return np.hypot(*(fit.transform_points(found[:, :2]) - truth[:, :2]).T)
