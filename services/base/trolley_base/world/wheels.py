"""The drive: what the motors make of a command, what the board reports, and what really happens.

The board holds the commanded velocity by its own measurement. So the reported motion follows the
command exactly within the limits, and the errors of the wheels' scales, the track width and slip go
into the true motion.
"""

import math
from dataclasses import dataclass

import numpy as np

from trolley.geometry import Pose2D, Twist2D, exp_twist
from trolley_base.world.spec import DriveLimits, Wheels


@dataclass(frozen=True, slots=True)
class WheelMotion:
    """What happened in one step.

    Attributes:
        reported: motion of `base_link` as the board measures it, given in where it was before.
        own: true velocity of the robot by its wheels, without slip [m/s, rad/s].
        slipping: the same with slip, which moves it; constant over the step.
    """

    reported: Pose2D
    own: Twist2D
    slipping: Twist2D


STANDING = WheelMotion(Pose2D.identity(), Twist2D.zero(), Twist2D.zero())


class Drive:
    """Two wheels with an axis between them.

    Args:
        wheels: their errors.
        limits: what the motors can do.
        scales_rng: draws this robot's scales, once.
        slip_rng: draws the slip, at each step.
    """

    def __init__(
        self,
        wheels: Wheels,
        limits: DriveLimits,
        scales_rng: np.random.Generator,
        slip_rng: np.random.Generator,
    ) -> None:
        self._wheels = wheels
        self._limits = limits
        self._slip_rng = slip_rng
        left, right, turn = scales_rng.standard_normal(3)
        self._left_scale = wheels.left_scale * (1.0 + wheels.scale_std * float(left))
        self._right_scale = wheels.right_scale * (1.0 + wheels.scale_std * float(right))
        self._turn_scale = wheels.turn_scale * (1.0 + wheels.turn_scale_std * float(turn))
        self._v, self._wz = 0.0, 0.0

    @property
    def twist(self) -> Twist2D:
        """The velocity that the board reports [m/s, rad/s]."""
        return Twist2D(self._v, 0.0, self._wz)

    def step(self, command: Twist2D, dt: float) -> WheelMotion:
        """Follow a command for `dt` seconds; sideways is not possible and left out."""
        limits = self._limits
        self._v = _approach(
            self._v,
            _clamp(command.vx, limits.max_speed_mps),
            limits.acceleration_mps2 * dt,
            limits.deceleration_mps2 * dt,
        )
        self._wz = _approach(
            self._wz,
            _clamp(command.wz, limits.max_wz_radps),
            limits.angular_acceleration_radps2 * dt,
            limits.angular_deceleration_radps2 * dt,
        )
        own = self._true_twist()
        return WheelMotion(exp_twist(self.twist, dt), own, self._with_slip(own, dt))

    def _true_twist(self) -> Twist2D:
        track = self._wheels.track_m
        half = 0.5 * track * self._wz / self._turn_scale
        left = (self._v - half) / self._left_scale
        right = (self._v + half) / self._right_scale
        return Twist2D(0.5 * (left + right), 0.0, (right - left) / track)

    def _with_slip(self, own: Twist2D, dt: float) -> Twist2D:
        wheels = self._wheels
        metres, radians = abs(own.vx) * dt, abs(own.wz) * dt
        along, round_ = self._slip_rng.standard_normal(2)
        slip = wheels.slip_per_m * math.sqrt(metres) * float(along)
        turn_variance = wheels.yaw_slip_per_m**2 * metres + wheels.yaw_slip_per_rad**2 * radians
        yaw_slip = math.sqrt(turn_variance) * float(round_)
        return Twist2D(own.vx + slip / dt, 0.0, own.wz + yaw_slip / dt)


def _clamp(value: float, limit: float) -> float:
    """Return the nearest value within the limit; NaN counts as standing still."""
    return max(-limit, min(limit, value)) if math.isfinite(value) else 0.0


def _approach(now: float, wanted: float, faster: float, slower: float) -> float:
    """Return the next velocity: at most `faster` away from zero, `slower` towards it, per step."""
    if now * wanted < 0.0:
        wanted = 0.0
    limit = faster if abs(wanted) > abs(now) else slower
    return now + max(-limit, min(limit, wanted - now))
