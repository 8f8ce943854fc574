"""What base has seen of its wheels and lidar in a drive that a test need not drive."""

from pathlib import Path

import numpy as np

from trolley.config import RobotConfig
from trolley.geometry import Pose2D
from trolley.runtime.log import Log
from trolley.runtime.state import StateFolder
from trolley_base.odometry.wheel_scales import scales_of
from trolley_base.upkeep.evidence import PRIOR, YAW
from trolley_base.upkeep_watch import UPKEEP_FILE, SavedUpkeep

INFORMATION = 500.0
"""What a stretch of a metre tells of an angle, to a localizer that is good to a few centimetres
[1/rad^2]."""


def save_turned_lidar(
    config: RobotConfig, state: Path, turned_rad: float, num_legs: float = 80.0
) -> None:
    """Save what a long drive shows of a lidar that is turned against `robot.toml`.

    Args:
        config: the robot's, with the lidar in the middle.
        state: folder of the robot's state.
        turned_rad: by how much the lidar is really turned [rad].
        num_legs: how many stretches showed it.
    """
    information = np.eye(6) * INFORMATION * num_legs
    values = np.zeros(6)
    values[YAW] = turned_rad
    matrix = scales_of(config).matrix
    mount = Pose2D.identity()
    seen = SavedUpkeep(
        of=[mount.x, mount.y, mount.yaw, *matrix.ravel().tolist()],
        information=information.ravel().tolist(),
        gradient=((information + PRIOR) @ values).tolist(),
        squares=num_legs,
        num_legs=num_legs,
        misfit=1.0,
    )
    StateFolder(state, Log("test")).write(UPKEEP_FILE, seen)
