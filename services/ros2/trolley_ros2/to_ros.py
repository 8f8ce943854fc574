"""Trolley's messages as ROS 2's. Frames and units are the same (REP-103, REP-105)."""

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from trolley.geometry import Pose2D
from trolley.messages import (
    OccupancyGrid,
    Odometry,
    Path,
    PoseEstimate,
    Scan,
    Transform,
    floats_from_bytes,
)
from trolley_ros2 import cdr

LAST_SECOND = 2**31 - 1
"""The latest second that a stamp can say."""
KNOWN_STATES = ("localized", "unsure", "mapping")
"""States in which the pose is the robot's, as far as it knows."""
_PLANAR = (0, 1, 5)
"""Rows and columns of x, y and yaw in a covariance of x, y, z, roll, pitch, yaw."""


def laser_scan(scan: Scan, stamp_ns: int) -> Any:
    """A scan: no echo stays +inf, what is invalid becomes NaN (REP-117)."""
    ranges = floats_from_bytes(scan.ranges).copy()
    with np.errstate(invalid="ignore"):  # whatever bytes a stranger sends
        ranges[~(ranges > 0.0)] = np.nan
    last = max(0, len(ranges) - 1)
    return cdr.make(
        cdr.LASER_SCAN,
        _header(stamp_ns, scan.frame),
        scan.angle_min,
        scan.angle_min + last * scan.angle_increment,
        scan.angle_increment,
        scan.time_increment,
        abs(scan.time_increment) * len(ranges),
        scan.range_min,
        scan.range_max,
        ranges,
        floats_from_bytes(scan.intensities),
    )


def odometry(message: Odometry, stamp_ns: int) -> Any:
    """Where the wheels say it is; how certain that is, is not known: all zeros."""
    unknown = np.zeros(36)
    twist = cdr.make(
        "geometry_msgs/msg/Twist",
        _vector(message.twist.vx, message.twist.vy, 0.0),
        _vector(0.0, 0.0, message.twist.wz),
    )
    return cdr.make(
        cdr.ODOMETRY,
        _header(stamp_ns, "odom"),
        "base_link",
        cdr.make("geometry_msgs/msg/PoseWithCovariance", _pose(message.pose), unknown),
        cdr.make("geometry_msgs/msg/TwistWithCovariance", twist, unknown),
    )


def transforms(several: Iterable[tuple[Transform, int]]) -> Any:
    """Frames in frames, each with its stamp [ns since 1970]."""
    return cdr.make(cdr.TF_MESSAGE, [_transform(one, stamp_ns) for one, stamp_ns in several])


def base_in_odom(message: Odometry) -> Transform:
    """Odometry as the transform that it is."""
    return Transform(stamp_ns=message.stamp_ns, parent="odom", child="base_link", pose=message.pose)


def grid(cells: OccupancyGrid, stamp_ns: int) -> Any:
    """A map, or a costmap as Nav2 publishes one: 0 free to 100, -1 unknown."""
    info = cdr.make(
        "nav_msgs/msg/MapMetaData",
        _time(stamp_ns),
        cells.resolution,
        cells.width,
        cells.height,
        _pose(cells.origin),
    )
    values = np.frombuffer(cells.cells, dtype=np.int8)
    return cdr.make(cdr.OCCUPANCY_GRID, _header(stamp_ns, cells.frame), info, values)


def pose(estimate: PoseEstimate, stamp_ns: int) -> Any | None:
    """Where the robot is, as AMCL publishes it; None while it does not know."""
    if estimate.pose is None or estimate.covariance is None or estimate.state not in KNOWN_STATES:
        return None
    covariance = np.zeros((6, 6))
    covariance[np.ix_(_PLANAR, _PLANAR)] = np.reshape(estimate.covariance, (3, 3))
    return cdr.make(
        cdr.POSE_WITH_COVARIANCE,
        _header(stamp_ns, "map"),
        cdr.make("geometry_msgs/msg/PoseWithCovariance", _pose(estimate.pose), covariance.ravel()),
    )


def path(line: Path, stamp_ns: int) -> Any:
    """A path; none is an empty one."""
    rows: list[list[float]] = floats_from_bytes(line.poses, 3).tolist()
    header = _header(stamp_ns, line.frame)
    poses = [cdr.make(cdr.POSE, header, _pose(Pose2D(*row))) for row in rows]
    return cdr.make(cdr.PATH, header, poses)


def _transform(message: Transform, stamp_ns: int) -> Any:
    at = message.pose
    return cdr.make(
        "geometry_msgs/msg/TransformStamped",
        _header(stamp_ns, message.parent),
        message.child,
        cdr.make(
            "geometry_msgs/msg/Transform", _vector(at.x, at.y, message.z), _quaternion(at.yaw)
        ),
    )


def _pose(at: Pose2D) -> Any:
    position = cdr.make("geometry_msgs/msg/Point", at.x, at.y, 0.0)
    return cdr.make("geometry_msgs/msg/Pose", position, _quaternion(at.yaw))


def _quaternion(yaw: float) -> Any:
    half = 0.5 * yaw if math.isfinite(yaw) else math.nan
    return cdr.make("geometry_msgs/msg/Quaternion", 0.0, 0.0, math.sin(half), math.cos(half))


def _vector(x: float, y: float, z: float) -> Any:
    return cdr.make("geometry_msgs/msg/Vector3", x, y, z)


def _header(stamp_ns: int, frame: str) -> Any:
    return cdr.make("std_msgs/msg/Header", _time(stamp_ns), frame)


def _time(stamp_ns: int) -> Any:
    seconds, rest_ns = divmod(max(0, stamp_ns), 1_000_000_000)
    return cdr.make("builtin_interfaces/msg/Time", min(seconds, LAST_SECOND), rest_ns)
