"""What no source may exceed: speed, turn rate, and how fast either may change."""

import math
from dataclasses import dataclass

from trolley.geometry import Twist2D

GRAVITY = 9.81
"""[m/s^2]."""
LEAST_SHARE = 0.2
"""Brakes that hold the robot on a slope at all have this much of their deceleration left."""
STANDS = 1e-6
"""Slower than this no wheel turns [m/s, rad/s]; a velocity that a program lets decay ends in
numbers so small that dividing by them fails."""


@dataclass(frozen=True, slots=True)
class MotionLimits:
    """Limits of `base_link`'s motion; all above zero.

    Attributes:
        speed: [m/s].
        wz: [rad/s].
        acceleration: away from standing [m/s^2].
        deceleration: towards standing, what the robot can surely brake with [m/s^2].
        angular_acceleration: both ways [rad/s^2].
        sideways: whether the wheels can drive sideways.
        slope: the steepest floor, metres of height per metre.
    """

    speed: float
    wz: float
    acceleration: float
    deceleration: float
    angular_acceleration: float
    sideways: bool = False
    slope: float = 0.0

    @property
    def downhill_deceleration(self) -> float:
        """What is left of the deceleration on the steepest floor [m/s^2]."""
        return max(self.deceleration - GRAVITY * self.slope, LEAST_SHARE * self.deceleration)


def within(twist: Twist2D, limits: MotionLimits) -> Twist2D:
    """Return the velocity within the limits on the same arc: too fast is driven slower.

    What moves nothing is none.
    """
    possible = twist if limits.sideways else Twist2D(twist.vx, 0.0, twist.wz)
    if possible.speed < STANDS and abs(possible.wz) < STANDS:
        return Twist2D.zero()
    excess = max(1.0, possible.speed / limits.speed, abs(possible.wz) / limits.wz)
    return possible if excess == 1.0 else possible.scaled(1.0 / excess)


def ramp(now: Twist2D, wanted: Twist2D, limits: MotionLimits, dt: float) -> Twist2D:
    """Return the velocity after `dt` seconds on the way from `now` to `wanted`.

    All parts arrive together, so that a robot that sets off is on the wanted arc at once.

    Args:
        now: within the limits.
        wanted: within the limits.
        limits: accelerations.
        dt: [s].
    """
    change = math.hypot(wanted.vx - now.vx, wanted.vy - now.vy)
    turn_change = abs(wanted.wz - now.wz)
    rate = limits.acceleration if wanted.speed > now.speed else limits.deceleration
    needed = max(change / rate, turn_change / limits.angular_acceleration)
    if needed <= dt:
        return wanted
    part = dt / needed
    return Twist2D(
        now.vx + part * (wanted.vx - now.vx),
        now.vy + part * (wanted.vy - now.vy),
        now.wz + part * (wanted.wz - now.wz),
    )
