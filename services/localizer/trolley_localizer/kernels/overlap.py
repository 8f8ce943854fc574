"""Compare two scans with each other: does one see free floor where the other sees something?"""

import math

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel
from trolley.scanning import Points


@kernel
def draw_view(
    out_near: NDArray[np.float64],
    out_far: NDArray[np.float64],
    ends: Points,
    laser: NDArray[np.float64],
) -> None:
    """Write how near and how far the echoes lie in each direction.

    Args:
        out_near: (bins,) of a full turn, overwritten; infinite without an echo [cells].
        out_far: (bins,), overwritten; negative without an echo [cells].
        ends: (n,) echoes in `base_link` [cells].
        laser: (2,) where the laser was in `base_link` [cells].
    """
    out_near[:] = np.inf
    out_far[:] = -1.0
    for j in range(ends.x.size):
        x, y = ends.x[j] - laser[0], ends.y[j] - laser[1]
        away = math.hypot(x, y)
        k = direction_bin(x, y, out_near.size)
        out_near[k] = min(out_near[k], away)
        out_far[k] = max(out_far[k], away)


@kernel
def direction_bin(x: float, y: float, bins: int) -> int:
    """Return the bin of a full turn in which a direction lies."""
    share = math.atan2(y, x) / (2.0 * math.pi) + 0.5
    return min(int(share * bins), bins - 1)


@kernel
def compare_with_view(
    near: NDArray[np.float64],
    far: NDArray[np.float64],
    laser: NDArray[np.float64],
    ends: Points,
    relation: NDArray[np.float64],
    reach: int,
    slack: NDArray[np.float64],
) -> tuple[int, int]:
    """Count the echoes that a view agrees with, and those that lie where it saw through.

    What lies behind the echoes of the view, or where it has none, counts neither way.

    Args:
        near: (bins,) see `draw_view`; `far` alike.
        far: see `near`.
        laser: (2,) where the laser of the view was [cells].
        ends: (n,) echoes of the other scan in its `base_link` [cells].
        relation: (3,) pose of the other scan in the `base_link` of the view [cells, rad].
        reach: directions that differ by so many bins are the same.
        slack: (2,) by how much distances may differ [cells], and by what share.

    Returns:
        How many agree, and how many do not.
    """
    cos = math.cos(relation[2])
    sin = math.sin(relation[2])
    bins = near.size
    agree = 0
    conflict = 0
    for j in range(ends.x.size):
        x = relation[0] + cos * ends.x[j] - sin * ends.y[j] - laser[0]
        y = relation[1] + sin * ends.x[j] + cos * ends.y[j] - laser[1]
        away = math.hypot(x, y)
        middle = direction_bin(x, y, bins)
        nearest = np.inf
        farthest = -1.0
        for k in range(middle - reach, middle + reach + 1):
            at = k % bins
            nearest = min(nearest, near[at])
            farthest = max(farthest, far[at])
        if farthest < 0.0:
            continue
        allowed = slack[0] + slack[1] * away
        if away < nearest - allowed:
            conflict += 1
        elif away <= farthest + allowed:
            agree += 1
    return agree, conflict
