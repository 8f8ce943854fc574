"""What the wheels report against what is driven: systematic errors, and their correction.

Unequal wheels bend a straight line, a wrong wheel diameter makes it longer or shorter, a wrong
track makes every turn too large or too small. The same scales, turned round, go into commands, so
that a robot that is told to drive 0.3 m/s does so.

Source:
    Borenstein, Feng, UMBmark: A Benchmark Test for Measuring Odometry Errors in Mobile Robots
    (1995), section 4: the mean wheel diameter stays, only the ratio E_d changes.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from trolley.config import ConfigError, HostConfig
from trolley.geometry import Pose2D, Twist2D, exp_twist, log_pose
from trolley_base.drivers import DriverError
from trolley_base.drivers.boards import counted_track_m


@dataclass(frozen=True, slots=True)
class WheelScales:
    """How reported motion becomes true motion.

    Attributes:
        linear: true metres per reported metre, along x.
        sideways: the same along y.
        angular: true radians per reported radian.
        wheel_ratio: the right wheel's true diameter over the left one's.
        track_m: the track that the board assumes [m]; None only where `wheel_ratio` is 1.

    Raises:
        ValueError: a ratio without a track, or a scale that is not above zero.
    """

    linear: float = 1.0
    sideways: float = 1.0
    angular: float = 1.0
    wheel_ratio: float = 1.0
    track_m: float | None = None
    is_identity: bool = field(init=False)

    def __post_init__(self) -> None:
        scales = (self.linear, self.sideways, self.angular, self.wheel_ratio)
        if not all(0.0 < scale < math.inf for scale in scales):
            raise ValueError(f"scales must be above 0, not {scales}")
        if self.wheel_ratio != 1.0 and self.track_m is None:
            raise ValueError("wheel_ratio needs the track that the board assumes")
        object.__setattr__(self, "is_identity", all(scale == 1.0 for scale in scales))

    @property
    def matrix(self) -> NDArray[np.float64]:
        """(2, 2): reported (vx, wz) to true (vx, wz) [m/s, rad/s]."""
        # E_d of UMBmark: the wheels' factors 2 / (1 + E_d) and 2 E_d / (1 + E_d), by half their
        # difference; it turns the robot as it drives and moves it as it turns.
        uneven = (self.wheel_ratio - 1.0) / (self.wheel_ratio + 1.0)
        half_track = 0.5 * (self.track_m or 1.0)
        return np.array(
            [
                [self.linear, self.linear * uneven * half_track],
                [self.angular * uneven / half_track, self.angular],
            ]
        )

    def true_twist(self, reported: Twist2D) -> Twist2D:
        """Return the true velocity behind a reported one."""
        if self.is_identity:
            return reported
        (along, across), (bend, turn) = self.matrix.tolist()
        return Twist2D(
            along * reported.vx + across * reported.wz,
            self.sideways * reported.vy,
            bend * reported.vx + turn * reported.wz,
        )

    def reported_twist(self, true: Twist2D) -> Twist2D:
        """Return what the board reports, and has to be told, for a true velocity."""
        if self.is_identity:
            return true
        (along, across), (bend, turn) = np.linalg.inv(self.matrix).tolist()
        return Twist2D(
            along * true.vx + across * true.wz,
            true.vy / self.sideways,
            bend * true.vx + turn * true.wz,
        )

    def true_motion(self, reported: Pose2D) -> Pose2D:
        """Return the true motion behind a reported one, both previous_T_base, along an arc."""
        return reported if self.is_identity else exp_twist(self.true_twist(log_pose(reported)))


def scales_of(config: HostConfig) -> WheelScales:
    """Return the scales of the configuration.

    Raises:
        ConfigError: a wheel ratio without a track.
    """
    odometry = config.base.odometry
    try:
        return WheelScales(
            odometry.linear_scale,
            odometry.sideways_scale,
            odometry.angular_scale,
            odometry.wheel_ratio,
            counted_track_of(config),
        )
    except ValueError as error:
        raise ConfigError(
            "[base.odometry] wheel_ratio needs the track that the board assumes: set "
            "[base.chassis.wheels] track_m or [base.odometry] track_m"
        ) from error


def counted_track_of(config: HostConfig) -> float | None:
    """Return the track that the board assumes [m], None where nothing says it.

    Raises:
        ConfigError: the board cannot be used.
    """
    try:
        track_m = counted_track_m(config.base.chassis)
    except DriverError as error:
        raise ConfigError(str(error)) from error
    return config.base.odometry.track_m if track_m is None else track_m
