"""Compiles what odometry by the lidar calls, by following two scans of a room."""

import numpy as np

from trolley.geometry import Pose2D
from trolley_base.drivers import LidarScan
from trolley_base.odometry.lidar_odometry import LidarOdometry

BEAMS = 120


def warm_up() -> None:
    """Compile everything that a scan calls."""
    odometry = LidarOdometry(Pose2D.identity(), 0, has_wheels=False, has_axle=True)
    increment = 2.0 * np.pi / BEAMS
    angles = increment * np.arange(BEAMS)
    ranges = np.minimum(2.0 / np.abs(np.cos(angles)), 1.5 / np.maximum(np.abs(np.sin(angles)), 0.1))
    for number in (1, 2):
        scan = LidarScan(
            number * 100_000_000, 0.0, increment, 0.0, 0.05, 12.0, ranges.astype(np.float32)
        )
        odometry.update(scan, None)
