"""Angles, poses and velocities in the plane as plain values, the group SE(2), motion along arcs.

A transform is named after the two frames that it joins: `map_T_base` maps points given in
`base_link` to `map`, and neighbouring names cancel: `map_T_laser = map_T_base @ base_T_laser`.
x forward, y left [m], yaw counter-clockwise [rad]. Angles are wrapped to (-pi, pi] by one rule.

A robot that holds a constant body velocity drives an exact arc of a circle (a straight line
when it does not turn); `exp_twist` and `log_pose` follow it without the error of small Euler steps.

Source:
    Eade, Lie Groups for 2D and 3D Transformations (2017), sections 4 and 5 (SO(2), SE(2)).
"""

import math
from collections.abc import Sequence
from typing import Annotated, Any, Self

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

TWO_PI = 2.0 * math.pi
_MOST_RAD = 6.3
"""A full turn, rounded up: a larger angle that somebody writes is taken for degrees [rad]."""


def angle_problem(angle: float) -> str:
    """Say why an angle that somebody wrote is not believed; "" if it may be in radians."""
    if abs(angle) <= _MOST_RAD:
        return ""
    return f"{angle:g} is more than a full turn: angles are in radians (90 degrees are 1.5708)"


def wrap_angle(angle: float) -> float:
    """Return the same direction within (-pi, pi].

    An angle that is already in range comes back unchanged, bit for bit.

    Args:
        angle: finite [rad].

    Raises:
        ValueError: the angle is infinite (NaN comes back as NaN).
    """
    if -math.pi < angle <= math.pi:
        return angle
    wrapped = math.remainder(angle, TWO_PI)
    return math.pi if wrapped <= -math.pi else wrapped


def angle_difference(to_angle: float, from_angle: float) -> float:
    """Return the shortest turn [rad] that leads from one direction to another.

    Positive is counter-clockwise; opposite directions give +pi.
    """
    return wrap_angle(to_angle - from_angle)


def wrap_angles(angles: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Wrap an array of any shape [rad] to (-pi, pi]; NaN stays NaN.

    float32 input is wrapped in float64, since float32 pi is larger than pi.
    """
    wide = np.asarray(angles, dtype=np.float64)
    wrapped = wide - TWO_PI * np.ceil((wide - math.pi) / TWO_PI)
    wrapped = np.where(wrapped <= -math.pi, math.pi, np.minimum(wrapped, math.pi))
    return np.where((wide > -math.pi) & (wide <= math.pi), wide, wrapped)


# NaN passes a plain `float` field but fails every comparison, so bounds refuse it and both
# infinities. msgspec checks them when it decodes, not when a value is constructed.
LARGEST = 1e12
"""Largest number of a message: sums, products and squares of such numbers are finite, too."""
Finite = Annotated[float, msgspec.Meta(ge=-LARGEST, le=LARGEST)]

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


def exp_twist(twist: Twist2D, dt: float = 1.0) -> Pose2D:
    """Return the pose reached from the origin with a constant velocity after `dt` seconds.

    Args:
        twist: body velocity; any turn rate, also zero or tiny.
        dt: duration [s]; negative goes back along the same arc.
    """
    turn = twist.wz * dt
    half = 0.5 * turn
    # sin(t)/t and (1 - cos(t))/t; the half-angle form of the second has no cancellation near 0.
    sin_over_turn = math.sin(turn) / turn if turn != 0.0 else 1.0
    cos_over_turn = math.sin(half) * (math.sin(half) / half) if half != 0.0 else 0.0
    dx, dy = twist.vx * dt, twist.vy * dt
    return Pose2D(
        sin_over_turn * dx - cos_over_turn * dy,
        cos_over_turn * dx + sin_over_turn * dy,
        wrap_angle(turn),
    )


def log_pose(pose: Pose2D) -> Twist2D:
    """Return the constant velocity that reaches a pose from the origin in one second.

    It is the inverse of `exp_twist` for turns in (-pi, pi]: the shorter way round.
    """
    turn = wrap_angle(pose.yaw)
    half = 0.5 * turn
    half_cot = half / math.tan(half) if half != 0.0 else 1.0
    return Twist2D(
        half_cot * pose.x + half * pose.y,
        -half * pose.x + half_cot * pose.y,
        turn,
    )


def integrate_twist(pose: Pose2D, twist: Twist2D, dt: float) -> Pose2D:
    """Return where a robot at `pose` is after `dt` seconds of constant body velocity."""
    return pose @ exp_twist(twist, dt)


def interpolate(start: Pose2D, end: Pose2D, fraction: float) -> Pose2D:
    """Return the pose at a fraction of the arc from `start` to `end`.

    Args:
        start: returned as it is (yaw wrapped) at fraction 0.
        end: returned as it is (yaw wrapped) at fraction 1.
        fraction: between 0 and 1; beyond, the motion goes on along the same arc.
    """
    if fraction == 0.0 or start == end:
        return start.wrapped()
    if fraction == 1.0:
        return end.wrapped()
    return integrate_twist(start, log_pose(start.inverse() @ end), fraction)


def interpolate_straight(start: Pose2D, end: Pose2D, fraction: float) -> Pose2D:
    """Return the pose at a fraction of the straight line from `start` to `end`.

    The heading turns evenly the shorter way round, whatever the direction of the line.
    """
    if fraction == 1.0:
        return end.wrapped()
    return Pose2D(
        start.x + fraction * (end.x - start.x),
        start.y + fraction * (end.y - start.y),
        wrap_angle(start.yaw + fraction * angle_difference(end.yaw, start.yaw)),
    )
