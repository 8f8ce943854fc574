"""Reads a drive that `trolley record` wrote; imported only where one is played."""

from pathlib import Path

import numpy as np

from trolley.geometry import Pose2D
from trolley.messages import Scan, floats_from_bytes
from trolley_base.drivers.interface import DriverError, LidarScan
from trolley_base.recording.recording import Recording


def load_mcap(path: Path) -> Recording:
    """Read scans, odometry and the lidar's pose.

    Raises:
        DriverError: the file cannot be used, or the library that reads it is missing.
    """
    try:
        from trolley.recording.drive import read_drive
        from trolley.recording.reader import BadRecording
    except ImportError as error:
        raise DriverError(f"{path} needs the extra trolley-robot[foxglove]: {error}") from error
    try:
        drive = read_drive(path)
    except BadRecording as error:
        raise DriverError(str(error)) from error
    begin_ns = drive.scans[0].stamp_ns
    odom_ns = [one.stamp_ns - begin_ns for one in drive.odometry]
    rows = [(one.pose.x, one.pose.y, one.pose.yaw) for one in drive.odometry]
    return Recording(
        stamps_ns=np.array([scan.stamp_ns - begin_ns for scan in drive.scans], dtype=np.int64),
        scans=[_lidar_scan(scan, begin_ns) for scan in drive.scans],
        odom_stamps_ns=np.array(odom_ns, dtype=np.int64),
        odom=np.array(rows, dtype=np.float64),
        base_T_laser=drive.base_T_laser or Pose2D.identity(),
        map_T_start=drive.map_T_start,
    )


def _lidar_scan(scan: Scan, begin_ns: int) -> LidarScan:
    return LidarScan(
        stamp_ns=scan.stamp_ns - begin_ns,
        angle_min=scan.angle_min,
        angle_increment=scan.angle_increment,
        time_increment=scan.time_increment,
        range_min=scan.range_min,
        range_max=scan.range_max,
        ranges=floats_from_bytes(scan.ranges),
        intensities=floats_from_bytes(scan.intensities),
    )
