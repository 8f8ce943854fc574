"""Which measured motions are believed: those that a robot can do after what it did before.

A counter that wrapped or was misread, a board that restarted and a garbled message all show as a
leap: to a speed that nothing on wheels has, or so suddenly. To stand suddenly is no leap: somebody
may hold the robot.
"""

import math
from dataclasses import dataclass

from trolley.geometry import Pose2D, Twist2D
from trolley_base.drivers import MotionSample


@dataclass(frozen=True, slots=True)
class MotionGuardParams:
    """What a robot can do; set by hand."""

    max_speed: float = 6.0
    """Speed that no robot that can be configured exceeds [m/s]."""
    max_wz: float = 12.0
    """Turn rate that no robot that can be configured exceeds [rad/s]."""
    slack_m: float = 0.05
    """Distance allowed on top, for two readings that lie close together in time [m]."""
    slack_rad: float = 0.3
    """Turn allowed on top, for two readings that lie close together in time [rad]."""
    max_acceleration: float = 20.0
    """Greatest acceleration; wheels that grip reach half of it, and hands hardly more [m/s^2]."""
    max_angular_acceleration: float = 60.0
    """Greatest angular acceleration; wheels that grip reach half of it, and hands hardly more
    [rad/s^2]."""
    angle_slack_rad: float = 0.1
    """Allowed on top of a change of the turn: an encoder's tick, and inexact times [rad]."""


PARAMS = MotionGuardParams()


class MotionGuard:
    """Judges motions in the order in which they come.

    Args:
        stamp_ns: robot time at which the first begins.
    """

    def __init__(self, stamp_ns: int) -> None:
        self._stamp_ns = stamp_ns
        self._believed = self._heard = Twist2D.zero()

    def accepts(self, motion: MotionSample) -> bool:
        """Say whether a motion is newer than all before and one that a robot can do.

        It must fit the last one that was believed, or the last one at all: two leaps that fit each
        other are a robot that was moving when nobody looked.
        """
        pose, seconds = motion.previous_T_base, (motion.stamp_ns - self._stamp_ns) * 1e-9
        if seconds < 0.0 or not (pose.is_finite() and motion.twist.is_finite()):
            return False
        self._stamp_ns = motion.stamp_ns
        fits = _fits(pose, self._believed, seconds) or _fits(pose, self._heard, seconds)
        is_possible = (
            pose.distance_to(Pose2D.identity()) <= PARAMS.max_speed * seconds + PARAMS.slack_m
            and abs(pose.yaw) <= PARAMS.max_wz * seconds + PARAMS.slack_rad
        )
        self._heard = motion.twist
        if fits and is_possible:
            self._believed = motion.twist
            return True
        return False


def _fits(pose: Pose2D, before: Twist2D, seconds: float) -> bool:
    """Say whether a robot that moved like that before, or braked, can have come there."""
    way = before.scaled(seconds)
    length = way.vx * way.vx + way.vy * way.vy
    part = (pose.x * way.vx + pose.y * way.vy) / length if length > 0.0 else 0.0
    part = min(1.0, max(0.0, part))
    further_m = math.hypot(pose.x - part * way.vx, pose.y - part * way.vy)
    further_rad = abs(pose.yaw - min(max(0.0, way.wz), max(min(0.0, way.wz), pose.yaw)))
    most_m = PARAMS.slack_m + PARAMS.max_acceleration * seconds * seconds
    most_rad = PARAMS.angle_slack_rad + PARAMS.max_angular_acceleration * seconds * seconds
    return further_m <= most_m and further_rad <= most_rad
