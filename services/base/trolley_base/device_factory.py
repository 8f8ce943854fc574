"""Finds what the configuration names: real devices, the simulated world, or a recorded drive.

Each of them is imported only where it is named: the simulation brings numba along, which a robot
with little memory does without.
"""

import numpy as np
from numpy.typing import NDArray

from trolley.config import RobotConfig
from trolley_base.drivers.device import Device


def choose_device(config: RobotConfig, footprint: NDArray[np.float64]) -> Device:
    """Find what the configuration names.

    Raises:
        ConfigError: it is not there or cannot be used.
    """
    match config.base.driver:
        case "recording":
            from trolley_base.recording.recorded_device import RecordedDevice

            return RecordedDevice(config)
        case "hardware":
            from trolley_base.drivers.real_device import RealDevice

            return RealDevice(config)
        case "simulated":
            from trolley_base.simulation.simulated_device import SimulatedDevice

            return SimulatedDevice(config, footprint)
