"""How far odometry may be off after a step."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class MotionModelParams:
    """Standard deviations of odometry.

    The model follows Thrun, Burgard, Fox, Probabilistic Robotics (2005), section 5.4; the values
    were found with bench/mapper/.
    """

    still_m: float = 0.01
    """Deviation of the position, whatever the odometry says [m]."""
    still_rad: float = 0.01
    """Deviation of the heading, whatever the odometry says [rad]."""
    distance_share: float = 0.12
    """Deviation of the position, as a share of the distance driven (alpha3)."""
    turn_share: float = 0.12
    """Deviation of the heading, as a share of the turn (alpha1)."""
    turn_rad_per_m: float = 0.04
    """Deviation of the heading for each metre driven [rad/m] (alpha2)."""


PARAMS = MotionModelParams()


def motion_covariance(
    distance_m: float, turn_rad: float, distance_share: float = PARAMS.distance_share
) -> NDArray[np.float64]:
    """Return the covariance (3, 3) of an odometry step, the same in all directions.

    Args:
        distance_m: driven.
        turn_rad: turned.
        distance_share: deviation of the position, as a share of the distance.
    """
    dev_m = PARAMS.still_m + distance_share * distance_m
    dev_rad = PARAMS.still_rad + PARAMS.turn_share * turn_rad + PARAMS.turn_rad_per_m * distance_m
    return np.diag([dev_m**2, dev_m**2, dev_rad**2])
