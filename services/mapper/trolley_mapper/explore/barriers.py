"""Places where the robot could not get on although the map shows nothing: mirrors, glass, sills."""

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from trolley.geometry import Pose2D
from trolley.gridmap import OCCUPIED, GridMap
from trolley.messages import Zone


@dataclass(frozen=True, slots=True)
class BarrierParams:
    """When a barrier is assumed, and where. Set by hand."""

    min_stands: int = 2
    """Number of stands near each other from which on something is taken to be there."""
    near_m: float = 1.5
    """Distance within which stands are at one place [m]."""
    num_poses: int = 100
    """Number of poses that are remembered: of the time in which two stands pass."""
    half_width_m: float = 0.8
    """Half the width of a barrier: it leaves free a door beside a mirror [m]."""
    gap_m: float = 0.6
    """Where a wall is no farther from its end than this, it ends there, so that nobody drives
    between the two [m]."""


PARAMS = BarrierParams()


class Barriers:
    """Where the robot stood under way, and lines that explorers take for walls because of it.

    A mirror shows rooms behind it that grow as the robot comes near; that nothing is found there
    never ends exploring, but that the robot cannot get there does.

    Args:
        mirrors: those that are known already.
    """

    def __init__(self, mirrors: Iterable[Zone] = ()) -> None:
        self.mirrors = list(mirrors)
        """Lines where the robot has seen its own image."""
        self.stood: list[Zone] = []
        """Lines where it could not get on."""
        self._stands: list[Pose2D] = []
        self._track: deque[Pose2D] = deque(maxlen=PARAMS.num_poses)

    @property
    def zones(self) -> list[Zone]:
        """All of them, as mirrors."""
        return [*self.mirrors, *self.stood]

    def update_position(self, here: Pose2D) -> None:
        """Note where the robot is (`map_T_base`), twice a second."""
        self._track.append(here)

    def add(self, here: Pose2D, toward: Pose2D, ahead_m: float, grid: GridMap) -> None:
        """Note that the robot stood; it meant to drive to a pose.

        It drives to and fro before a mirror: that hangs beyond where it got farthest.

        Args:
            here: map_T_base.
            toward: map_T_goal.
            ahead_m: distance from the robot to what it may stand before [m].
            grid: the map as it is now.
        """
        self._stands.append(here)
        if sum(one.distance_to(here) <= PARAMS.near_m for one in self._stands) < PARAMS.min_stands:
            return
        way = Pose2D(here.x, here.y, math.atan2(toward.y - here.y, toward.x - here.x))
        near = [one for one in self._track if one.distance_to(here) <= PARAMS.near_m]
        ahead_m += max((way.inverse() @ one).x for one in (here, *near))
        name = f"barrier {len(self.stood) + 1}"
        self.stood.append(_across(name, way @ Pose2D(ahead_m, 0.0, 0.0), grid))

    def add_mirror(self, middle: Pose2D, grid: GridMap) -> None:
        """Note where a mirror was seen (`map`, x pointing into it)."""
        name = f"mirror barrier {len(self.mirrors) + 1}"
        self.mirrors.append(_across(name, middle, grid))


def _across(name: str, middle: Pose2D, grid: GridMap) -> Zone:
    """Return a barrier across the x axis of its middle (`map`)."""
    ends = [middle @ Pose2D(0.0, side * _width(middle, side, grid), 0.0) for side in (-1, 1)]
    return Zone(name=name, kind="mirror", points=[(one.x, one.y) for one in ends])


def _width(middle: Pose2D, side: int, grid: GridMap) -> float:
    """How far a barrier reaches to its right (-1) or left (1) [m]."""
    widths = PARAMS.half_width_m + np.arange(0.0, PARAMS.gap_m, 0.5 * grid.resolution)
    points = middle.transform_points(np.stack([np.zeros_like(widths), side * widths], axis=1))
    walls = np.flatnonzero(grid.values_at(points) == OCCUPIED)
    return float(widths[walls[0]]) if walls.size else PARAMS.half_width_m
