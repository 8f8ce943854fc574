"""What was found at a port."""

from dataclasses import dataclass, field
from typing import Literal

from trolley_base.detection.ports import Port


@dataclass(frozen=True, slots=True)
class FoundDevice:
    """A device that answered as it should.

    Attributes:
        kind: what it is good for.
        model: as `robot.toml` calls it; None for one that Trolley has no driver for.
        title: its usual name.
        baud: the line's speed at which it answered.
        details: what it reported about itself, such as `firmware 1.29`.
        problems: what is wrong with it: sentences with what to do.
    """

    kind: Literal["board", "lidar"]
    model: str | None
    title: str
    baud: int
    details: tuple[str, ...] = ()
    problems: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class PortResult:
    """A port that was looked at.

    Attributes:
        port: the port.
        found: what answered; None if nothing did.
        problems: what is wrong, with the port or with the device.
    """

    port: Port
    found: FoundDevice | None = None
    problems: tuple[str, ...] = field(default=())
