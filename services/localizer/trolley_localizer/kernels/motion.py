"""Move particles by odometry with noise, and scatter them."""

import math

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel
from trolley_localizer.kernels.layout import Cloud
from trolley_localizer.kernels.random import normal

_ONE = np.uint64(1)


@kernel
def move_particles(
    cloud: Cloud,
    step: NDArray[np.float32],
    deviation: NDArray[np.float32],
    wide_every: int,
    wide_factor: np.float32,
    counter: np.uint64,
) -> None:
    """Move each particle by a noisy copy of one odometry step, in place.

    Args:
        cloud: the particles.
        step: (3,) turn [rad], drive [cells], turn [rad].
        deviation: (4,) standard deviation of the three parts and of a slip to the left [cells].
        wide_every: one particle in so many gets `wide_factor` times the noise; 0 = none.
        wide_factor: see `wide_every`.
        counter: first random number; four are used for each particle.

    Source:
        Thrun, Burgard, Fox, Probabilistic Robotics (2005), table 5.6.
    """
    for i in range(cloud.x.size):
        scale = np.float32(1.0)
        if wide_every > 0 and i % wide_every == 0:
            scale = wide_factor
        turn = step[0] + scale * deviation[0] * normal(counter)
        drive = step[1] + scale * deviation[1] * normal(counter + _ONE)
        after = step[2] + scale * deviation[2] * normal(counter + _ONE + _ONE)
        slip = scale * deviation[3] * normal(counter + _ONE + _ONE + _ONE)
        counter += np.uint64(4)
        heading = cloud.yaw[i] + turn
        cos = np.float32(math.cos(heading))
        sin = np.float32(math.sin(heading))
        cloud.x[i] += drive * cos - slip * sin
        cloud.y[i] += drive * sin + slip * cos
        cloud.yaw[i] = heading + after


@kernel
def scatter_particles(
    cloud: Cloud,
    first: int,
    count: int,
    mean: NDArray[np.float64],
    root: NDArray[np.float64],
    counter: np.uint64,
) -> None:
    """Draw particles from a normal distribution.

    Args:
        cloud: particles `first` to `first + count` are overwritten.
        first: index of the first.
        count: how many.
        mean: (3,) x, y [cells], yaw [rad] in `grid`.
        root: (3, 3) lower Cholesky factor of the covariance, same units.
        counter: first random number; three are used for each particle.
    """
    for i in range(first, first + count):
        a = np.float64(normal(counter))
        b = np.float64(normal(counter + _ONE))
        c = np.float64(normal(counter + _ONE + _ONE))
        counter += np.uint64(3)
        cloud.x[i] = mean[0] + root[0, 0] * a
        cloud.y[i] = mean[1] + root[1, 0] * a + root[1, 1] * b
        cloud.yaw[i] = mean[2] + root[2, 0] * a + root[2, 1] * b + root[2, 2] * c
