"""What a driver of a serial device is: a state machine over bytes, without port, thread or clock.

`SerialDevice` (`serial_device.py`) owns the port. It opens it as `line` says, calls `begin` after
each opening, hands over what arrives, and writes what `outgoing` returns; when the port is lost it
opens it again, and `begin` is called again. So a dialogue is tested with bytes and numbers alone.

All times are one steady clock in nanoseconds (base uses robot time, so stamps need no conversion).
Nothing raises on bytes: what is wrong is counted, and the next good frame is taken. What a dialogue
keeps is bounded.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol

from trolley.geometry import Twist2D
from trolley_base.drivers.interface import ChassisReading, LidarReading

BITS_PER_BYTE = 10
"""On the line, 8N1: start bit, eight data bits, stop bit."""


def travel_ns(num_bytes: int, baud: int) -> int:
    """Return how long so many bytes take on a line of this baud rate [ns]."""
    return num_bytes * BITS_PER_BYTE * 1_000_000_000 // baud


class Datagrams(Protocol):
    """How a device's messages are sent as datagrams, where over a line they are frames."""

    def join(self, datagram: bytes) -> bytes:
        """Return a datagram as it would be on the line; b"" where it is none of such a device."""
        ...

    def cut(self, data: bytes) -> list[bytes]:
        """Return the datagrams of whole frames."""
        ...


@dataclass(frozen=True, slots=True)
class Line:
    """How the port is opened.

    Attributes:
        baud: bits per second, 8N1; any number that Linux can set, 128000 too.
        dtr: level of DTR while the device works; None: as Linux leaves it on opening (set).
        dtr_after: level of DTR when the port is closed; None: untouched.
        settle_s: wait after opening, for a board that reboots; what arrives meanwhile is dropped.
        is_prompt: what arrives is heard at once and not with the next look, for a device that is
            asked again as soon as it has answered.
        restarts: the device reboots when its port is opened, as an Arduino does.
        clears_rts: RTS, which Linux sets on opening, is cleared after `settle_s`.
        leaves_standing: whoever leaves goes on with the dialogue until the wheels stand, for a
            board that drives on when nobody answers it.
        responder: is given what arrives and when [ns], on the port's thread, and returns what is
            answered at once, for a device that does not wait; it has nothing to do with the
            dialogue's state.
        datagrams: for a device that calls its host over UDP.
    """

    baud: int
    dtr: bool | None = None
    dtr_after: bool | None = None
    settle_s: float = 0.0
    is_prompt: bool = False
    restarts: bool = False
    clears_rts: bool = False
    leaves_standing: bool = False
    responder: Callable[[bytes, int], bytes] | None = None
    datagrams: Datagrams | None = None


@dataclass(frozen=True, slots=True)
class Status:
    """How a dialogue goes.

    Attributes:
        state: `searching` while it waits for the device to answer as it should, `up` while the
            device does, `down` when it has stopped doing so or can never do so.
        message: one sentence for a person: what is wrong and what to do; "" while all is well.
        reopen: closing and opening the port may help (after a pause).
    """

    state: Literal["up", "down", "searching"]
    message: str = ""
    reopen: bool = False


class Dialogue(Protocol):
    """The half that boards and lidars share."""

    @property
    def line(self) -> Line:
        """How the port is opened."""
        ...

    def begin(self, now_ns: int) -> None:
        """The port has been opened, perhaps again: forget the device, begin to greet it.

        What has not been handed over yet (scans, motions, notes, counts) stays.
        """
        ...

    def receive(self, data: bytes, arrived_ns: int) -> None:
        """Take bytes, any number of them, the last of which arrived at `arrived_ns`."""
        ...

    def outgoing(self, now_ns: int) -> bytes:
        """Return what is to be written now, b"" for nothing; called every 20 ms or more often."""
        ...

    def goodbye(self) -> tuple[bytes, ...]:
        """Return what is written before the port is closed, 5 ms between two entries."""
        ...

    def status(self, now_ns: int) -> Status:
        """Say how it goes, silence included."""
        ...


class BoardDialogue(Dialogue, Protocol):
    """A motor board."""

    def drive(self, twist: Twist2D) -> None:
        """Set the wanted velocity [m/s, rad/s]; the next `outgoing` sends it.

        A zero after something else is in the very next `outgoing`, whatever the pace of commands.
        Before the device has been greeted, and after `begin`, it is zero.
        """
        ...

    def take(self, now_ns: int) -> ChassisReading:
        """Hand over what the board reported since the last call; `link` is made from `status`."""
        ...


class LidarDialogue(Dialogue, Protocol):
    """A lidar."""

    def take(self, now_ns: int) -> LidarReading:
        """Hand over what was completed since the last call; `link` is made from `status`."""
        ...
