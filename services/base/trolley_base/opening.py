"""Opens what the configuration names: the simulated world, or a recorded drive."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from trolley.config import ConfigError, RobotConfig
from trolley.geometry import Pose2D
from trolley_base.drivers import DriverError, Hardware
from trolley_base.drivers.recording import RecordedHardware
from trolley_base.drivers.recording_file import load_recording
from trolley_base.saved import SavedWorld

if TYPE_CHECKING:
    from trolley_base.simulated_run import SimulatedRun


@dataclass(frozen=True, slots=True)
class Opened:
    """The devices of a run; if simulated or recorded, what more can be asked of them."""

    hardware: Hardware
    simulated: "SimulatedRun | None" = None
    recorded: RecordedHardware | None = None


class Device(Protocol):
    """What was chosen in the configuration and found usable; nothing runs yet."""

    @property
    def base_T_laser(self) -> Pose2D:
        """Where the lidar sits."""
        ...

    @property
    def rate(self) -> float:
        """Robot seconds per real second."""
        ...

    @property
    def world(self) -> str | None:
        """The simulated world's name."""
        ...

    def open(self, start_ns: int, saved: SavedWorld | None) -> Opened:
        """Begin at a robot time, where the robot stood last if that is known."""
        ...


class RecordedDevice:
    """`[base] driver = "recording"`."""

    world: str | None = None

    def __init__(self, config: RobotConfig) -> None:
        settings = config.base.recording
        if settings is None:
            raise ConfigError('[base] driver = "recording" needs [base.recording] file')
        try:
            self._recording = load_recording(config.path(settings.file))
        except DriverError as error:
            raise ConfigError(f"[base.recording] {error}") from error
        self.base_T_laser = self._recording.base_T_laser
        self.rate = settings.rate

    def open(self, start_ns: int, saved: SavedWorld | None) -> Opened:
        """Begin to play."""
        del saved
        hardware = RecordedHardware(self._recording, start_ns)
        return Opened(hardware, recorded=hardware)


def choose_device(config: RobotConfig, footprint: NDArray[np.float64]) -> Device:
    """Find what the configuration names.

    Raises:
        ConfigError: it is not there or cannot be used.
    """
    if config.base.driver == "recording":
        return RecordedDevice(config)
    # The simulation brings numba along, which a robot with little memory does without.
    from trolley_base.simulated_run import SimulatedDevice

    return SimulatedDevice(config, footprint)
