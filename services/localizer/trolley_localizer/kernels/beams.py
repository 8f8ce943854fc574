"""The beams of one scan: which have an echo, and few of them in place of all."""

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


@kernel
def take_evenly(out: Points, points: Points, indices: NDArray[np.int64], phase: float) -> None:
    """Take some of many points, evenly over them.

    Args:
        out: (k,), overwritten.
        points: (n,) to take from.
        indices: (m,) of those that may be taken, more than k.
        phase: 0 ... 1, shifts the choice between neighbours.
    """
    count = out.x.size
    every = indices.size / count
    for i in range(count):
        chosen = indices[min(int((i + phase) * every), indices.size - 1)]
        out.x[i] = points.x[chosen]
        out.y[i] = points.y[chosen]
