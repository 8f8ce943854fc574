"""Inertial units on an I2C bus of the robot's computer."""

from trolley_base.drivers.imus import bno055, bno085, invensense
from trolley_base.drivers.imus.models import ChipFacts

CHIPS: dict[str, ChipFacts] = {**invensense.CHIPS, **bno055.CHIPS, **bno085.CHIPS}
"""By the name that `[base.imu] chip` gives them."""

__all__ = ["CHIPS", "ChipFacts"]
