"""Compile or load all kernels before the first scan needs them."""

import numpy as np

from trolley_base.odometry.warmup import warm_up as warm_up_odometry
from trolley_base.setup.geometry import turn_treads
from trolley_base.world.warmup import warm_up as warm_up_world

__all__ = ["warm_up"]


def warm_up() -> None:
    """Compile what a simulated world calls, odometry by the lidar, and the robot's own set-up."""
    warm_up_world()
    warm_up_odometry()
    turn_treads(np.empty(2), np.zeros(2), 0.0)
