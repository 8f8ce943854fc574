"""People who walk along their paths, pause, wait for the robot, and turn round."""

import math
from dataclasses import dataclass
from enum import Enum, auto
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from trolley_base.world.gaps import outline_to_point
from trolley_base.world.spec import Person, Point


@dataclass(frozen=True, slots=True)
class GaitParams:
    """How people walk; by hand, for an adult at the height of a low lidar."""

    leg_side: float = 0.5
    """Half the distance of the legs sideways, as a share of the body's radius."""
    leg_swing: float = 0.75
    """How far they swing ahead and back, as a share of the body's radius."""
    leg_radius_m: float = 0.06
    """Radius of a leg [m]."""
    stride_m: float = 1.2
    """Distance after which both legs have swung once [m]."""
    touch_m: float = 0.001
    """Distance to the robot within which nobody walks, which is touching it [m]."""
    places_tried: int = 20
    """Number of random places, of which a person begins at the first that keeps off the robot."""


PARAMS = GaitParams()


class Walk(Enum):
    """What a person did in a step."""

    FREE = auto()
    WAITED = auto()
    TOUCHED = auto()


class Walker:
    """One person and where on the path they are.

    Args:
        person: from the world file.
        rng: chooses the place on the path at which the walk begins.
    """

    def __init__(self, person: Person, rng: np.random.Generator) -> None:
        self._person = person
        self._path = _without_repeats(person.path, person.loop)
        self._lengths = [
            math.dist(a, b) for a, b in zip(self._path, self._next_points(), strict=False)
        ]
        self._leg, self._along, self._direction = 0, 0.0, 1
        self._pause_s = person.starts_s or 0.0
        self._held_s = 0.0
        if person.starts_s is None and self._lengths:
            self._begin_anywhere(rng)

    def keep_off(self, outline: NDArray[np.float64], rng: np.random.Generator) -> None:
        """Begin somewhere else if that is on the robot: there, each would hold the other forever.

        Args:
            outline: (n, 2) the robot's footprint [m] in `map`.
            rng: chooses the place.
        """
        if self._person.starts_s is not None or not self._lengths:
            return
        keep = max(self._person.stops_for_robot_m, PARAMS.touch_m)
        for _ in range(PARAMS.places_tried):
            if _gap(self.circles(), outline) >= keep:
                break
            self._begin_anywhere(rng)

    @property
    def num_circles(self) -> int:
        """The number of circles that represent this person."""
        return 2 if self._person.legs else 1

    def circles(self) -> NDArray[np.float64]:
        """Return what is solid of this person, (circles, 3) x, y, radius [m] in `map`."""
        return self._circles_at(self._leg, self._along)

    def step(self, dt: float, outline: NDArray[np.float64]) -> Walk:
        """Continue walking for `dt` seconds, unless the robot is in the way.

        Args:
            dt: duration [s].
            outline: (n, 2) the robot's footprint [m] in `map`.
        """
        if not self._lengths:
            return Walk.FREE
        if self._pause_s > 0.0:
            self._pause_s -= dt
            return Walk.FREE
        wanted = self._ahead(self._person.speed_mps * dt)
        gap = _gap(self._circles_at(*wanted[:2]), outline)
        keep = max(self._person.stops_for_robot_m, PARAMS.touch_m)
        if gap < keep and gap < _gap(self.circles(), outline):
            self._held_s += dt
            if self._held_s > self._person.patience_s:
                self._direction, self._held_s = -self._direction, 0.0
            return Walk.TOUCHED if gap < PARAMS.touch_m else Walk.WAITED
        self._leg, self._along, self._direction, arrived = wanted
        if arrived:
            self._pause_s = self._person.dwell_s
        self._held_s = 0.0
        return Walk.FREE

    def _next_points(self) -> list[Point]:
        rest = self._path[1:]
        return [*rest, self._path[0]] if self._person.loop and rest else rest

    def _begin_anywhere(self, rng: np.random.Generator) -> None:
        where = float(rng.random()) * sum(self._lengths)
        backwards = not self._person.loop and float(rng.random()) < 0.5
        for leg, length in enumerate(self._lengths):
            if where < length or leg == len(self._lengths) - 1:
                self._leg, self._along = leg, min(where, length)
                break
            where -= length
        self._direction = -1 if backwards else 1

    def _ahead(self, distance: float) -> tuple[int, float, int, bool]:
        """Return leg, place on it and direction after a distance; and whether a point was met."""
        leg, along, direction = self._leg, self._along + self._direction * distance, self._direction
        if 0.0 <= along <= self._lengths[leg]:
            return leg, along, direction, False
        following = leg + direction
        if self._person.loop:
            following %= len(self._lengths)
        elif not 0 <= following < len(self._lengths):
            return leg, min(max(along, 0.0), self._lengths[leg]), -direction, True
        return following, 0.0 if direction > 0 else self._lengths[following], direction, True

    def _circles_at(self, leg: int, along: float) -> NDArray[np.float64]:
        start, ux, uy = self._path[leg], 1.0, 0.0
        if self._lengths:
            end = self._path[(leg + 1) % len(self._path)]
            ux = (end[0] - start[0]) / self._lengths[leg]
            uy = (end[1] - start[1]) / self._lengths[leg]
        x, y = start[0] + along * ux, start[1] + along * uy
        radius = self._person.radius_m
        if not self._person.legs:
            return np.array([[x, y, radius]])
        # By the place alone: legs that changed over when somebody turns could land in the robot.
        swing = PARAMS.leg_swing * radius * math.sin(2.0 * math.pi * along / PARAMS.stride_m)
        side = PARAMS.leg_side * radius
        return np.array(
            [
                [x + swing * ux - side * uy, y + swing * uy + side * ux, PARAMS.leg_radius_m],
                [x - swing * ux + side * uy, y - swing * uy - side * ux, PARAMS.leg_radius_m],
            ]
        )


def _without_repeats(path: list[Point], loop: bool) -> list[Point]:
    """Return the path without points that repeat the one before, which have no direction."""
    if loop and len(path) > 1 and path[0] == path[-1]:
        path = path[:-1]
    kept = [path[0]]
    kept.extend(point for before, point in pairwise(path) if math.dist(before, point) > 0)
    return kept


def _gap(circles: NDArray[np.float64], outline: NDArray[np.float64]) -> float:
    """Return the smallest gap between circles (n, 3) and the outline (m, 2) [m]."""
    return min(
        outline_to_point(outline, float(x), float(y))[0] - float(radius) for x, y, radius in circles
    )
