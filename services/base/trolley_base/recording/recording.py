"""A recorded drive in memory, whatever file it came from."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley_base.drivers.interface import LidarScan


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """A recorded drive; all times are since the first scan.

    Attributes:
        stamps_ns: (n,) int64, time of each scan; strictly increasing.
        scans: (n,) what was seen.
        odom_stamps_ns: (m,) int64, strictly increasing, the first at most 0.
        odom: (m, 3) x, y [m], yaw [rad], not wrapped to anything.
        base_T_laser: where the sensor sits.
        map_T_start: where the robot stood at the first scan, None if the file does not say.
    """

    stamps_ns: NDArray[np.int64]
    scans: Sequence[LidarScan]
    odom_stamps_ns: NDArray[np.int64]
    odom: NDArray[np.float64]
    base_T_laser: Pose2D
    map_T_start: Pose2D | None
