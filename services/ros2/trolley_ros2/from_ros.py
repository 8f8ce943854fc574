"""ROS 2's messages as what Trolley is asked for; what cannot be meant is dropped, with a reason."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from trolley.geometry import Pose2D, Twist2D, pose_from_quaternion
from trolley_ros2 import cdr

BASE_FRAMES = ("base_link", "base_footprint")
"""What nodes call the robot's body."""
BODY_FRAMES = ("", *BASE_FRAMES)
"""Frames that a velocity may be given in; most programs leave it out."""

MAX_VARIANCE = 1e12
"""A covariance with larger numbers says nothing."""


class Dropped(Exception):
    """A message is not obeyed.

    Args:
        reason: the counter's name.
        why: a sentence's end for people.
    """

    def __init__(self, reason: str, why: str) -> None:
        super().__init__(why)
        self.reason = reason
        self.why = why


@dataclass(frozen=True, slots=True)
class Where:
    """A pose in a frame, and how certain: 3 x 3 row-major over x, y [m], yaw [rad], or None."""

    frame: str
    pose: Pose2D
    covariance: list[float] | None = None


def decoded(type_name: str, data: bytes) -> Any:
    """A message of its bytes.

    Raises:
        Dropped: It is none.
    """
    try:
        return cdr.read(type_name, data)
    except cdr.NotRead as problem:
        raise Dropped("malformed", str(problem)) from problem


def twist_of(message: Any) -> Twist2D:
    """The velocity of a `Twist` or `TwistStamped`, as far as it lies in the plane.

    Raises:
        Dropped: It is not finite, or in a frame that is not the robot's own.
    """
    if message.__msgtype__ == cdr.TWIST_STAMPED:
        frame = message.header.frame_id.lstrip("/")
        if frame not in BODY_FRAMES:
            raise Dropped("frame", f"its frame is {frame!r}: a velocity is in base_link")
        message = message.twist
    numbers = [
        value for part in (message.linear, message.angular) for value in (part.x, part.y, part.z)
    ]
    if not all(map(math.isfinite, numbers)):
        raise Dropped("not_finite", "a number in it is NaN or infinite")
    return Twist2D(message.linear.x, message.linear.y, message.angular.z)


def where_of(message: Any) -> Where:
    """The pose of a `PoseStamped` or `PoseWithCovarianceStamped`.

    Raises:
        Dropped: It names no frame, or is no pose in the plane.
    """
    frame = message.header.frame_id.lstrip("/")
    if not frame:
        raise Dropped("frame", "it names no frame: header.frame_id is empty")
    has_covariance = message.__msgtype__ == cdr.POSE_WITH_COVARIANCE
    at = message.pose.pose if has_covariance else message.pose
    turned = at.orientation
    try:
        pose = pose_from_quaternion(
            at.position.x, at.position.y, (turned.x, turned.y, turned.z, turned.w)
        )
    except ValueError as problem:
        raise Dropped("no_pose", str(problem)) from problem
    covariance = _planar(message.pose.covariance) if has_covariance else None
    return Where(frame, pose, covariance)


def _planar(covariance: Any) -> list[float] | None:
    """The part over x, y and yaw; None where it says nothing, or is no covariance."""
    planar = np.reshape(covariance, (6, 6))[np.ix_((0, 1, 5), (0, 1, 5))]
    # Written so that NaN is refused, too.
    if not (np.abs(planar) <= MAX_VARIANCE).all():
        return None
    symmetric = 0.5 * (planar + planar.T)
    return symmetric.ravel().tolist() if np.linalg.eigvalsh(symmetric)[0] > 0.0 else None
