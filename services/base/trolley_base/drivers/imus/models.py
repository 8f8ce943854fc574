"""What a driver of an inertial unit says of its chip."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from trolley_base.drivers.imus.bus import Bus

Vector = tuple[float, float, float]
Wait = Callable[[float], None]
"""Waits for so many seconds."""
PERIOD_S = 0.02
"""A chip is read this often [s]: the pace of a motor board that has one."""
ONE_G = 9.80665
"""Of a chip that counts in g [m/s^2]."""


class ImuError(Exception):
    """A chip is not what it should be: one sentence."""


class Sample(NamedTuple):
    """What was measured along and about the chip's own axes.

    Attributes:
        rates: [rad/s].
        accelerations: [m/s^2]; what stands on the floor is pushed up.
    """

    rates: Vector
    accelerations: Vector


class Chip(Protocol):
    """A chip at its address; made anew for each opening of the bus."""

    def begin(self, bus: Bus, wait: Wait) -> None:
        """Reset it, see that it is the right one, and start it.

        Raises:
            OSError: it does not answer.
            ImuError: it is another one.
        """
        ...

    def read(self, bus: Bus) -> Sample | None:
        """Return what it measured last; None where nothing new is there.

        Raises:
            OSError: it does not answer.
            ImuError: it has restarted.
        """
        ...


@dataclass(frozen=True, slots=True)
class ChipFacts:
    """A chip's entry in the table of chips.

    Attributes:
        title: how people call it.
        address: at which it answers as it is delivered.
        make: makes its driver for an address.
    """

    title: str
    address: int
    make: Callable[[int], Chip]
