"""The textbook's particle filter in numba, for `speed.py` to compare with.

float64; sine, cosine, distance look-up and exp per beam; numba's own normal generator; particles
drawn one by one until Fox's bound is reached.

Source:
    Thrun, Burgard, Fox, Probabilistic Robotics (2005), tables 5.6, 6.3 and 8.3; Fox, Adapting the
    Sample Size in Particle Filters Through KLD-Sampling (2003), table 1.
"""

import math

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel

Floats = NDArray[np.float64]


@kernel
def move(poses: Floats, step: Floats, alphas: Floats) -> None:
    """Move poses (n, 3) [m, rad] by a step (3,) turn, drive, turn with noise alpha1 ... alpha4."""
    turn, drive, after = step
    turn_dev = math.sqrt(alphas[0] * turn**2 + alphas[1] * drive**2)
    drive_dev = math.sqrt(alphas[2] * drive**2 + alphas[3] * (turn**2 + after**2))
    after_dev = math.sqrt(alphas[0] * after**2 + alphas[1] * drive**2)
    for i in range(poses.shape[0]):
        first = turn - np.random.normal(0.0, turn_dev)  # noqa: NPY002 - the book's way, in numba
        way = drive - np.random.normal(0.0, drive_dev)  # noqa: NPY002
        last = after - np.random.normal(0.0, after_dev)  # noqa: NPY002
        poses[i, 0] += way * math.cos(poses[i, 2] + first)
        poses[i, 1] += way * math.sin(poses[i, 2] + first)
        poses[i, 2] += first + last


@kernel
def weigh(
    out_weights: Floats,
    poses: Floats,
    beams: Floats,
    distance: Floats,
    resolution: float,
    model: Floats,
) -> None:
    """Weigh poses by the likelihood field and make the sum of the weights 1.

    Args:
        out_weights: (n,), overwritten.
        poses: (n, 3) x, y [m], yaw [rad] in the map, whose origin is its corner.
        beams: (m, 2) range [m] and angle [rad] in the robot's frame.
        distance: (rows, cols) to the nearest wall [m].
        resolution: cell edge [m].
        model: (4,) z_hit, z_rand, sigma [m], and the power of a scan's likelihood (beams of one
            scan are not independent).
    """
    rows, cols = distance.shape
    farthest = distance.max()
    total = 0.0
    for i in range(poses.shape[0]):
        likelihood = 1.0
        for j in range(beams.shape[0]):
            x = poses[i, 0] + beams[j, 0] * math.cos(poses[i, 2] + beams[j, 1])
            y = poses[i, 1] + beams[j, 0] * math.sin(poses[i, 2] + beams[j, 1])
            col = math.floor(x / resolution)
            row = math.floor(y / resolution)
            d = farthest
            if 0 <= row < rows and 0 <= col < cols:
                d = distance[row, col]
            likelihood *= model[0] * math.exp(-0.5 * d * d / (model[2] * model[2])) + model[1]
        out_weights[i] = likelihood ** model[3]
        total += out_weights[i]
    for i in range(poses.shape[0]):
        out_weights[i] /= total


@kernel
def resample(
    out_poses: Floats,
    poses: Floats,
    weights: Floats,
    table: NDArray[np.int64],
    error: float,
    quantile: float,
) -> int:
    """Draw poses one by one until there are enough for the bins that they fall into.

    Args:
        out_poses: (n, 3), overwritten; n is the most, and here the least, too, so that every
            update has as many particles.
        poses: (n, 3).
        weights: (n,), sum 1.
        table: scratch for the bins, its length a power of two above 2 n.
        error: of the distribution.
        quantile: of the confidence in that.

    Returns:
        How many particles the bound asks for.
    """
    sums = np.cumsum(weights)
    table[:] = -1
    bins, wanted = 0, 1
    for m in range(out_poses.shape[0]):
        i = min(np.searchsorted(sums, np.random.random()), weights.size - 1)  # noqa: NPY002
        out_poses[m] = poses[i]
        col = math.floor(poses[i, 0] / 0.5)
        row = math.floor(poses[i, 1] / 0.5)
        turn = math.floor(poses[i, 2] / (math.pi / 18.0))
        key = (col * 8191 + row) * 73 + turn
        slot = (key * 40503) & (table.size - 1)
        while table[slot] != -1 and table[slot] != key:
            slot = (slot + 1) & (table.size - 1)
        if table[slot] == -1:
            table[slot] = key
            bins += 1
            if bins > 1:
                a = 2.0 / (9.0 * (bins - 1))
                bound = (1.0 - a + math.sqrt(a) * quantile) ** 3
                wanted = math.ceil((bins - 1) / (2.0 * error) * bound)
    return wanted


@kernel
def estimate(out_mean: Floats, out_covariance: Floats, poses: Floats, weights: Floats) -> None:
    """Write the weighted mean (3,) and the covariance (2, 2) of x, y."""
    out_mean[:] = 0.0
    out_covariance[:] = 0.0
    cos = sin = 0.0
    for i in range(poses.shape[0]):
        out_mean[0] += weights[i] * poses[i, 0]
        out_mean[1] += weights[i] * poses[i, 1]
        cos += weights[i] * math.cos(poses[i, 2])
        sin += weights[i] * math.sin(poses[i, 2])
    out_mean[2] = math.atan2(sin, cos)
    for i in range(poses.shape[0]):
        for a in range(2):
            for b in range(2):
                out_covariance[a, b] += (
                    weights[i] * (poses[i, a] - out_mean[a]) * (poses[i, b] - out_mean[b])
                )
