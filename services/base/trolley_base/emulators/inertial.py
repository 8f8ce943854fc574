"""The inertial unit of an emulated board: how the robot truly moves, with the unit's errors."""

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D, wrap_angle
from trolley_base.world import TrueState

Floats = NDArray[np.float64]

GRAVITY = 9.80665
ACCELERATION_NOISE = 0.05
"""Of each reading [m/s^2]."""


class InertialUnit:
    """A gyro and an accelerometer, level in the middle of the robot.

    Args:
        bias_std: deviation of the gyro's zero-rate error from unit to unit [rad/s].
        noise: of each reading of the gyro [rad/s].
        rng: draws both.
    """

    def __init__(self, bias_std: float, noise: float, rng: np.random.Generator) -> None:
        self.gyro_factor = 1.0
        """Fault: its gyro reads this many times the truth."""
        self._noise = noise
        self._rng = rng
        self._bias = bias_std * rng.standard_normal(3)
        self.restart()

    def restart(self) -> None:
        """Forget how it moved."""
        self._pose: Pose2D | None = None
        self._speed = self._forward = self._yaw_rate = 0.0

    def move(self, state: TrueState, seconds: float) -> None:
        """Notice how the robot has moved in these seconds."""
        before = self._pose or state.pose
        self._yaw_rate = wrap_angle(state.pose.yaw - before.yaw) / seconds
        self._forward = (state.twist.vx - self._speed) / seconds if self._pose else 0.0
        self._pose, self._speed = state.pose, state.twist.vx

    def read(self) -> tuple[Floats, Floats]:
        """Return rates (3,) [rad/s] and specific forces (3,) [m/s^2], axes of `base_link`."""
        gyro = self._bias + self._noise * self._rng.standard_normal(3)
        gyro += (0.0, 0.0, self.gyro_factor * self._yaw_rate)
        forces = ACCELERATION_NOISE * self._rng.standard_normal(3)
        forces += (self._forward, self._speed * self._yaw_rate, GRAVITY)
        return gyro, forces
