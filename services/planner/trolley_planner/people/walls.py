"""People beside a wall walk along it, unless their track says otherwise.

A velocity is known to some centimetres a second, which become decimetres until two meet in a
corridor: enough to take the side for free that is not.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel


class WallFollowingParams(NamedTuple):
    """When people are taken to walk along a wall; by hand."""

    deviations: float = 2.0
    """Speed from or to the wall that is not believed, in standard deviations of the velocity."""
    most_share: float = 0.25
    """Greatest share of their speed that is not believed."""
    step_m: float = 0.1
    """Distance to both sides at which the distance to the wall is compared [m]."""
    least_slope: float = 0.25
    """Least change of that distance per metre for the wall to have a direction there: in the middle
    between two walls it has none."""


WALLS = WallFollowingParams()


@kernel
def walk_along_walls(
    walkers: NDArray[np.float64],
    deviations: NDArray[np.float64],
    wall_distance_m: NDArray[np.float32],
    resolution_m: float,
) -> None:
    """Take from velocities what leads from or to a wall and may as well be an error.

    Args:
        walkers: (n, 4 or more) x, y [m], velocity [m/s], changed in place.
        deviations: (n,) standard deviation of each velocity [m/s].
        wall_distance_m: (rows, cols) distance of each cell to the nearest wall of the map.
        resolution_m: edge of a cell [m].
    """
    (rows, cols), step = wall_distance_m.shape, max(1, round(WALLS.step_m / resolution_m))
    for index in range(walkers.shape[0]):
        col = math.floor(walkers[index, 0] / resolution_m)
        row = math.floor(walkers[index, 1] / resolution_m)
        if not (step <= row < rows - step and step <= col < cols - step):
            continue
        x = wall_distance_m[row, col + step] - wall_distance_m[row, col - step]
        y = wall_distance_m[row + step, col] - wall_distance_m[row - step, col]
        slope = math.hypot(x, y)
        if slope < WALLS.least_slope * 2.0 * step * resolution_m:
            continue
        x, y = x / slope, y / slope
        vx, vy = walkers[index, 2], walkers[index, 3]
        across = vx * x + vy * y
        most = min(WALLS.deviations * deviations[index], WALLS.most_share * math.hypot(vx, vy))
        if abs(across) < most:
            walkers[index, 2], walkers[index, 3] = vx - across * x, vy - across * y
