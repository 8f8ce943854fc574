"""Whether a lidar repeats one scan while the robot moves on: it hangs, and sees nothing any more.

Two scans of a real lidar never agree to the last digit, and from two places not even ideal ones do.
"""

import math
from dataclasses import dataclass

import numpy as np

from trolley.geometry import Pose2D, angle_difference
from trolley_base.drivers import LidarScan


@dataclass(frozen=True, slots=True)
class FrozenLidarParams:
    """When scans count as one and the same; set by hand."""

    same_share: float = 0.98
    """Of the beams that met something, this share measures the same to the last digit ..."""
    least_beams: int = 20
    """... and there are at least so many: where nothing is in reach, all scans are alike."""
    moved_m: float = 0.05
    """The robot has driven farther than this meanwhile [m] ..."""
    turned_rad: float = 0.05
    """... or turned farther than this [rad]."""


PARAMS = FrozenLidarParams()


class FrozenLidar:
    """Compares each scan with the first of those that are the same."""

    def __init__(self) -> None:
        self._ranges = np.empty(0, np.float32)
        self._odom_T_base = Pose2D.identity()

    def update(self, scan: LidarScan, odom_T_base: Pose2D) -> bool:
        """Take a new scan, and say whether the lidar repeats itself although the robot moved."""
        if not self._is_same(scan):
            self._ranges, self._odom_T_base = scan.ranges, odom_T_base
            return False
        before = self._odom_T_base
        turned = abs(angle_difference(odom_T_base.yaw, before.yaw))
        return before.distance_to(odom_T_base) > PARAMS.moved_m or turned > PARAMS.turned_rad

    def _is_same(self, scan: LidarScan) -> bool:
        before, now = self._ranges, scan.ranges
        if len(before) != len(now):
            return False
        met = (now > 0.0) & (now < math.inf)
        count = int(np.count_nonzero(met))
        same = int(np.count_nonzero(met & (before == now)))
        return count >= PARAMS.least_beams and same >= PARAMS.same_share * count
