"""Measurements, maps and poses as Foxglove's messages; `views` says what goes where."""

import math

import numpy as np
from foxglove import messages as fox

from trolley.geometry import Pose2D
from trolley.messages import (
    OccupancyGrid,
    Odometry,
    ParticleCloud,
    Path,
    PoseEstimate,
    Scan,
    Transform,
    floats_from_bytes,
)

LAST_SECOND = 2**32 - 1
"""The latest second that Foxglove's timestamps can say."""
_FLOAT_BYTES = 4
_PARTICLE_FIELDS = ("x", "y", "z", "weight")


def frame_name(robot: str, frame: str) -> str:
    """A frame of a robot."""
    return f"{robot}/{frame.lstrip('/')}"


def timestamp(stamp_ns: int) -> fox.Timestamp:
    """A stamp."""
    seconds, rest_ns = divmod(stamp_ns, 1_000_000_000)
    return fox.Timestamp(sec=min(seconds, LAST_SECOND), nsec=rest_ns)


def rotation(yaw: float) -> fox.Quaternion:
    """A heading."""
    return fox.Quaternion(z=math.sin(0.5 * yaw), w=math.cos(0.5 * yaw))


def pose_message(pose: Pose2D, z: float = 0.0) -> fox.Pose:
    """A pose in the plane, `z` [m] above it."""
    position = fox.Vector3(x=pose.x, y=pose.y, z=z)
    return fox.Pose(position=position, orientation=rotation(pose.yaw))


def laser_scan(robot: str, scan: Scan) -> bytes:
    """A scan; no echo stays +inf, what is invalid becomes NaN, which is drawn as nothing."""
    with np.errstate(invalid="ignore"):  # whatever bytes a stranger sends
        ranges = floats_from_bytes(scan.ranges).astype(np.float64)
    ranges[~(ranges > 0.0)] = np.nan
    last = max(0, len(ranges) - 1)
    return fox.LaserScan(
        timestamp=timestamp(scan.stamp_ns),
        frame_id=frame_name(robot, scan.frame),
        pose=pose_message(Pose2D.identity()),
        start_angle=scan.angle_min,
        end_angle=scan.angle_min + last * scan.angle_increment,
        ranges=ranges.tolist(),
        intensities=floats_from_bytes(scan.intensities).tolist(),
    ).encode()


def grid(robot: str, cells: OccupancyGrid) -> bytes:
    """A map or costmap: one int8 a cell, 0 to 100, -1 unknown."""
    value = fox.PackedElementField(
        name="occupancy", offset=0, type=fox.PackedElementFieldNumericType.Int8
    )
    return fox.Grid(
        timestamp=timestamp(cells.stamp_ns),
        frame_id=frame_name(robot, cells.frame),
        pose=pose_message(cells.origin),
        column_count=cells.width,
        cell_size=fox.Vector2(x=cells.resolution, y=cells.resolution),
        row_stride=cells.width,
        cell_stride=1,
        fields=[value],
        data=bytes(cells.cells),
    ).encode()


def path(robot: str, line: Path) -> bytes:
    """A path or trajectory."""
    rows: list[list[float]] = floats_from_bytes(line.poses, 3).tolist()
    return fox.PosesInFrame(
        timestamp=timestamp(line.stamp_ns),
        frame_id=frame_name(robot, line.frame),
        poses=[pose_message(Pose2D(*row)) for row in rows],
    ).encode()


def pose(robot: str, estimate: PoseEstimate) -> bytes | None:
    """Where the robot is, None while it does not know."""
    if estimate.pose is None:
        return None
    return fox.PoseInFrame(
        timestamp=timestamp(estimate.stamp_ns),
        frame_id=frame_name(robot, "map"),
        pose=pose_message(estimate.pose),
    ).encode()


def transform(robot: str, message: Transform) -> bytes:
    """One frame in another."""
    return _transforms(
        robot, message.stamp_ns, message.parent, message.child, message.pose, message.z
    )


def odometry_transform(robot: str, odometry: Odometry) -> bytes:
    """`base_link` in `odom`."""
    return _transforms(robot, odometry.stamp_ns, "odom", "base_link", odometry.pose)


def _transforms(
    robot: str, stamp_ns: int, parent: str, child: str, at: Pose2D, z: float = 0.0
) -> bytes:
    one = fox.FrameTransform(
        timestamp=timestamp(stamp_ns),
        parent_frame_id=frame_name(robot, parent),
        child_frame_id=frame_name(robot, child),
        translation=fox.Vector3(x=at.x, y=at.y, z=z),
        rotation=rotation(at.yaw),
    )
    return fox.FrameTransforms(transforms=[one]).encode()


def particles(robot: str, cloud: ParticleCloud) -> bytes:
    """The localizer's hypotheses as points with their weights; headings do not fit in."""
    poses = floats_from_bytes(cloud.poses, 3)
    points = np.zeros((len(poses), len(_PARTICLE_FIELDS)), dtype="<f4")
    points[:, :2] = poses[:, :2]
    points[:, 3] = floats_from_bytes(cloud.weights)
    fields = [
        fox.PackedElementField(
            name=name, offset=i * _FLOAT_BYTES, type=fox.PackedElementFieldNumericType.Float32
        )
        for i, name in enumerate(_PARTICLE_FIELDS)
    ]
    return fox.PointCloud(
        timestamp=timestamp(cloud.stamp_ns),
        frame_id=frame_name(robot, "map"),
        pose=pose_message(Pose2D.identity()),
        point_stride=len(fields) * _FLOAT_BYTES,
        fields=fields,
        data=points.tobytes(),
    ).encode()
