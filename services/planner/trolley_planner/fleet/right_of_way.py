"""Which robot goes first where two do not fit side by side: a rule that both know.

Both see the same: the map, where each of them is, the path that each is about to drive, and
whether one reports that it waits. So both reach the same answer without asking each other. Only
one robot at a time is in a narrow place. First comes the one that is in it already, then one that
has waited for long, then one that does not report waiting, then the nearer one, in steps of half a
metre; of two as near, and of two that both wait, the one whose name comes first. That is a total
order, so no ring of robots waits for each other. A robot without a goal claims nothing, and none
makes way by setting off on its own.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.gridmap.distance import distance_transform
from trolley_planner.costmap.connected_components import label_components
from trolley_planner.fleet.neighbours import Neighbour
from trolley_planner.paths.path import SPACING_M


@dataclass(frozen=True, slots=True)
class RightOfWayParams:
    """What both robots must agree on; all by hand."""

    margin_m: float = 0.06
    """Two robots pass each other where this is left beside and between them."""
    ahead_m: float = 6.0
    """This much of the own path is checked."""
    decide_m: float = 1.3
    """A robot that must wait drives on until it is this near to the narrow place."""
    door_m: float = 1.3
    """A narrow place no longer than this is called a door."""
    inside_m: float = 0.12
    """A robot this near to it is in it."""
    step_m: float = 0.5
    """Distances that differ by less than such a step count as equal."""
    long_s: float = 20.0
    """A robot that has waited this long goes before later ones: else a busy door never
    frees."""
    facing_m: float = 1.5
    """Two robots that stand face to face have at most this between their origins."""


RIGHT_OF_WAY = RightOfWayParams()


Floats = NDArray[np.float64]


class Claim(NamedTuple):
    """What a robot's rank depends on."""

    is_inside: bool
    waited_s: float | None
    """How long it has been waiting; None where it drives."""
    left_m: float
    """Distance to the narrow place."""
    name: str
    length_m: float = 0.0
    """Length of the path through it."""

    @property
    def rank(self) -> tuple[bool, int, int, str]:
        """The lower goes first; no two robots have the same."""
        if self.waited_s is None:
            return not self.is_inside, 1, math.floor(self.left_m / RIGHT_OF_WAY.step_m), self.name
        # Of two that wait already each might take the other for nearer: their names do not change.
        return not self.is_inside, 0 if self.waited_s > RIGHT_OF_WAY.long_s else 2, 0, self.name


@dataclass(frozen=True, slots=True)
class OwnRobot:
    """This robot, as the rule sees it."""

    name: str
    place: tuple[float, float]
    radius_m: float
    path: Floats
    """(n, 2) where it drives next, `SPACING_M` apart."""
    waited_s: float | None
    """How long it has been waiting for others; None where it drives."""
    stood_s: float
    """How long it has been standing."""


class Passages:
    """Where on a map two robots do not fit side by side.

    Args:
        static_distance_m: (rows, cols) distance to the nearest wall of the map.
        resolution_m: edge of these cells.
        half_m: half of the width that the two need.
    """

    def __init__(
        self, static_distance_m: NDArray[np.float32], resolution_m: float, half_m: float
    ) -> None:
        self.half_m = half_m
        self._resolution_m = resolution_m
        # What a disc of that size covers wherever it fits is wide: an opening of the free space.
        centres = static_distance_m >= min(half_m, float(static_distance_m.max()))
        away = distance_transform(centres, resolution_m, 2.0 * half_m)
        self._narrow = away > half_m - 0.5 * resolution_m
        # In a thin wall such discs reach through a door from both sides, but do not get through.
        labels = np.empty(centres.shape, dtype=np.int32)
        if label_components(labels, centres, static_distance_m > 0.0) > 1:
            doors = np.zeros(centres.shape, dtype=np.bool_)
            doors[1:] |= (labels[1:] != labels[:-1]) & (labels[1:] > 0) & (labels[:-1] > 0)
            doors[:, 1:] |= (labels[:, 1:] != labels[:, :-1]) & (labels[:, 1:] * labels[:, :-1] > 0)
            near = distance_transform(doors, resolution_m, 2.0 * half_m) < half_m
            self._narrow |= near & ~centres

    def hold(self, points: Floats) -> NDArray[np.bool_]:
        """Say of points (n, 2) in `grid` whether they are in a narrow place."""
        rows, cols = self._narrow.shape
        cells = np.floor(points / self._resolution_m).astype(np.int64)
        cells = np.clip(cells, 0, (cols - 1, rows - 1))
        return self._narrow[cells[:, 1], cells[:, 0]]

    def on(self, path: Floats) -> list[slice]:
        """Return the parts of a path (n, 2) that are narrow, in their order."""
        if len(path) == 0:
            return []
        padded = np.concatenate([[False], self.hold(path), [False]]).astype(np.int8)
        edges = np.flatnonzero(np.diff(padded))
        return [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def conflict(own: OwnRobot, other: Neighbour, passages: Passages) -> tuple[Claim, Claim] | None:
    """Return the claims of both to the first narrow place that they share; None if there is none.

    Args:
        own: this robot.
        other: another one on its way to a goal.
        passages: of the map.
    """
    path = own.path[: round(RIGHT_OF_WAY.ahead_m / SPACING_M) + 1]
    apart_m = own.radius_m + other.radius_m
    theirs = passages.on(other.path)
    for mine in passages.on(path):
        for their in theirs:
            gaps = np.hypot(*np.moveaxis(path[mine][::2, None] - other.path[their][::2], -1, 0))
            if float(gaps.min()) < apart_m:
                place, pose = own.place, other.pose
                return (
                    _claim(own.name, place, path, mine, own.waited_s, passages),
                    _claim(
                        other.name, (pose.x, pose.y), other.path, their, other.waited_s, passages
                    ),
                )
    return None


def _claim(
    name: str,
    place: tuple[float, float],
    path: Floats,
    part: slice,
    waited_s: float | None,
    passages: Passages,
) -> Claim:
    """Return a robot's claim to a narrow part of its path."""
    off_m = math.dist(place, (float(path[0, 0]), float(path[0, 1])))
    left_m = part.start * SPACING_M + off_m
    is_inside = left_m < RIGHT_OF_WAY.inside_m + SPACING_M and bool(
        passages.hold(np.array([place]))[0]
    )
    return Claim(is_inside, waited_s, left_m, name, (part.stop - part.start) * SPACING_M)


def must_wait(own: OwnRobot, other: Neighbour, passages: Passages) -> str | None:
    """Return where this robot waits for another, in words; None if it need not (yet)."""
    claims = conflict(own, other, passages)
    if claims is None:
        return None
    mine, theirs = claims
    if mine.left_m > RIGHT_OF_WAY.decide_m or mine.rank < theirs.rank:
        return None
    return "at the door" if mine.length_m < RIGHT_OF_WAY.door_m else "at the narrow passage"


def must_step_aside(own: OwnRobot, other: Neighbour, patience_s: float) -> bool:
    """Say whether two robots face each other where there is room, and this one lets the other pass.

    Args:
        own: this robot.
        other: another one on its way to a goal.
        patience_s: how long it stands before it takes that for more than caution.
    """
    if own.stood_s < patience_s or other.is_waiting or len(own.path) == 0:
        return False
    x, y = own.place
    if math.hypot(other.pose.x - x, other.pose.y - y) > RIGHT_OF_WAY.facing_m:
        return False
    steps = round(RIGHT_OF_WAY.facing_m / SPACING_M)
    near_m = own.radius_m + other.radius_m
    stands_in_way = _gap(other.path[:steps], x, y) < near_m
    is_in_way = _gap(own.path[:steps], other.pose.x, other.pose.y) < near_m
    return stands_in_way and is_in_way and other.name < own.name


def robot_standing_on(path: Floats, others: list[Neighbour], radius_m: float) -> str | None:
    """Return the name of a robot that stands on a path (n, 2), None if none does."""
    for other in others:
        gap_m = _gap(path, other.pose.x, other.pose.y)
        if other.is_standing and gap_m < radius_m + other.radius_m:
            return other.name
    return None


def _gap(path: Floats, x: float, y: float) -> float:
    if len(path) == 0:
        return math.inf
    return float(np.hypot(path[:, 0] - x, path[:, 1] - y).min())
