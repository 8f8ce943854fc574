"""Where a robot can be that came back from off the map: around where it was led without it."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley_localizer.filter.pose_estimator import AlignedPose


@dataclass(frozen=True, slots=True)
class ReachParams:
    """How far off the robot may be from its estimate; set by hand."""

    devs: float = 3.0
    """Number of standard deviations within which a place is in reach."""
    more_m: float = 0.5
    """Distance beyond them within which a place is in reach [m]."""
    more_rad: float = 0.3
    """Turn beyond them within which a place is in reach [rad]."""
    lasts_m: float = 5.0
    """Distance on the map without a place within reach after which the robot may be anywhere [m].
    """


PARAMS = ReachParams()


class Reach:
    """Where a robot can be that no one has carried off: around where it was led without the map.

    Args:
        led: the pose, and how far off it may be.
    """

    def __init__(self, led: AlignedPose) -> None:
        self._led = led
        self._left_m = PARAMS.lasts_m

    def predict(self, step: Pose2D) -> None:
        """Note an odometry step [m, m, rad]."""
        self._led.predict(step)
        self._left_m -= math.hypot(step.x, step.y)

    @property
    def pose(self) -> NDArray[np.float64]:
        """The middle of it (3,) x, y [cells], yaw [rad]."""
        return self._led.pose

    @property
    def is_over(self) -> bool:
        """Whether it has led to no place for too long."""
        return self._left_m < 0.0

    def holds(self, pose: NDArray[np.float64], resolution: float) -> bool:
        """Say whether the robot can be at a pose (3,) x, y [cells], yaw [rad]."""
        shift, covariance = pose - self._led.pose, self._led.covariance
        across = math.sqrt(float(np.linalg.eigvalsh(covariance[:2, :2])[-1]))
        around = math.sqrt(float(covariance[2, 2]))
        away_m = (math.hypot(shift[0], shift[1]) - PARAMS.devs * across) * resolution
        turned = abs(math.remainder(float(shift[2]), 2.0 * math.pi)) - PARAMS.devs * around
        return away_m <= PARAMS.more_m and turned <= PARAMS.more_rad
