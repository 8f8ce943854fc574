"""A robot's motion as that of its two sides, and back. SI."""

from trolley.geometry import Twist2D


def sides_of(twist: Twist2D, half_track_m: float) -> tuple[float, float]:
    """Return how fast the left and the right side go [m/s].

    Args:
        twist: of the robot.
        half_track_m: half of the distance between left and right wheels [m].
    """
    outward = half_track_m * twist.wz
    return twist.vx - outward, twist.vx + outward


def twist_of(left: float, right: float, half_track_m: float) -> Twist2D:
    """Return the motion of a robot whose sides go so fast [m/s]."""
    return Twist2D(0.5 * (left + right), 0.0, 0.5 * (right - left) / half_track_m)
