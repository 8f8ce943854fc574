"""Two scans of a robot that stands, beam by beam."""

import math

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel


@kernel
def count_same(
    first: NDArray[np.float32], ranges: NDArray[np.float32], same_m: float, same_share: float
) -> tuple[int, int, int]:
    """Count the echoes of two scans, and those that are at the same distance.

    Args:
        first: (n,) ranges [m]; NaN, infinite, zero and negative ones are no echo.
        ranges: (n,) of the later scan.
        same_m: difference within which an echo is the same [m].
        same_share: share of its range that adds to it.

    Returns:
        The echoes of the scan that has more, those that both have, and the same among these.
    """
    num_first = 0
    num_later = 0
    both = 0
    num_same = 0
    for i in range(first.size):
        had = math.isfinite(first[i]) and first[i] > 0.0
        has = math.isfinite(ranges[i]) and ranges[i] > 0.0
        num_first += had
        num_later += has
        if had and has:
            both += 1
            slack = np.float32(same_m) + np.float32(same_share) * first[i]
            num_same += abs(ranges[i] - first[i]) <= slack
    return max(num_first, num_later), both, num_same
