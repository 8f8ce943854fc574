"""What remains wrong with an odometry, as it is estimated: along, turning, and bending."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley_base.odometry.wheel_scales import WheelScales


@dataclass(frozen=True, slots=True)
class Correction:
    """How the motions of `odom` become true ones.

    Attributes:
        linear: true metres per metre.
        angular: true radians per radian.
        bend: radians that it turns unnoticed per metre, by unequal wheels [rad/m].
    """

    linear: float = 1.0
    angular: float = 1.0
    bend: float = 0.0

    def integrate(self, steps: NDArray[np.float64]) -> Pose2D:
        """Return the corrected motion start_T_end along small arcs.

        Args:
            steps: (n, 3) x, y [m], turn [rad] of each arc, as `log_pose` gives them.
        """
        along, across = self.linear * steps[:, 0], steps[:, 1]
        turns = self.angular * steps[:, 2] + self.bend * steps[:, 0]
        half = 0.5 * turns
        # The chord of an arc points half its turn aside, and is shorter by sin(t/2) / (t/2).
        shorter = np.sinc(half / np.pi)
        heading = np.cumsum(turns) - half
        cos, sin = np.cos(heading), np.sin(heading)
        return Pose2D(
            float(np.sum(shorter * (cos * along - sin * across))),
            float(np.sum(shorter * (sin * along + cos * across))),
            float(np.sum(turns)),
        ).wrapped()


def combined(found: Correction, in_force: WheelScales) -> WheelScales:
    """Return the scales that replace those in force.

    `odom` is corrected by those in force already, so the product of both is what is needed. What
    a turn moves the robot along, by unequal wheels, is half a track times the bend: of the second
    order, and follows from the rest.

    Raises:
        ValueError: it bends, and there is no track to express that as a ratio of the wheels.
    """
    before = in_force.matrix
    linear = found.linear * float(before[0, 0])
    angular = found.angular * float(before[1, 1]) + found.bend * float(before[0, 1])
    bend = found.angular * float(before[1, 0]) + found.bend * float(before[0, 0])
    ratio = 1.0
    if bend != 0.0:
        if in_force.track_m is None:
            raise ValueError("the track that the board assumes is not known")
        uneven = 0.5 * in_force.track_m * bend / angular
        ratio = (1.0 + uneven) / (1.0 - uneven)
    return WheelScales(linear, in_force.sideways, angular, ratio, in_force.track_m)
