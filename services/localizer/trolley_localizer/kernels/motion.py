"""Move particles by odometry with noise, and scatter them."""

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel
from trolley_localizer.kernels.elementary import sin_cos
from trolley_localizer.kernels.layout import Cloud
from trolley_localizer.kernels.random import normal

_ONE = np.uint64(1)
_TWO = np.uint64(2)
_THREE = np.uint64(3)
_FOUR = np.uint64(4)


@kernel
def move_particles(
    cloud: Cloud,
    step: NDArray[np.float64],
    deviation: NDArray[np.float64],
    wide_every: int,
    wide_factor: float,
    counter: np.uint64,
) -> None:
    """Move each particle by a noisy copy of one odometry step, in place.

    Args:
        cloud: the particles.
        step: (3,) turn [rad], drive [cells], turn [rad].
        deviation: (4,) standard deviation of the three parts and of a slip to the left [cells].
        wide_every: one particle in so many gets `wide_factor` times the noise.
        wide_factor: see `wide_every`.
        counter: first random number; four are used for each particle.

    Source:
        Thrun, Burgard, Fox, Probabilistic Robotics (2005), table 5.6.
    """
    turn, drive, after = step[0], step[1], step[2]
    turn_dev, drive_dev, after_dev, slip_dev = (
        deviation[0],
        deviation[1],
        deviation[2],
        deviation[3],
    )
    for i in range(cloud.x.size):
        number = counter + _FOUR * np.uint64(i)
        share = i / wide_every
        scale = wide_factor if share == np.floor(share) else 1.0
        heading = cloud.yaw[i] + turn + scale * turn_dev * normal(number)
        way = drive + scale * drive_dev * normal(number + _ONE)
        slip = scale * slip_dev * normal(number + _THREE)
        sin, cos = sin_cos(heading)
        cloud.x[i] += way * cos - slip * sin
        cloud.y[i] += way * sin + slip * cos
        cloud.yaw[i] = heading + after + scale * after_dev * normal(number + _TWO)


@kernel
def scatter_particles(
    cloud: Cloud,
    first: int,
    every: int,
    mean: NDArray[np.float64],
    root: NDArray[np.float64],
    counter: np.uint64,
) -> None:
    """Draw particles from a normal distribution.

    Args:
        cloud: the particles `first`, `first + every` and so on are overwritten.
        first: index of the first.
        every: one particle in so many is drawn.
        mean: (3,) x, y [cells], yaw [rad] in `grid`.
        root: (3, 3) lower Cholesky factor of the covariance, same units.
        counter: first random number; three are used for each particle drawn.
    """
    for i in range(first, cloud.x.size, every):
        a = normal(counter)
        b = normal(counter + _ONE)
        c = normal(counter + _TWO)
        counter += _THREE
        cloud.x[i] = mean[0] + root[0, 0] * a
        cloud.y[i] = mean[1] + root[1, 0] * a + root[1, 1] * b
        cloud.yaw[i] = mean[2] + root[2, 0] * a + root[2, 1] * b + root[2, 2] * c
