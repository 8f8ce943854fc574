"""What `[base] driver` names: checked when base starts, and opened for a run."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.messages import Truth
from trolley_base.drivers import CallSoon, Hardware
from trolley_base.persistence import SavedWorld


class SimulatedWorld(Protocol):
    """What more can be asked of a simulation."""

    def truth(self) -> Truth:
        """Return where the robot truly is."""
        ...

    def to_save(self) -> SavedWorld:
        """Return what lets a later run continue where this one stands."""
        ...

    def set_others(self, outlines: Mapping[str, NDArray[np.float64]]) -> None:
        """Put other robots into the world: their names and outlines (n, 2) [m] in `map`."""
        ...


@dataclass(frozen=True, slots=True)
class Opened:
    """The devices of a run, and the world they are simulated in, if they are."""

    hardware: Hardware
    world: SimulatedWorld | None = None


class Device(Protocol):
    """What the configuration names, and can be used; nothing runs yet."""

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
        """The simulated world's name, None for other devices."""
        ...

    @property
    def is_stepped(self) -> bool:
        """Whether robot time must wait for the devices: for a simulation or a recording."""
        ...

    @property
    def cannot_drive(self) -> str:
        """Why commands go nowhere, as a sentence; "" where they drive."""
        ...

    @property
    def usual_delay_s(self) -> float | None:
        """Usual time until the wheels follow a command [s], None if it was not measured."""
        ...

    @property
    def delay_s(self) -> float:
        """Longest time from a command until odometry shows that the wheels follow it [s]."""
        ...

    @property
    def watchdog_s(self) -> float:
        """The wheels stop by themselves after this much silence [s]."""
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
            saved: where a simulated robot stood last, if known.
            robot_ns: turns local monotonic time into robot time [ns]; asked after this returned.
            call_soon: calls a function on the service's thread; any thread may ask for it.
        """
        ...
