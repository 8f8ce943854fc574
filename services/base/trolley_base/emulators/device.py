"""The base class of emulated devices: a state machine between bytes and a simulated world.

It has no port, thread or clock. `robot.py` hands it what the host wrote and each step of the world,
and sends what it answers. All times are one monotonic clock in nanoseconds.
"""

from collections import deque
from dataclasses import dataclass

from trolley.geometry import Twist2D
from trolley_base.emulators.line import BUFFER_BYTES
from trolley_base.world import Simulation
from trolley_base.world.faulty_wheels import FaultyWheels

MOST_COMMANDS = 20_000


class DeviceError(ValueError):
    """A device or option that does not exist; the text says which."""


@dataclass(frozen=True, slots=True)
class Frame:
    """Bytes that belong together, sent from `due_ns` on."""

    due_ns: int
    data: bytes


@dataclass(frozen=True, slots=True)
class ReceivedCommand:
    """A command that reached a board: when, and what it means to its wheels [m/s, rad/s]."""

    at_ns: int
    twist: Twist2D


class Device:
    """One device behind a serial port; subclasses are the boards and lidars.

    Args:
        baud: the speed of its line.
    """

    is_usb = False
    """Whether it has USB of its own: any speed that the host sets will do."""
    calls_host = False
    """Whether over a network it sends to a port of its host, and not the host to its port."""
    buffer_bytes = BUFFER_BYTES
    """What its own transmit buffer holds."""

    def __init__(self, baud: int) -> None:
        self.baud = baud
        self.is_stuck = False
        """Fault: it reports the same values (board) or the same angle (lidar) repeatedly."""
        self._frames: list[Frame] = []
        self._remarks: list[str] = []

    def restart(self, now_ns: int) -> None:
        """Start from scratch, as at power-up."""
        raise NotImplementedError

    def opened(self, now_ns: int) -> None:
        """React to the host opening the port; few devices notice."""

    def receive(self, data: bytes, now_ns: int) -> None:
        """Take what the host wrote; a device that cannot receive ignores it."""

    def step(self, simulation: Simulation, from_ns: int, to_ns: int) -> None:
        """Advance by the step of the world that `simulation` has just made."""
        raise NotImplementedError

    def take_frames(self) -> list[Frame]:
        """Return what it sent since the last call, in order."""
        frames, self._frames = self._frames, []
        return frames

    def take_remarks(self) -> list[str]:
        """Return what people should know, since the last call."""
        remarks, self._remarks = self._remarks, []
        return remarks

    def _send(self, due_ns: int, data: bytes) -> None:
        self._frames.append(Frame(due_ns, data))


class Board(Device):
    """A motor board: it decides what the wheels do.

    Args:
        baud: the speed of its line.
        half_track_m: half of the distance between its wheels [m].
    """

    def __init__(self, baud: int, half_track_m: float) -> None:
        super().__init__(baud)
        self.motors = FaultyWheels(half_track_m)
        """Motors and encoders; faults break them."""
        self.leaps = False
        """Fault: its odometry leaps once a second."""
        self.commands: deque[ReceivedCommand] = deque(maxlen=MOST_COMMANDS)
        """The newest commands, oldest first."""

    def wheels(self) -> Twist2D:
        """Return the command to the wheels for the next step [m/s, rad/s]."""
        raise NotImplementedError

    def _keep(self, now_ns: int, twist: Twist2D) -> None:
        self.commands.append(ReceivedCommand(now_ns, twist))
