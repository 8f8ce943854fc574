"""How far odometry can be trusted: the noise of one step.

Source:
    Thrun, Burgard, Fox, Probabilistic Robotics (2005), table 5.6, with the turn of a reversing
    robot taken as AMCL does (the smaller of the turns to its front and to its back).
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.config.localizer import LocalizerConfig
from trolley.geometry import Pose2D, wrap_angle

_SHORT_M = 0.01
"""Length below which a step has no direction of its own [m]."""


@dataclass(frozen=True, slots=True)
class OdometryStep:
    """A step as turn, drive, turn, with the standard deviation of each part."""

    turn: float
    """First turn [rad]."""
    drive: float
    """Distance [m], negative when reversing."""
    after: float
    """Second turn [rad]."""
    turn_dev: float
    """Deviation of the first turn [rad]."""
    drive_dev: float
    """Deviation of the distance [m]."""
    after_dev: float
    """Deviation of the second turn [rad]."""
    slip_dev: float
    """Deviation across the direction of travel [m]."""


def split_step(start_T_end: Pose2D, config: LocalizerConfig) -> OdometryStep:
    """Split the odometry between two moments into turn, drive, turn, and add the noise."""
    drive = math.hypot(start_T_end.x, start_T_end.y)
    turn = math.atan2(start_T_end.y, start_T_end.x) if drive > _SHORT_M else 0.0
    if abs(turn) > 0.5 * math.pi:
        turn = wrap_angle(turn + math.pi)
        drive = -drive
    elif drive <= _SHORT_M:
        drive = start_T_end.x
    after = wrap_angle(start_T_end.yaw - turn)
    turned = turn * turn + after * after
    way = drive * drive
    # The floor is shared by both turns.
    slip = 0.5 * config.slip_rad**2
    return OdometryStep(
        turn=turn,
        drive=drive,
        after=after,
        turn_dev=math.sqrt(config.alpha1 * turn * turn + config.alpha2 * way + slip),
        drive_dev=math.sqrt(config.alpha3 * way + config.alpha4 * turned + config.slip_m**2),
        after_dev=math.sqrt(config.alpha1 * after * after + config.alpha2 * way + slip),
        slip_dev=config.slip_m,
    )


def step_covariance(
    start_T_end: Pose2D, floor_m: float, floor_rad: float, config: LocalizerConfig
) -> NDArray[np.float64]:
    """Return the covariance (3, 3) of a step over x, y [m], yaw [rad] in the frame of its end.

    Args:
        start_T_end: the step.
        floor_m: deviation of the position even of a robot that stands [m].
        floor_rad: deviation of the heading even of a robot that stands [rad].
        config: the noise parameters.
    """
    way = start_T_end.x**2 + start_T_end.y**2
    turned = start_T_end.yaw**2
    yaw = config.alpha1 * turned + config.alpha2 * way + floor_rad**2
    along = config.alpha3 * way + config.alpha4 * turned + floor_m**2
    # A wrong heading leads aside; over half of the distance, since its error grows evenly.
    across = 0.25 * way * yaw + 0.25 * config.alpha4 * turned + floor_m**2
    return np.diag([along, across, yaw])


def move_covariance(
    covariance: NDArray[np.float64], map_T_base: Pose2D, start_T_end: Pose2D
) -> NDArray[np.float64]:
    """Carry a covariance over x, y, yaw in the map frame through a step without noise.

    Args:
        covariance: (3, 3) before the step.
        map_T_base: pose before the step.
        start_T_end: the step.
    """
    cos, sin = math.cos(map_T_base.yaw), math.sin(map_T_base.yaw)
    jacobian = np.eye(3)
    jacobian[0, 2] = -sin * start_T_end.x - cos * start_T_end.y
    jacobian[1, 2] = cos * start_T_end.x - sin * start_T_end.y
    return jacobian @ covariance @ jacobian.T
