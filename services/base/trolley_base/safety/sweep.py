"""When a moving outline meets points: exact, for straight lines and arcs. Frame `base_link`, SI.

Seen from the robot the world moves: with a constant velocity every point runs along a straight
line, or along a circle about the centre of the turn, until it meets an edge of the outline.
"""

import math

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Twist2D
from trolley.geometry.polygon import edges_of

MIN_CURVATURE = 1e-3
"""Flatter arcs count as straight lines [1/m]: over a metre that is wrong by half a millimetre."""
EDGE_TOLERANCE = 1e-9
"""Tolerance along an edge, so that no point slips between two."""

Floats = NDArray[np.float64]


def contact_times(points: Floats, outline: Floats, twist: Twist2D) -> Floats:
    """Return when each point meets the outline of a robot that drives with a constant velocity.

    Args:
        points: (n, 2) x, y [m], outside the outline.
        outline: (m, 2) x, y [m].
        twist: the robot's velocity.

    Returns:
        (n,) [s]; +inf where the two never meet (on a circle: not within a turn).
    """
    if len(points) == 0 or twist.is_zero:
        return np.full(len(points), np.inf)
    if abs(twist.wz) <= MIN_CURVATURE * twist.speed:
        return _straight_times(points, outline, twist)
    return _arc_times(points, outline, twist)


def _straight_times(points: Floats, outline: Floats, twist: Twist2D) -> Floats:
    edges = edges_of(outline)
    px = points[:, 0, None] - outline[:, 0]
    py = points[:, 1, None] - outline[:, 1]
    # p - d t = a + along e, both sides crossed with e, then with d.
    across = twist.vx * edges[:, 1] - twist.vy * edges[:, 0]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        times = (px * edges[:, 1] - py * edges[:, 0]) / across
        along = (twist.vx * py - twist.vy * px) / across
    meets = (along >= -EDGE_TOLERANCE) & (along <= 1.0 + EDGE_TOLERANCE) & (times >= 0.0)
    return np.min(np.where(meets, times, np.inf), axis=1)


def _arc_times(points: Floats, outline: Floats, twist: Twist2D) -> Floats:
    centre = np.array([-twist.vy, twist.vx]) / twist.wz
    q = points - centre
    start = outline - centre
    edge = edges_of(outline)
    # |start + along e|^2 = |q|^2, a quadratic in `along`.
    a = np.sum(edge * edge, axis=1)
    half_b = np.sum(start * edge, axis=1)
    c = np.sum(start * start, axis=1) - np.sum(q * q, axis=1)[:, None]
    discriminant = half_b * half_b - a * c
    root = np.sqrt(np.maximum(discriminant, 0.0))
    times = np.full(len(points), np.inf)
    for along in ((-half_b - root) / a, (-half_b + root) / a):
        meets = (discriminant >= 0.0) & (along >= -EDGE_TOLERANCE) & (along <= 1.0 + EDGE_TOLERANCE)
        point, side = np.nonzero(meets)
        hit = start[side] + along[point, side, None] * edge[side]
        at = q[point]
        cross = hit[:, 0] * at[:, 1] - hit[:, 1] * at[:, 0]
        dot = hit[:, 0] * at[:, 0] + hit[:, 1] * at[:, 1]
        # The points run against the robot's own turn.
        turn = np.arctan2(math.copysign(1.0, twist.wz) * cross, dot) % (2.0 * math.pi)
        # A point on the outline is met now and not after a whole turn.
        turn[turn > 2.0 * math.pi - 1e-9] = 0.0
        with np.errstate(over="ignore"):  # so slow a turn takes forever
            np.minimum.at(times, point, turn / abs(twist.wz))
    return times
