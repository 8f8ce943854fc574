"""Compare two scans with each other: does one see free floor where the other sees something?"""

import math

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel
from trolley.scanning import Points
from trolley_localizer.kernels.elementary import angle_of

_TURNS = 0.5 / math.pi


@kernel
def draw_view(
    out_near: NDArray[np.float64],
    out_far: NDArray[np.float64],
    ends: Points,
    laser: NDArray[np.float64],
    reach: int,
) -> None:
    """Write how near and how far the echoes lie in each direction and those beside it.

    Args:
        out_near: (bins,) of a full turn, overwritten; infinite without an echo [cells].
        out_far: (bins,), overwritten; negative without an echo [cells].
        ends: (n,) echoes in `base_link` [cells].
        laser: (2,) where the laser was in `base_link` [cells].
        reach: directions that differ by so many bins are the same.
    """
    bins = out_near.size
    near = np.full(bins + 2 * reach, np.inf)
    far = np.full(bins + 2 * reach, -1.0)
    for j in range(ends.x.size):
        x, y = ends.x[j] - laser[0], ends.y[j] - laser[1]
        away = math.sqrt(x * x + y * y)
        k = direction_bin(x, y, bins) + reach
        near[k] = min(near[k], away)
        far[k] = max(far[k], away)
    for k in range(reach):  # the turn goes on at either end
        near[k], far[k] = near[bins + k], far[bins + k]
        near[bins + reach + k], far[bins + reach + k] = near[reach + k], far[reach + k]
    out_near[:] = near[:bins]
    out_far[:] = far[:bins]
    for shift in range(1, 2 * reach + 1):
        for k in range(bins):
            out_near[k] = min(out_near[k], near[k + shift])
            out_far[k] = max(out_far[k], far[k + shift])


@kernel
def direction_bin(x: float, y: float, bins: int) -> int:
    """Return the bin of a full turn in which a direction lies."""
    return min(int((angle_of(x, y) * _TURNS + 0.5) * bins), bins - 1)


@kernel
def compare_with_view(
    near: NDArray[np.float64],
    far: NDArray[np.float64],
    laser: NDArray[np.float64],
    ends: Points,
    relation: NDArray[np.float64],
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
        away = math.sqrt(x * x + y * y)
        k = direction_bin(x, y, bins)
        allowed = slack[0] + slack[1] * away
        is_seen = far[k] >= 0.0
        is_nearer = away < near[k] - allowed
        conflict += int(is_seen & is_nearer)
        agree += int(is_seen & (not is_nearer) & (away <= far[k] + allowed))
    return agree, conflict
