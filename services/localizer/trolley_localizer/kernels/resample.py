"""Turn weights into a new, equally weighted set of particles."""

import math

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel
from trolley_localizer.kernels.layout import Cloud
from trolley_localizer.kernels.random import random_bits

_TWO_PI = 2.0 * math.pi
_EMPTY = np.uint64(0)
_ONE = np.uint64(1)


@kernel
def normalise_weights(
    weights: NDArray[np.float32], score: NDArray[np.float32], gain: float
) -> float:
    """Multiply weights by exp(gain * score), make their sum 1, and return the effective number.

    Args:
        weights: (n,), in place.
        score: (n,) sum of table values of each particle.
        gain: from the sum of table values to log likelihood.

    Returns:
        1 / sum of squared weights; n for equal weights.
    """
    best = np.float32(0.0)
    for i in range(score.size):
        best = max(best, score[i])
    total = 0.0
    for i in range(score.size):
        weight = weights[i] * math.exp(gain * (np.float64(score[i]) - best))
        weights[i] = weight
        total += weight
    if not total > 1e-30:
        # The old weights and the new evidence exclude each other: start from the evidence.
        total = 0.0
        for i in range(score.size):
            weight = math.exp(gain * (np.float64(score[i]) - best))
            weights[i] = weight
            total += weight
    squares = 0.0
    for i in range(score.size):
        weight = weights[i] / total
        weights[i] = weight
        squares += weight * weight
    return 1.0 / squares


@kernel
def draw_systematic(
    out_index: NDArray[np.int32], weights: NDArray[np.float32], offset: float
) -> None:
    """Choose particles in proportion to their weight, with one random number for all.

    Args:
        out_index: (m,), overwritten: which particle each new one copies.
        weights: (n,), sum 1.
        offset: in [0, 1).

    Source:
        Thrun, Burgard, Fox, Probabilistic Robotics (2005), table 4.4.
    """
    count = out_index.size
    i = 0
    reached = np.float64(weights[0])
    for m in range(count):
        wanted = (m + offset) / count
        while reached < wanted and i < weights.size - 1:
            i += 1
            reached += weights[i]
        out_index[m] = i


@kernel
def gather(out: Cloud, cloud: Cloud, index: NDArray[np.int32]) -> None:
    """Copy the chosen particles."""
    for m in range(index.size):
        i = index[m]
        out.x[m] = cloud.x[i]
        out.y[m] = cloud.y[i]
        out.yaw[m] = cloud.yaw[i]


@kernel
def count_bins(
    table: NDArray[np.uint64],
    cloud: Cloud,
    index: NDArray[np.int32],
    bin_cells: float,
    bins_turn: int,
) -> int:
    """Count the bins of pose space that the chosen particles lie in.

    Args:
        table: scratch, its length a power of two above the number of particles; overwritten.
        cloud: the particles.
        index: (m,) which of them were chosen, equal ones next to each other.
        bin_cells: edge of a bin along x and y [cells].
        bins_turn: bins that a full turn is cut into.
    """
    table[:] = _EMPTY
    mask = np.uint64(table.size - 1)
    count = 0
    before = -1
    for m in range(index.size):
        i = index[m]
        if i == before:
            continue
        before = i
        share = cloud.yaw[i] / _TWO_PI
        turn = int((share - math.floor(share)) * bins_turn)
        col = math.floor(cloud.x[i] / bin_cells) + 1048576
        row = math.floor(cloud.y[i] / bin_cells) + 1048576
        key = (
            (np.uint64(turn) * np.uint64(2097152) + np.uint64(row)) * np.uint64(2097152)
            + np.uint64(col)
            + _ONE
        )
        slot = random_bits(key) & mask
        while table[slot] != _EMPTY and table[slot] != key:
            slot = (slot + _ONE) & mask
        if table[slot] == _EMPTY:
            table[slot] = key
            count += 1
    return count


@kernel
def weighted_moments(
    out_mean: NDArray[np.float64],
    out_covariance: NDArray[np.float64],
    cloud: Cloud,
    weights: NDArray[np.float32],
    centre: NDArray[np.float64],
    reach: NDArray[np.float64],
) -> float:
    """Compute mean and covariance of the particles about a pose.

    Args:
        out_mean: (3,) x, y [cells], yaw [rad] in `grid`, overwritten.
        out_covariance: (3, 3), same units, overwritten.
        cloud: the particles.
        weights: (n,), sum 1.
        centre: (3,) only particles within `reach` of it count; headings are unwrapped about it.
        reach: (2,) distance [cells] and angle [rad].

    Returns:
        The weight of the particles that counted; with zero, the mean is `centre`.
    """
    share = 0.0
    first = np.zeros(3)
    second = np.zeros((3, 3))
    delta = np.zeros(3)
    for i in range(cloud.x.size):
        delta[0] = cloud.x[i] - centre[0]
        delta[1] = cloud.y[i] - centre[1]
        turn = cloud.yaw[i] - centre[2]
        delta[2] = turn - _TWO_PI * math.floor(turn / _TWO_PI + 0.5)
        if math.hypot(delta[0], delta[1]) > reach[0] or abs(delta[2]) > reach[1]:
            continue
        weight = np.float64(weights[i])
        share += weight
        for a in range(3):
            first[a] += weight * delta[a]
            for b in range(a + 1):
                second[a, b] += weight * delta[a] * delta[b]
    for a in range(3):
        out_mean[a] = centre[a]
        if share > 0.0:
            out_mean[a] += first[a] / share
    for a in range(3):
        for b in range(a + 1):
            value = 0.0
            if share > 0.0:
                value = second[a, b] / share - first[a] * first[b] / (share * share)
            out_covariance[a, b] = value
            out_covariance[b, a] = value
    return share
