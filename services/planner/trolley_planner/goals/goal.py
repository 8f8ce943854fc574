"""A goal, and where exactly it can be reached."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from trolley.geometry import Pose2D, wrap_angle

VIA_RADIUS_M = 0.3
"""Via points count as passed within this."""
ACTIVE = ("planning", "driving", "recovering", "paused")
"""States of a goal that is not over."""


@dataclass(slots=True)
class Tolerances:
    """How near is near enough."""

    xy: float
    """[m]."""
    yaw: float
    """[rad]; pi or more: any heading."""

    @property
    def any_heading(self) -> bool:
        """Whether the heading does not matter."""
        return self.yaw >= math.pi


@dataclass(frozen=True, slots=True)
class Goal:
    """Where to drive, in the frame of the goals."""

    id: str
    pose: Pose2D
    vias: tuple[Pose2D, ...]
    tolerances: Tolerances
    speed: float | None
    sent_ns: int


def nearest_free_pose(
    goal: Pose2D, tolerances: Tolerances, clearance: Callable[[Pose2D], float], wanted_m: float
) -> Pose2D | None:
    """Return the pose nearest to the goal where the robot fits, None if there is none within reach.

    Args:
        goal: the pose asked for.
        tolerances: how far it may be missed.
        clearance: of the footprint at a pose [m].
        wanted_m: clearance that is enough; with less, but none below zero, the best is taken.
    """
    best, best_clearance = None, 0.0
    for radius_share in (0.0, 0.3, 0.6, 0.9):
        for candidate in _around(goal, radius_share, tolerances):
            found = clearance(candidate)
            if found >= wanted_m:
                return candidate
            if found > best_clearance:
                best, best_clearance = candidate, found
    return best


def _around(goal: Pose2D, share: float, tolerances: Tolerances) -> list[Pose2D]:
    """Return poses on a ring around the goal, each with some headings within the tolerance."""
    radius = share * min(tolerances.xy, 1.0)
    spots = [(goal.x, goal.y)]
    if share > 0.0:
        angles = [index * math.pi / 6.0 for index in range(12)]
        spots = [(goal.x + radius * math.cos(a), goal.y + radius * math.sin(a)) for a in angles]
    turns = [0.0]
    if tolerances.any_heading:
        turns = [index * math.pi / 4.0 for index in range(8)]
    elif tolerances.yaw > 0.01:
        turns += [0.8 * tolerances.yaw, -0.8 * tolerances.yaw]
    return [Pose2D(x, y, wrap_angle(goal.yaw + turn)) for x, y in spots for turn in turns]
