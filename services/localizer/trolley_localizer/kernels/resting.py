"""Two scans of a robot that stands, beam by beam; no two turns of a lidar have the same beams."""

import math

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel


@kernel
def is_echo(range_m: float) -> bool:
    """Whether a beam met something."""
    return math.isfinite(range_m) and range_m > 0.0


@kernel
def count_same(
    first: NDArray[np.float32],
    ranges: NDArray[np.float32],
    begin: float,
    step: float,
    same_m: float,
    same_share: float,
) -> tuple[int, int, int]:
    """Count the echoes of two scans, and those that are at the same distance.

    Args:
        first: (n,) ranges [m]; NaN, infinite, zero and negative ones are no echo.
        ranges: (m,) of the later scan. Each is compared with the beam of `first` that looked
            nearest to where it looks.
        begin: where its beam 0 looks, in beams of `first`.
        step: from there to where its next one looks, in beams of `first`.
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
        num_first += is_echo(first[i])
    for i in range(ranges.size):
        if not is_echo(ranges[i]):
            continue
        num_later += 1
        nearest = begin + step * i + 0.5
        if not 0.0 <= nearest < first.size:
            continue
        before = first[int(nearest)]
        if is_echo(before):
            both += 1
            slack = np.float32(same_m) + np.float32(same_share) * before
            num_same += abs(ranges[i] - before) <= slack
    return max(num_first, num_later), both, num_same
