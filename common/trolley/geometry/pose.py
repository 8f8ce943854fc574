"""Poses and velocities in the plane: the group SE(2) as plain values.

A transform is named after the two frames that it joins: `map_T_base` maps points given in
`base_link` to `map`, and neighbouring names cancel: `map_T_laser = map_T_base @ base_T_laser`.
x forward, y left [m], yaw counter-clockwise [rad].

Source:
    Eade, Lie Groups for 2D and 3D Transformations (2017), sections 4 and 5 (SO(2), SE(2)).
"""

import math
import sys
from collections.abc import Sequence
from typing import Annotated, Any, Self

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from trolley.geometry.angles import wrap_angle, wrap_angles

# NaN passes a plain `float` field but fails every comparison, so bounds refuse it and both
# infinities. msgspec checks them when it decodes, not when a value is constructed.
Finite = Annotated[float, msgspec.Meta(ge=-sys.float_info.max, le=sys.float_info.max)]

# Length of the (x, y) part of a unit quaternion beyond which the rotation is not "about z":
# 0.01 is a tilt of 1.1 degrees, above the rounding of hand-typed values.
MAX_TILT = 0.01
# Below this length a quaternion has no direction that could be normalised.
MIN_QUATERNION_LENGTH = 1e-6


class Pose2D(msgspec.Struct, frozen=True):
    """A pose in the plane, which is also the rigid transform `parent_T_child`."""

    x: Finite
    """Position along the parent's x axis [m]."""
    y: Finite
    """Position along the parent's y axis [m]."""
    yaw: Finite
    """Heading, counter-clockwise [rad]. Senders wrap it to (-pi, pi]; receivers take any."""

    @classmethod
    def identity(cls) -> Self:
        """Return the pose that changes nothing."""
        return cls(0.0, 0.0, 0.0)

    @classmethod
    def from_array(cls, array: ArrayLike) -> Self:
        """Make a pose of three numbers x [m], y [m], yaw [rad]; the yaw is wrapped.

        Raises:
            ValueError: the array does not hold exactly three finite numbers.
        """
        values = np.asarray(array, dtype=np.float64)
        if values.shape != (3,):
            raise ValueError(f"a pose needs three numbers x, y, yaw, not shape {values.shape}")
        if not np.isfinite(values).all():
            raise ValueError(f"a pose needs finite numbers, not {values.tolist()}")
        return cls(float(values[0]), float(values[1]), wrap_angle(float(values[2])))

    def as_array(self) -> NDArray[np.float64]:
        """Return x [m], y [m], yaw [rad] as an array of shape (3,)."""
        return np.array([self.x, self.y, self.yaw], dtype=np.float64)

    def as_quaternion(self) -> tuple[float, float, float, float]:
        """Return the heading as the unit quaternion x, y, z, w."""
        return 0.0, 0.0, math.sin(0.5 * self.yaw), math.cos(0.5 * self.yaw)

    def is_finite(self) -> bool:
        """Say whether all three numbers are finite (construction does not check it)."""
        return math.isfinite(self.x) and math.isfinite(self.y) and math.isfinite(self.yaw)

    def wrapped(self) -> "Pose2D":
        """Return the same pose with its yaw in (-pi, pi]."""
        return Pose2D(self.x, self.y, wrap_angle(self.yaw))

    def __matmul__(self, other: "Pose2D") -> "Pose2D":
        """Chain transforms: `a_T_b @ b_T_c` is `a_T_c`, with its yaw wrapped."""
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        return Pose2D(
            self.x + cos * other.x - sin * other.y,
            self.y + sin * other.x + cos * other.y,
            wrap_angle(self.yaw + other.yaw),
        )

    def inverse(self) -> "Pose2D":
        """Return the transform the other way: `a_T_b` becomes `b_T_a`."""
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        return Pose2D(
            -cos * self.x - sin * self.y,
            sin * self.x - cos * self.y,
            wrap_angle(-self.yaw),
        )

    def distance_to(self, other: "Pose2D") -> float:
        """Return the straight distance between two positions of one frame [m]."""
        return math.hypot(other.x - self.x, other.y - self.y)

    def transform_points(self, points: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
        """Map points from the child's frame to the parent's.

        Args:
            points: (n, 2) x, y [m] in the child's frame.

        Returns:
            (n, 2) x, y [m] in the parent's frame; a point that is not finite (a beam without
            an echo) comes back not finite.
        """
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        wide = np.asarray(points, dtype=np.float64)
        out = np.empty_like(wide)
        with np.errstate(invalid="ignore", over="ignore"):
            out[..., 0] = self.x + cos * wide[..., 0] - sin * wide[..., 1]
            out[..., 1] = self.y + sin * wide[..., 0] + cos * wide[..., 1]
        return out

    def transform_poses(self, poses: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
        """Map poses from the child's frame to the parent's.

        Args:
            poses: (n, 3) x, y [m], yaw [rad] in the child's frame.

        Returns:
            (n, 3) in the parent's frame, yaws wrapped.
        """
        wide = np.asarray(poses, dtype=np.float64)
        out = np.empty_like(wide)
        out[..., :2] = self.transform_points(wide[..., :2])
        out[..., 2] = wrap_angles(wide[..., 2] + self.yaw)
        return out


class Twist2D(msgspec.Struct, frozen=True):
    """A velocity in the robot's own frame `base_link`."""

    vx: Finite
    """Forward [m/s]."""
    vy: Finite
    """To the left [m/s]; zero for a robot that cannot drive sideways."""
    wz: Finite
    """Counter-clockwise turn rate [rad/s]."""

    @property
    def is_zero(self) -> bool:
        """Whether all three parts are exactly zero."""
        return self.vx == 0.0 and self.vy == 0.0 and self.wz == 0.0

    @property
    def speed(self) -> float:
        """Speed of the origin of `base_link` over ground [m/s], not negative."""
        return math.hypot(self.vx, self.vy)

    @classmethod
    def zero(cls) -> Self:
        """Return the velocity of a robot that stands."""
        return cls(0.0, 0.0, 0.0)

    def is_finite(self) -> bool:
        """Say whether all three numbers are finite (construction does not check it)."""
        return math.isfinite(self.vx) and math.isfinite(self.vy) and math.isfinite(self.wz)

    def scaled(self, factor: float) -> "Twist2D":
        """Return the velocity times a factor: the same arc, driven slower or faster."""
        return Twist2D(factor * self.vx, factor * self.vy, factor * self.wz)


def pose_from_quaternion(x: float, y: float, orientation: Sequence[float]) -> Pose2D:
    """Make a pose of a position and a quaternion as ROS tools print it.

    Args:
        x: position [m].
        y: position [m].
        orientation: the quaternion x, y, z, w of any length; it is normalised.

    Raises:
        ValueError: with a sentence for people, if a number is missing or not finite, the
            quaternion has no length, or its rotation is not about the z axis.
    """
    if len(orientation) != 4:
        raise ValueError(
            f"an orientation needs the four numbers x, y, z, w of a quaternion, "
            f"not {len(orientation)}"
        )
    values = [float(value) for value in orientation]
    if not all(math.isfinite(value) for value in (x, y, *values)):
        raise ValueError("a pose needs finite numbers; one of these is NaN or infinite")
    length = math.hypot(*values)
    if length < MIN_QUATERNION_LENGTH:
        raise ValueError(
            "the orientation has length zero and so no direction; straight ahead is [0, 0, 0, 1]"
        )
    qx, qy, qz, qw = (value / length for value in values)
    if math.hypot(qx, qy) > MAX_TILT:
        tilt_deg = math.degrees(2.0 * math.asin(min(1.0, math.hypot(qx, qy))))
        raise ValueError(
            f"the orientation is tilted by {tilt_deg:.0f} degrees; a robot on the floor turns "
            f"about z only, so the first two numbers of x, y, z, w must be 0"
        )
    return Pose2D(float(x), float(y), wrap_angle(2.0 * math.atan2(qz, qw)))
