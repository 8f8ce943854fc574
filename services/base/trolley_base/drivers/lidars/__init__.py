"""Lidars by their model: the table that `trolley detect` and the importers read, too."""

from collections.abc import Mapping

from trolley.config.hardware import LidarConfig, LidarModel
from trolley_base.drivers.dialogue import LidarDialogue
from trolley_base.drivers.interface import DriverError
from trolley_base.drivers.lidars import ld19, lds01, rplidar_a1, xv11, ydlidar_x4
from trolley_base.drivers.lidars.models import LidarDriver

MODELS: Mapping[LidarModel, LidarDriver] = {
    "rplidar_a1": rplidar_a1.DRIVER,
    "ydlidar_x4": ydlidar_x4.DRIVER,
    "ld19": ld19.DRIVER,
    "xv11": xv11.DRIVER,
    "lds01": lds01.DRIVER,
}
"""By the name in `[base.lidar] model`; `trolley detect` tries them in this order."""


def make_lidar(config: LidarConfig) -> LidarDialogue:
    """Return the dialogue with the configured lidar.

    Raises:
        DriverError: no model is set, or the settings do not fit it.
    """
    if config.model is None:
        raise DriverError(f"[base.lidar] needs model, one of {', '.join(MODELS)}")
    return MODELS[config.model].make(config)


__all__ = ["MODELS", "LidarDriver", "make_lidar"]
