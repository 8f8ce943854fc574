"""The angle by which to turn a map so that its walls run along the axes."""

import math

import numpy as np
from numpy.typing import NDArray

from trolley.gridmap import OCCUPIED_FROM, GridMap

# As many cells of walls say it as well as all.
_MAX_POINTS = 20_000
_MIN_POINTS = 20
_COARSE_RAD, _FINE_RAD = math.radians(0.5), math.radians(0.05)
# Bins per cell, and how a cell is spread over them: with whole cells in whole bins a grid that is
# almost straight already would stand out as it lies.
_BINS = 4
_BLUR = np.convolve(np.ones(_BINS), np.ones(_BINS))
# How far the best angle must stand out from the median of all: maps of houses and offices gave 1.6
# and more, round halls with and without shelves up to 1.1.
_MIN_LEAD = 1.3


def angle_to_straighten(grid: GridMap) -> float:
    """Return the smallest turn [rad] after which most walls run along x or y.

    It is 0 where there are no walls, or where no direction stands out, as in a round hall.
    """
    walls = np.argwhere(grid.cells >= OCCUPIED_FROM)[:, ::-1].astype(np.float64)
    angle = angle_of_walls(walls)
    # In the grid's own frame, which may be turned on the map; into (-45, 45] degrees.
    return 0.0 if angle is None else _smallest(angle - grid.origin.yaw)


def angle_of_walls(points: NDArray[np.float64]) -> float | None:
    """Return the smallest turn [rad] after which most walls run along x or y.

    Walls along an axis lie on few rows or columns: the angle is sought at which the counts of
    points per row and column are the most uneven. Of two wings the one with the longer walls
    decides.

    Args:
        points: (n, 2) of walls, spread evenly along them [cells].

    Returns:
        The angle; None without walls, or where no direction stands out.

    Source:
        Weiss, Wetzler, von Puttkamer, Keeping Track of Position and Orientation of Moving Indoor
        Systems by Correlation of Range-Finder Scans (1994): histograms over x and y.
    """
    if len(points) < _MIN_POINTS:
        return None
    chosen = np.linspace(0, len(points) - 1, min(len(points), _MAX_POINTS)).astype(np.int64)
    points = points[chosen]
    quarter = np.arange(-math.pi / 4, math.pi / 4, _COARSE_RAD)
    unevenness = np.array([_unevenness(points, angle) for angle in quarter])
    if unevenness.max() < _MIN_LEAD * np.median(unevenness):
        return None
    rough = quarter[int(np.argmax(unevenness))]
    near = rough + np.arange(-_COARSE_RAD, _COARSE_RAD + 0.5 * _FINE_RAD, _FINE_RAD)
    return _smallest(float(near[int(np.argmax([_unevenness(points, angle) for angle in near]))]))


def _smallest(angle: float) -> float:
    return angle - round(angle / (math.pi / 2)) * math.pi / 2


def _unevenness(points: NDArray[np.float64], angle: float) -> float:
    """Return the sum of squares of the counts per row and column after a turn."""
    cos, sin = math.cos(angle), math.sin(angle)
    total = 0.0
    for values in (
        cos * points[:, 0] - sin * points[:, 1],
        sin * points[:, 0] + cos * points[:, 1],
    ):
        index = np.floor(values * _BINS).astype(np.int64)
        counts = np.convolve(np.bincount(index - index.min()), _BLUR)
        total += float(counts @ counts)
    return total
