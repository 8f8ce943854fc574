"""`[base] driver = "recording"`: a recorded drive."""

from collections.abc import Callable

from trolley.config import ConfigError, RobotConfig
from trolley_base.drivers import CallSoon, DriverError
from trolley_base.drivers.device import Opened
from trolley_base.persistence import SavedWorld
from trolley_base.recording.recorded_hardware import RecordedHardware
from trolley_base.recording.recording_file import load_recording
from trolley_base.safety.stop_field import REACTION_S


class RecordedDevice:
    """The recording of the configuration."""

    world: str | None = None
    cannot_drive = "A recorded drive is being played, so commands go nowhere."
    reaction_s = REACTION_S
    watchdog_s = 0.5

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

    def open(
        self,
        start_ns: int,
        saved: SavedWorld | None,
        robot_ns: Callable[[int], int],
        call_soon: CallSoon,
    ) -> Opened:
        """Begin to play."""
        del saved, robot_ns, call_soon
        hardware = RecordedHardware(self._recording, start_ns)
        return Opened(hardware, recorded=hardware)
