"""Edges between a new keyframe and those that it was matched with."""

import numpy as np
from numpy.typing import NDArray

from trolley_mapper.kernels.layout import Cloud
from trolley_mapper.slam.local_map import LocalMap
from trolley_mapper.slam.pose_graph import NEAR, NEXT, Edge, between, to_frame

# A keyframe is tied to as many others as contributed at least such a share of the matched points.
_TIES = 3
_SHARE = 0.12
# What a match says of a direction in which the scan tells nothing: a deviation of 1 m, 1 rad.
FAINT = np.eye(3)


def ties(
    number: int, local: LocalMap, pose: NDArray[np.float64], cloud: Cloud, previous: int | None
) -> tuple[list[Edge], NDArray[np.float64]]:
    """Return edges from the keyframes near by to a new one, by what each has contributed.

    Args:
        number: of the new keyframe.
        local: what it was matched with.
        pose: (3,) its map_T_base.
        cloud: its points.
        previous: the keyframe before, which is tied by `next_edge`.

    Returns:
        The edges, and the information (3, 3) in `map` that is left for the tie to `previous`.
    """
    hessians, counts = local.shares(pose, cloud)
    own = np.zeros((3, 3))
    for row, one in enumerate(local.keyframes):
        if one.number == previous:
            own = hessians[row]
    edges: list[Edge] = []
    best: list[int] = np.argsort(-counts)[:_TIES].tolist()
    for row in best:
        one = local.keyframes[row].number
        if counts[row] < _SHARE * len(cloud.points):
            break
        if one != previous:
            step = between(local.poses[row], pose)
            information = to_frame(hessians[row] + FAINT, float(pose[2]))
            edges.append(Edge(one, number, step, information, NEAR))
    # Without other ties all that was matched counts for the keyframe before.
    return edges, own if edges else hessians.sum(axis=0)


def next_edge(
    numbers: tuple[int, int],
    poses: tuple[NDArray[np.float64], NDArray[np.float64]],
    odometry: NDArray[np.float64],
    matched: NDArray[np.float64],
) -> Edge:
    """Tie a keyframe to the one before.

    Args:
        numbers: of the one before and the new one.
        poses: (3,) map_T_base of both.
        odometry: (3, 3) covariance of the way between them, in `map`.
        matched: (3, 3) information from the scans, in `map`.
    """
    information = np.linalg.inv(odometry + 1e-6 * np.eye(3)) + matched
    step = between(*poses)
    return Edge(numbers[0], numbers[1], step, to_frame(information, float(poses[1][2])), NEXT)
