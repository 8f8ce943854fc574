"""`[base] driver = "recording"`: a recorded drive."""

from collections.abc import Callable
from pathlib import Path

from trolley.config import ConfigError, RobotConfig
from trolley_base.drivers import CallSoon, DriverError
from trolley_base.drivers.device import Opened
from trolley_base.persistence import SavedWorld
from trolley_base.recording.mcap_file import load_mcap
from trolley_base.recording.npz_file import load_npz
from trolley_base.recording.recorded_hardware import RecordedHardware
from trolley_base.recording.recording import Recording


class RecordedDevice:
    """The recording of the configuration."""

    world: str | None = None
    is_stepped = True
    cannot_drive = "A recorded drive is being played, so commands have no effect."
    delay_s = 0.0
    usual_delay_s: float | None = None
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
        return Opened(RecordedHardware(self._recording, start_ns))


def load_recording(path: Path) -> Recording:
    """Read a recorded drive: what `trolley record` wrote, or an npz file.

    Raises:
        DriverError: naming the file and what is wrong with it.
    """
    return load_mcap(path) if path.suffix == ".mcap" else load_npz(path)
