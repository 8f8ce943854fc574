"""Edges of a new keyframe: from odometry, and from the scans that it was matched with."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trolley.scan_matching.layout import Cloud
from trolley_mapper.slam.local_map import LocalMap
from trolley_mapper.slam.pose_graph import (
    ODOMETRY,
    SCAN_MATCH,
    Edge,
    between,
    compose,
    inverse,
    to_frame,
)


@dataclass(frozen=True, slots=True)
class EdgeParams:
    """Which matches become edges. Found with bench/mapper/."""

    max_edges: int = 3
    """Number of scan-match edges that a keyframe gets at most."""
    min_share: float = 0.12
    """Least share of the matched points that the other keyframe of an edge contributes."""
    odometry_variance: float = 1e-6
    """Variance added to the odometry's covariance, so that it can be inverted [m^2, rad^2]."""
    min_unlearnt: float = 0.05
    """Share of what is learnt later below which a step stays as it is."""


PARAMS = EdgeParams()
FAINT = np.eye(3)
"""Information of a match in a direction that the scan does not show: a deviation of 1 m, 1 rad."""


def scan_match_edges(
    number: int, local: LocalMap, pose: NDArray[np.float64], cloud: Cloud, previous: int | None
) -> tuple[list[Edge], NDArray[np.float64]]:
    """Return edges from the keyframes nearby to a new one, by what each has contributed.

    Args:
        number: of the new keyframe.
        local: what it was matched with.
        pose: (3,) its map_T_base.
        cloud: its points.
        previous: the keyframe before, which gets the `odometry_edge`.

    Returns:
        The edges, and the information (3, 3) in `map` that is left for the edge from `previous`.
    """
    hessians, counts = local.contributions(pose, cloud)
    own = np.zeros((3, 3))
    for row, one in enumerate(local.keyframes):
        if one.number == previous:
            own = hessians[row]
    edges: list[Edge] = []
    best: list[int] = np.argsort(-counts)[: PARAMS.max_edges].tolist()
    for row in best:
        one = local.keyframes[row].number
        if counts[row] < PARAMS.min_share * len(cloud.points):
            break
        if one != previous:
            step = between(local.poses[row], pose)
            information = to_frame(hessians[row] + FAINT, float(pose[2]))
            edges.append(Edge(one, number, step, information, SCAN_MATCH))
    # Without other scan_match_edges all that was matched counts for the keyframe before.
    return edges, own if edges else hessians.sum(axis=0)


@dataclass(frozen=True, slots=True, eq=False)
class Travel:
    """What the odometry says of the path since the newest keyframe.

    Attributes:
        step: (3,) keyframe_T_base.
        covariance: (3, 3) of it, in `map`.
        start_covariance: (3, 3) of the keyframe's own pose when it was taken, in `map`.
        scale: of the odometry's distances, as the step was made with.
        unlearnt: share of what is learnt of the scale later that holds for this step, too.
    """

    step: NDArray[np.float64]
    covariance: NDArray[np.float64]
    start_covariance: NDArray[np.float64]
    scale: float = 1.0
    unlearnt: float = 0.0

    @classmethod
    def begin(
        cls, start_covariance: NDArray[np.float64], scale: float = 1.0, unlearnt: float = 0.0
    ) -> "Travel":
        """The robot is where the newest keyframe was taken."""
        return cls(np.zeros(3), np.zeros((3, 3)), start_covariance, scale, unlearnt)

    def then(self, step: NDArray[np.float64], covariance: NDArray[np.float64]) -> "Travel":
        """Return the path with one more step (3,) of a covariance (3, 3)."""
        return replace(self.less_sure(covariance), step=compose(self.step, step))

    def less_sure(self, covariance: NDArray[np.float64]) -> "Travel":
        """Return the same with more covariance (3, 3)."""
        return replace(self, covariance=self.covariance + covariance)


def odometry_edge(
    numbers: tuple[int, int],
    poses: tuple[NDArray[np.float64], NDArray[np.float64]],
    travel: Travel,
    matched: NDArray[np.float64],
) -> Edge:
    """Return the edge to a keyframe from the one before.

    A match that moves the new keyframe away from where the odometry led corrects the step between
    the two and the one before, each by its share of the covariance. Where the place along a
    corridor was not seen for long, and then is, the last step would else take all the drift.

    Args:
        numbers: of the one before and the new one.
        poses: (3,) map_T_base of both.
        travel: between them.
        matched: (3, 3) information from the scans, in `map`.

    Source:
        Rauch, Tung, Striebel, Maximum likelihood estimates of linear dynamic systems (1965).
    """
    yaw = float(poses[1][2])
    odometry = travel.covariance + PARAMS.odometry_variance * np.eye(3)
    by_odometry = to_frame(odometry, yaw)
    either = by_odometry + to_frame(travel.start_covariance, yaw)
    away = between(travel.step, between(*poses))
    step = compose(travel.step, by_odometry @ np.linalg.solve(either, away))
    information = to_frame(np.linalg.inv(odometry) + matched, yaw)
    edge = Edge(numbers[0], numbers[1], step, information, ODOMETRY)
    if travel.unlearnt < PARAMS.min_unlearnt:
        return edge
    share = inverse(information) @ to_frame(inverse(odometry), yaw)
    return edge._replace(scale=travel.scale, stretch=_stretch(travel, share))


def _stretch(travel: Travel, share: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return by how much a step grows with the scale of the odometry's distances, (3,).

    Args:
        travel: that the step was made with.
        share: (3, 3) of the odometry in the step, in the frame where it ends.

    Source:
        Kümmerle, Grisetti, Burgard, Simultaneous Parameter Calibration, Localization, and Mapping
        (2012): what is learnt of the wheels corrects what was driven before.
    """
    x, y, yaw = travel.step.tolist()
    cos, sin = math.cos(yaw), math.sin(yaw)
    turn = np.array([[cos, -sin], [sin, cos]])
    grown = turn @ share[:2, :2] @ turn.T @ np.array([x, y])
    return np.array([*(grown * travel.unlearnt / travel.scale), 0.0])
