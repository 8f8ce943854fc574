"""Lidars by their model: the table that `trolley detect` and the importers read, too."""

from collections.abc import Mapping

from trolley.config.hardware import LidarConfig, LidarModel
from trolley_base.drivers.dialogue import LidarDialogue
from trolley_base.drivers.interface import DriverError
from trolley_base.drivers.lidars import (
    camsense,
    coin_d4,
    delta2,
    hokuyo,
    ld19,
    lds01,
    rplidar,
    xv11,
    ydlidar,
)
from trolley_base.drivers.lidars.models import LidarDriver

FAMILIES = (rplidar, ydlidar, ld19, xv11, lds01, camsense, hokuyo, delta2, coin_d4)
"""The drivers' modules; each knows one protocol, and its models by name in `DRIVERS`."""
MODELS: Mapping[LidarModel, LidarDriver] = {
    name: driver for family in FAMILIES for name, driver in family.DRIVERS.items()
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
