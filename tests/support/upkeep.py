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


def save_turned_lidar(config: RobotConfig, state: Path, turned_rad: float) -> None:
    """Save what a long drive shows of a lidar that is turned against `robot.toml`.

    Args:
        config: the robot's, with the lidar in the middle.
        state: folder of the robot's state.
        turned_rad: by how much the lidar is really turned [rad].
    """
    information = np.eye(6) * 1e6
    values = np.zeros(6)
    values[YAW] = turned_rad
    matrix = scales_of(config).matrix
    mount = Pose2D.identity()
    seen = SavedUpkeep(
        of=[mount.x, mount.y, mount.yaw, *matrix.ravel().tolist()],
        information=information.ravel().tolist(),
        gradient=((information + PRIOR) @ values).tolist(),
        squares=80.0,
        num_legs=80.0,
        misfit=1.0,
    )
    StateFolder(state, Log("test")).write(UPKEEP_FILE, seen)
