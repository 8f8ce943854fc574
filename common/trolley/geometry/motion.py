"""Motion along arcs: the exponential and logarithm of SE(2), and interpolation.

A robot that holds a constant body velocity drives an exact arc of a circle (a straight line
when it does not turn); these functions follow it without the error of small Euler steps.

Source:
    Eade, Lie Groups for 2D and 3D Transformations (2017), section 5 (SE(2)).
"""

import math

from trolley.geometry.angles import angle_difference, wrap_angle
from trolley.geometry.pose import Pose2D, Twist2D


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
    if fraction == 0.0:
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
