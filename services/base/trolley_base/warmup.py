"""Compile or load all kernels before the first scan needs them."""

from trolley_base.odometry.warmup import warm_up as warm_up_odometry
from trolley_base.world.warmup import warm_up as warm_up_world

__all__ = ["warm_up"]


def warm_up() -> None:
    """Compile what a simulated world calls, and odometry by the lidar."""
    warm_up_world()
    warm_up_odometry()
