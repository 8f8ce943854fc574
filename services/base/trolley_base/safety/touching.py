"""Points that touch the outline of the robot, seen from it as it moves. Frame `base_link`, SI."""

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Twist2D
from trolley.geometry.polygon import edges_of

Floats = NDArray[np.float64]


def closest_on_outline(points: Floats, outline: Floats) -> Floats:
    """Return for each point (n, 2) the nearest point (n, 2) on an outline (m, 2) [m]."""
    edge = edges_of(outline)
    offset = points[:, None, :] - outline
    along = np.sum(offset * edge, axis=2) / np.sum(edge * edge, axis=1)
    feet = outline + np.clip(along, 0.0, 1.0)[:, :, None] * edge
    gaps = points[:, None, :] - feet
    nearest = np.argmin(np.sum(gaps * gaps, axis=2), axis=1)
    return feet[np.arange(len(points)), nearest]


def point_velocities(points: Floats, twist: Twist2D) -> Floats:
    """Return how points (n, 2) that stand move as seen from the robot, (n, 2) [m/s]."""
    return np.stack(
        [twist.wz * points[:, 1] - twist.vx, -twist.wz * points[:, 0] - twist.vy], axis=1
    )
