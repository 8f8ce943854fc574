"""What was chosen in the configuration to drive with: found usable, and then opened for a run."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from trolley.geometry import Pose2D
from trolley_base.drivers import CallSoon, Hardware
from trolley_base.persistence import SavedWorld

if TYPE_CHECKING:
    from trolley_base.recording.recorded_hardware import RecordedHardware
    from trolley_base.simulation.simulated_device import SimulatedRun


@dataclass(frozen=True, slots=True)
class Opened:
    """The devices of a run; if simulated or recorded, what more can be asked of them."""

    hardware: Hardware
    simulated: "SimulatedRun | None" = None
    recorded: "RecordedHardware | None" = None


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

    @property
    def cannot_drive(self) -> str:
        """Why commands go nowhere, as a sentence; "" where they drive."""
        ...

    @property
    def reaction_s(self) -> float:
        """Time until a command acts [s]."""
        ...

    @property
    def watchdog_s(self) -> float:
        """After what silence the wheels stop by themselves [s]."""
        ...

    def open(
        self,
        start_ns: int,
        saved: SavedWorld | None,
        robot_ns: Callable[[int], int],
        call_soon: CallSoon,
    ) -> Opened:
        """Begin a run.

        Args:
            start_ns: robot time now.
            saved: where a simulated robot stood last, if that is known.
            robot_ns: turns local monotonic time into robot time [ns]; asked after this returned.
            call_soon: calls a function on the service's thread; any thread may ask for it.
        """
        ...
