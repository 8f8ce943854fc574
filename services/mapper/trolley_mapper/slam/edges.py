"""Edges of a new keyframe: from odometry, and from the scans that it was matched with."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.scan_matching.layout import Cloud
from trolley_mapper.slam.local_map import LocalMap
from trolley_mapper.slam.pose_graph import ODOMETRY, SCAN_MATCH, Edge, between, to_frame


@dataclass(frozen=True, slots=True)
class EdgeParams:
    """Which matches become edges. Found with bench/mapper/."""

    max_edges: int = 3
    """Number of scan-match edges that a keyframe gets at most."""
    min_share: float = 0.12
    """Least share of the matched points that the other keyframe of an edge contributes."""
    odometry_variance: float = 1e-6
    """Variance added to the odometry's covariance, so that it can be inverted [m^2, rad^2]."""


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


def odometry_edge(
    numbers: tuple[int, int],
    poses: tuple[NDArray[np.float64], NDArray[np.float64]],
    odometry: NDArray[np.float64],
    matched: NDArray[np.float64],
) -> Edge:
    """Return the edge to a keyframe from the one before.

    Args:
        numbers: of the one before and the new one.
        poses: (3,) map_T_base of both.
        odometry: (3, 3) covariance of the motion between them, in `map`.
        matched: (3, 3) information from the scans, in `map`.
    """
    information = np.linalg.inv(odometry + PARAMS.odometry_variance * np.eye(3)) + matched
    step = between(*poses)
    return Edge(numbers[0], numbers[1], step, to_frame(information, float(poses[1][2])), ODOMETRY)
