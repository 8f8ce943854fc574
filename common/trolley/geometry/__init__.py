"""Geometry in the plane: poses, velocities, frames, footprints and polygons."""

from trolley.geometry.footprint import (
    circumscribed_radius,
    footprint_from_box,
    footprint_from_polygon,
    footprint_from_radius,
    inscribed_radius,
    radius_of_gyration,
)
from trolley.geometry.frames import FrameTree, Link, MissingLink
from trolley.geometry.polygon import (
    check_polygon,
    distance_to_outline,
    distance_to_segments,
    polygon_contains,
    segments_meet,
)
from trolley.geometry.pose import (
    Finite,
    Pose2D,
    Twist2D,
    angle_difference,
    angle_problem,
    exp_twist,
    integrate_twist,
    interpolate,
    interpolate_straight,
    log_pose,
    pose_from_quaternion,
    wrap_angle,
    wrap_angles,
)

__all__ = [
    "Finite",
    "FrameTree",
    "Link",
    "MissingLink",
    "Pose2D",
    "Twist2D",
    "angle_difference",
    "angle_problem",
    "check_polygon",
    "circumscribed_radius",
    "distance_to_outline",
    "distance_to_segments",
    "exp_twist",
    "footprint_from_box",
    "footprint_from_polygon",
    "footprint_from_radius",
    "inscribed_radius",
    "integrate_twist",
    "interpolate",
    "interpolate_straight",
    "log_pose",
    "polygon_contains",
    "pose_from_quaternion",
    "radius_of_gyration",
    "segments_meet",
    "wrap_angle",
    "wrap_angles",
]
