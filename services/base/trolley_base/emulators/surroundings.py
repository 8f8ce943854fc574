"""What emulated devices are built from, and what a board's emulator declares."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from trolley_base.emulators.device import Board
from trolley_base.emulators.lidar import Mount
from trolley_base.world import LidarSpec


@dataclass(frozen=True, slots=True)
class WheelFacts:
    """The robot's wheels: ticks per wheel revolution, wheel diameter, track."""

    ticks_per_revolution: float = 1550.0
    diameter_m: float = 0.10
    track_m: float = 0.20

    @property
    def ticks_per_m(self) -> float:
        """Ticks per metre driven."""
        return self.ticks_per_revolution / (math.pi * self.diameter_m)


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What devices are built from.

    Attributes:
        mount: how the lidars sit on the robot.
        errors: of the world's lidar.
        wheels: of a board that counts ticks.
    """

    mount: Mount
    errors: LidarSpec
    wheels: WheelFacts


Options = frozenset[str]
"""Those that were chosen."""


def _no_tables(board: Board, wheels: WheelFacts) -> dict[str, Any]:
    del board, wheels
    return {}


@dataclass(frozen=True, slots=True)
class EmulatedBoard:
    """How a motor board is emulated.

    Attributes:
        make: builds the device: with which options, in which surroundings, with which random
            errors.
        options: name and meaning of each that there is.
        tables: of `[base.chassis]`, that fit such a board where the driver's `example` does not.
    """

    make: Callable[[Options, Surroundings, np.random.Generator], Board]
    options: Mapping[str, str] = field(default_factory=dict[str, str])
    tables: Callable[[Board, WheelFacts], dict[str, Any]] = _no_tables
