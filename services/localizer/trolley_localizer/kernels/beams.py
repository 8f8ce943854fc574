"""The beams of one scan: which have an echo, and few of them in place of all."""

import math

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel
from trolley.scanning import Points
from trolley_localizer.kernels.matching import NOT_ON_MAP, UNUSED


@kernel
def mark_echoes(
    out_classes: NDArray[np.uint8],
    ranges: NDArray[np.float32],
    echoes: NDArray[np.int64],
    telling_m: float,
) -> int:
    """Write which beams have an echo; return how many end beyond a distance.

    Args:
        out_classes: (n,), overwritten: NOT_ON_MAP where there is an echo, else UNUSED.
        ranges: (n,) [m].
        echoes: (m,) indices of the beams with an echo.
        telling_m: the distance [m].
    """
    out_classes[:] = UNUSED
    telling = 0
    for beam in echoes:
        out_classes[beam] = NOT_ON_MAP
        if ranges[beam] > np.float32(telling_m):
            telling += 1
    return telling


MOST_OF_MEAN = 1.0
"""Multiple of the mean length from which on beams count alike. Far walls are not measured better:
on a recorded drive in clutter the right place had a median support of 0.79 with all beams alike,
0.75 with 1 and 0.72 with 2, which places on maps of other houses reach, too."""


@kernel
def take_evenly(
    out: Points, end: Points, start: Points, indices: NDArray[np.int64], phase: float
) -> None:
    """Take some of many end points, evenly over the surface that was seen.

    Beams are evenly spaced by angle, so each covers surface in proportion to its length. What is
    close by meets many of them: a bed that was moved would outvote the walls of its room.

    Args:
        out: (k,), overwritten; a point may be taken more than once.
        end: (n,) end points [cells].
        start: (n,) where the laser was for each [cells].
        indices: (m,) of those that may be taken, one at least.
        phase: 0 ... 1, shifts the choice between neighbours.
    """
    count = out.x.size
    length = np.empty(indices.size)
    total = 0.0
    for i in range(indices.size):
        beam = indices[i]
        dx = end.x[beam] - start.x[beam]
        dy = end.y[beam] - start.y[beam]
        length[i] = math.sqrt(dx * dx + dy * dy)
        total += length[i]
    most = MOST_OF_MEAN * total / indices.size
    total = 0.0
    for i in range(indices.size):
        total += min(length[i], most)
    every = total / count
    at = 0
    covered = min(length[0], most)
    for i in range(count):
        while at < indices.size - 1 and covered <= (i + phase) * every:
            at += 1
            covered += min(length[at], most)
        out.x[i] = end.x[indices[at]]
        out.y[i] = end.y[indices[at]]
