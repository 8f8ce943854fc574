"""Bundles of arrays that the kernels share."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Surfels(NamedTuple):
    """Small pieces of surface, found by the cell that they lie in.

    Attributes:
        place: (capacity, 2) x, y [m] in `map`.
        normal: (capacity, 2) sum of unit normals, turned towards where it was seen from.
        weight: (capacity,) points that were averaged.
        owner: (capacity,) int32, index of the keyframe that saw it first.
        following: (capacity,) int32, next surfel of the same cell, -1 at the end.
        head: (rows, cols) int32, first surfel of each cell, -1 if none.
        seen_through: (rows, cols) uint8, how many beams of keyframes went on there, 250 at most.
        frame: (3,) x, y [m] of the outer corner of cell (0, 0) in `map`, and cells per metre.
    """

    place: NDArray[np.float64]
    normal: NDArray[np.float64]
    weight: NDArray[np.float64]
    owner: NDArray[np.int32]
    following: NDArray[np.int32]
    head: NDArray[np.int32]
    seen_through: NDArray[np.uint8]
    frame: NDArray[np.float64]


class Cloud(NamedTuple):
    """Points of a scan in `base_link` [m].

    Attributes:
        points: (n, 2) float64.
        normals: (n, 2) float64, unit length towards the laser; zero where there is none.
    """

    points: NDArray[np.float64]
    normals: NDArray[np.float64]


class AlignmentParams(NamedTuple):
    """How a scan is compared with surfels.

    Attributes:
        first_reach: surfels within this distance of a point are its partners at first [m].
        last_reach: the same in the end [m].
        width: residual at which a point counts half in the end, about [m].
        gain: information of one point [1/m^2].
        iterations: at most so many steps.
    """

    first_reach: float
    last_reach: float
    width: float
    gain: float
    iterations: int
