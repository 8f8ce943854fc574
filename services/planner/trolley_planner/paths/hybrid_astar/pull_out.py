"""Pulling out from beside a wall, as a car does: so gently that no corner swings into it.

A robot that turns away from a wall swings the corner behind its axle towards it. How near it stands
is not known to the centimetre, so its way is not searched: it is the one on which that corner
approaches the wall at a flat angle at first, and, the more the robot has turned, falls back.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley_planner.costmap.fine_grid import FineGrid
from trolley_planner.costmap.footprint import Body
from trolley_planner.paths.hybrid_astar.centering import Layers, pushes
from trolley_planner.paths.hybrid_astar.curves import LEAST_RADIUS_M
from trolley_planner.paths.hybrid_astar.motion_primitives import BACKWARDS, FORWARDS, Maneuver
from trolley_planner.paths.hybrid_astar.search_space import NEVER_SEEN


class PullOutParams(NamedTuple):
    """When and how the robot pulls out; by hand."""

    near_m: float = 0.018
    """Clearance below which the search, whose moves turn by whole headings, finds no good way."""
    enough_m: float = 0.06
    """Clearance to which it pulls out."""
    aside_m: float = 0.05
    """Distance to the side at which there must be more clearance: else it stands between two
    things."""
    aside_share: float = 0.7
    """Share of that distance by which there must be more."""
    flat: float = 0.015
    """Slope at which the corner behind the axle approaches the wall at first: half of what `base`
    lets touch it."""
    decay_m: float = 0.2
    """Distance over which that slope decays: in all it comes nearer by 3 mm."""
    err_m: float = 0.02
    """Clearance that is lost on the way to errors of what was measured; with more, something else
    stands there."""
    step_m: float = 0.025
    """Distance between two poses."""
    most_m: float = 1.5
    """Greatest length."""


PULL_OUT = PullOutParams()


def pull_out(
    start: Pose2D, grid: FineGrid, unseen: NDArray[np.uint8], body: Body
) -> Maneuver | None:
    """Return a drive away from what the robot stands beside, None where it does not or cannot.

    Args:
        start: of the robot, in the frame of `grid`'s corner.
        grid: what stands around.
        unseen: (rows, cols) of `grid`, NEVER_SEEN where it must not back into.
        body: its outline.
    """
    own, layers = _looked_up(start, grid, unseen)
    side = free_side(own, layers, body)
    if side == 0:
        return None
    ways = [(_pulled(own, side, sense, layers, body), sense) for sense in (FORWARDS, BACKWARDS)]
    clear = [(poses, sense) for poses, sense in ways if poses is not None]
    if not clear:
        return None
    poses, sense = min(clear, key=lambda way: len(way[0]))
    there = poses + np.array([grid.x, grid.y, 0.0])
    return Maneuver(there, np.full(len(there), sense, np.int8), len(there))


def pulled_aside(
    start: Pose2D, grid: FineGrid, unseen: NDArray[np.uint8], body: Body
) -> Pose2D | None:
    """Return a pose at its side from which a robot that may pull out can be taken to begin.

    None where it need not, or cannot; the arguments are those of `pull_out`.
    """
    own, layers = _looked_up(start, grid, unseen)
    side = free_side(own, layers, body)
    return None if side == 0 else start @ Pose2D(0.0, side * PULL_OUT.aside_m, 0.0)


def _looked_up(start: Pose2D, grid: FineGrid, unseen: NDArray[np.uint8]) -> tuple[Pose2D, Layers]:
    """Return a pose from the corner of the cells on, and the layers that it is looked up in."""
    own = Pose2D(start.x - grid.x, start.y - grid.y, start.yaw)
    return own, (grid.distance_m, unseen, grid.fine_m)


def free_side(own: Pose2D, layers: Layers, body: Body) -> int:
    """Return on which side there is room for a robot that all but touches something on the other.

    Args:
        own: of the robot, from the corner of the cells on.
        layers: see `centering.bend`.
        body: its outline.

    Returns:
        1 for the left, -1 for the right, 0 where it does not, or stands between two things.
    """
    here_m = pushes(layers, body, (own.x, own.y, own.yaw))[1]
    if here_m >= PULL_OUT.near_m:
        return 0
    for side in (1, -1):
        aside = own @ Pose2D(0.0, side * PULL_OUT.aside_m, 0.0)
        more_m = pushes(layers, body, (aside.x, aside.y, aside.yaw))[1] - here_m
        if more_m >= PULL_OUT.aside_share * PULL_OUT.aside_m:
            return side
    return 0


def _pulled(
    own: Pose2D, side: int, sense: int, layers: Layers, body: Body
) -> NDArray[np.float64] | None:
    """Return poses (n, 3) to the left (side 1) or right (-1), None if they do not get clear."""
    corner_m = -float((sense * body.edge_points[:, 0]).min())
    x, y, turned = own.x, own.y, 0.0
    poses = [(x, y, own.yaw)]
    least_m = pushes(layers, body, poses[0])[1] - PULL_OUT.err_m
    while len(poses) * PULL_OUT.step_m < PULL_OUT.most_m:
        slope = PULL_OUT.flat * math.exp(-(len(poses) - 1) * PULL_OUT.step_m / PULL_OUT.decay_m)
        bend = min((slope + turned) / corner_m, 0.5 / LEAST_RADIUS_M)
        middle = own.yaw + side * sense * (turned + 0.5 * bend * PULL_OUT.step_m)
        turned += bend * PULL_OUT.step_m
        x += sense * PULL_OUT.step_m * math.cos(middle)
        y += sense * PULL_OUT.step_m * math.sin(middle)
        poses.append((x, y, own.yaw + side * sense * turned))
        _, clear_m, known = pushes(layers, body, poses[-1])
        if clear_m < least_m or (sense == BACKWARDS and known == NEVER_SEEN):
            return None
        if clear_m >= PULL_OUT.enough_m:
            return np.array(poses)
    return None
