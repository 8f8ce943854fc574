"""The drive: what the motors make of a command, what the board reports, and what really happens.

The board holds the commanded velocity by its own measurement. So the reported motion follows the
command exactly within what the motors can, and the errors of the wheels' scales, the track width,
backlash, the castor, the floor and slip go into the true motion.
"""

import math
from dataclasses import dataclass

import numpy as np

from trolley.geometry import Pose2D, Twist2D, exp_twist
from trolley_base.differential import twist_of
from trolley_base.world.floor import GOOD, Grip
from trolley_base.world.motors import Actuator, Backlash, Castor
from trolley_base.world.spec import DriveLimits, Motors, Wheels


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
        motors: what moves them.
        limits: what these can do.
        scales_rng: draws this robot's scales, once.
        slip_rng: draws the slip, at each step.
        motors_rng: draws what the motors do.
    """

    def __init__(
        self,
        wheels: Wheels,
        motors: Motors,
        limits: DriveLimits,
        scales_rng: np.random.Generator,
        slip_rng: np.random.Generator,
        motors_rng: np.random.Generator,
    ) -> None:
        self._wheels = wheels
        self._slip_rng = slip_rng
        left, right, turn = scales_rng.standard_normal(3)
        self._left_scale = wheels.left_scale * (1.0 + wheels.scale_std * float(left))
        self._right_scale = wheels.right_scale * (1.0 + wheels.scale_std * float(right))
        self._turn_scale = wheels.turn_scale * (1.0 + wheels.turn_scale_std * float(turn))
        self._actuator = Actuator(motors, limits, wheels.track_m, motors_rng)
        self._left_play = Backlash(motors.backlash_m)
        self._right_play = Backlash(motors.backlash_m)
        self._castor = Castor(motors, motors_rng)

    @property
    def twist(self) -> Twist2D:
        """The velocity that the board reports [m/s, rad/s]."""
        return self._actuator.twist

    def wear(self, left: float, right: float) -> None:
        """Make the wheels smaller: what is left of each."""
        self._left_scale /= left
        self._right_scale /= right

    def widen_track(self, share: float) -> None:
        """Move the wheels apart, to so much of what it was: the robot turns less."""
        self._turn_scale *= share

    def step(self, command: Twist2D, dt: float, grip: Grip = GOOD) -> WheelMotion:
        """Follow a command for `dt` seconds, on a floor that holds the wheels so well."""
        self._actuator.step(command, dt)
        own = self._true_twist(dt)
        if grip is not GOOD:
            pull = grip.pull * abs(own.vx)
            own = Twist2D(grip.share * own.vx, 0.0, grip.share * own.wz + pull)
        kick = self._castor.drive(own.vx, dt)
        if kick:
            own = Twist2D(own.vx, 0.0, own.wz + kick)
        return WheelMotion(exp_twist(self.twist, dt), own, self._with_slip(own, dt))

    def _true_twist(self, dt: float) -> Twist2D:
        half_track_m, twist = 0.5 * self._wheels.track_m, self.twist
        half = half_track_m * twist.wz / self._turn_scale
        left = self._left_play.drive((twist.vx - half) / self._left_scale, dt)
        right = self._right_play.drive((twist.vx + half) / self._right_scale, dt)
        return twist_of(left, right, half_track_m)

    def _with_slip(self, own: Twist2D, dt: float) -> Twist2D:
        wheels = self._wheels
        metres, radians = abs(own.vx) * dt, abs(own.wz) * dt
        along, round_ = self._slip_rng.standard_normal(2)
        slip = wheels.slip_per_m * math.sqrt(metres) * float(along)
        turn_variance = wheels.yaw_slip_per_m**2 * metres + wheels.yaw_slip_per_rad**2 * radians
        yaw_slip = math.sqrt(turn_variance) * float(round_)
        return Twist2D(own.vx + slip / dt, 0.0, own.wz + yaw_slip / dt)
