"""Lidars by their model; `trolley detect` and the importers read the same table."""

from trolley.config.hardware import LidarConfig
from trolley.drivers import Drivers, DriverUnusable, read_settings
from trolley_base.drivers.dialogue import LidarDialogue
from trolley_base.drivers.interface import DriverError
from trolley_base.drivers.lidars.models import SETTINGS, LidarDriver

MODELS = Drivers(LidarDriver)
"""By the name in `[base.lidar] model`; `trolley detect` tries them in this order."""


def make_lidar(config: LidarConfig) -> LidarDialogue:
    """Return the dialogue with the configured lidar.

    Raises:
        DriverError: no model is set, it cannot be used, or the settings do not fit it.
    """
    if config.model is None:
        raise DriverError(f"[base.lidar] needs model, one of {', '.join(MODELS.names)}")
    try:
        driver = MODELS.find(config.model)
    except DriverUnusable as error:
        raise DriverError(f"[base.lidar] model: {error}") from error
    try:
        read_settings(config.settings, driver.settings, SETTINGS)
        return driver.make(config)
    except DriverUnusable as error:
        raise DriverError(str(error)) from error


__all__ = ["MODELS", "LidarDriver", "make_lidar"]
