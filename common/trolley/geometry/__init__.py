"""Geometry in the plane: poses, velocities, frames, footprints and polygons."""

from trolley.geometry.angles import angle_difference, wrap_angle, wrap_angles
from trolley.geometry.motion import (
    exp_twist,
    integrate_twist,
    interpolate,
    interpolate_straight,
    log_pose,
)
from trolley.geometry.pose import Finite, Pose2D, Twist2D, pose_from_quaternion

__all__ = [
    "Finite",
    "Pose2D",
    "Twist2D",
    "angle_difference",
    "exp_twist",
    "integrate_twist",
    "interpolate",
    "interpolate_straight",
    "log_pose",
    "pose_from_quaternion",
    "wrap_angle",
    "wrap_angles",
]
