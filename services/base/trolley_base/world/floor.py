"""The floor: rugs and thresholds on which wheels slip, and where the sun shines in. Frame `map`."""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from trolley.geometry import Pose2D
from trolley_base.world.spec import Rug, Sun


@dataclass(frozen=True, slots=True)
class Grip:
    """How well the wheels hold the floor.

    Attributes:
        share: of what they drive that moves the robot.
        pull: turn of the robot for each metre [rad/m].
    """

    share: float = 1.0
    pull: float = 0.0


GOOD = Grip()


class Area(Protocol):
    """A rectangle of floor."""

    @property
    def x(self) -> float:
        """Its centre [m]."""
        ...

    @property
    def y(self) -> float:
        """The same."""
        ...

    @property
    def yaw(self) -> float:
        """Direction of its length [rad]."""
        ...

    @property
    def length_m(self) -> float:
        """Its size [m]."""
        ...

    @property
    def width_m(self) -> float:
        """The same across."""
        ...


def is_on(area: Area, x: float, y: float) -> bool:
    """Say whether a point lies on a rectangle of floor."""
    cos, sin = math.cos(area.yaw), math.sin(area.yaw)
    dx, dy = x - area.x, y - area.y
    along, across = cos * dx + sin * dy, cos * dy - sin * dx
    return abs(along) <= 0.5 * area.length_m and abs(across) <= 0.5 * area.width_m


class Floor:
    """What lies on the floor.

    Args:
        rugs: where wheels slip.
        suns: from where the lidar looks into the sun.
        rng: draws how each crossing of a rug turns the robot.
    """

    def __init__(self, rugs: list[Rug], suns: list[Sun], rng: np.random.Generator) -> None:
        self._rugs = rugs
        self._suns = suns
        self._rng = rng
        self._rug: Rug | None = None
        self._grip = GOOD

    def grip(self, pose: Pose2D) -> Grip:
        """Return how well the wheels hold it at a pose; to be asked at each step."""
        rug = next((one for one in self._rugs if is_on(one, pose.x, pose.y)), None)
        if rug is not self._rug:
            self._rug = rug
            self._grip = GOOD
            if rug is not None:
                pull = rug.pull_per_m * float(self._rng.standard_normal())
                self._grip = Grip(1.0 - rug.slip, pull)
        return self._grip

    def sun(self, pose: Pose2D) -> Sun | None:
        """Return the sun that shines on a pose."""
        return next((one for one in self._suns if is_on(one, pose.x, pose.y)), None)
