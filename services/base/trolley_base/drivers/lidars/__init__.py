"""Lidars by their model."""

from collections.abc import Callable, Mapping

from trolley.config.hardware import LidarConfig, LidarModel
from trolley_base.drivers.dialogue import LidarDialogue
from trolley_base.drivers.interface import DriverError
from trolley_base.drivers.lidars.ld19 import Ld19
from trolley_base.drivers.lidars.lds01 import Lds01
from trolley_base.drivers.lidars.models import MODELS, LidarFacts
from trolley_base.drivers.lidars.rplidar_a1 import RplidarA1
from trolley_base.drivers.lidars.xv11 import Xv11
from trolley_base.drivers.lidars.ydlidar_x4 import YdlidarX4

_MAKERS: Mapping[LidarModel, Callable[[LidarConfig], LidarDialogue]] = {
    "rplidar_a1": RplidarA1,
    "ydlidar_x4": YdlidarX4,
    "ld19": Ld19,
    "xv11": Xv11,
    "lds01": Lds01,
}


def make_lidar(config: LidarConfig) -> LidarDialogue:
    """Return the dialogue with the configured lidar.

    Raises:
        DriverError: no model is set, or the settings do not fit it.
    """
    if config.model is None:
        raise DriverError(f"[base.lidar] needs model, one of {', '.join(MODELS)}")
    return _MAKERS[config.model](config)


__all__ = ["MODELS", "LidarFacts", "make_lidar"]
