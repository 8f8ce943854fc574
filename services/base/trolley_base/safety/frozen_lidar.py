"""Whether a lidar repeats one scan while the robot moves on: it hangs, and sees nothing any more.

Two scans of a real lidar never agree to the last digit, and from two places not even ideal ones do.
"""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from trolley.geometry import Pose2D, angle_difference
from trolley_base.drivers import LidarScan


@dataclass(frozen=True, slots=True)
class FrozenLidarParams:
    """When scans count as one and the same; set by hand."""

    same_share: float = 0.98
    """Share of the beams with an echo that must measure the same to the last digit."""
    least_beams: int = 20
    """Number of such beams below which nothing is concluded: where nothing is in reach, all scans
    are alike."""
    moved_m: float = 0.05
    """Distance that the robot must have driven meanwhile [m]."""
    turned_rad: float = 0.05
    """Turn that does instead of `moved_m` [rad]."""
    most_repeated: int = 3
    """Number of repetitions in a row that a lidar is allowed which alone says how the robot moves.
    """
    kept: int = 4
    """Number of scans that are compared: what is repeated may be cut into revolutions in turn here
    and there."""


PARAMS = FrozenLidarParams()


class FrozenLidar:
    """Compares each scan with the last that differ from each other.

    Args:
        knows_motion: something else than the lidar says how the robot moves; else a scan that is
            repeated once too often is enough.
    """

    def __init__(self, *, knows_motion: bool = True) -> None:
        self._knows_motion = knows_motion
        self._repeated = 0
        self._seen: deque[tuple[LidarScan, Pose2D]] = deque(maxlen=PARAMS.kept)

    def update(self, scan: LidarScan, odom_T_base: Pose2D) -> bool:
        """Take a new scan, and say whether the lidar repeats itself although the robot moved."""
        for before, there in self._seen:
            if _are_same(before, scan):
                self._repeated += 1
                if not self._knows_motion:
                    return self._repeated > PARAMS.most_repeated
                turned = abs(angle_difference(odom_T_base.yaw, there.yaw))
                moved_m = there.distance_to(odom_T_base)
                return moved_m > PARAMS.moved_m or turned > PARAMS.turned_rad
        self._repeated = 0
        self._seen.append((scan, odom_T_base))
        return False


def _are_same(before: LidarScan, now: LidarScan) -> bool:
    if len(before.ranges) != len(now.ranges):
        return False
    met = (now.ranges > 0.0) & (now.ranges < math.inf)
    count = int(np.count_nonzero(met))
    same = int(np.count_nonzero(met & (before.ranges == now.ranges)))
    return count >= PARAMS.least_beams and same >= PARAMS.same_share * count
