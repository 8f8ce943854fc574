"""Telling who stands from a thing: they sway and shift their weight, things do not."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from trolley.geometry import Pose2D, wrap_angle
from trolley_planner.people.sights import HIDDEN, middle_of, width_seen
from trolley_planner.people.tracker import Trail


class StirringParams(NamedTuple):
    """When something stirs; found by hand with simulated lidars."""

    stirs_m: float = 0.06
    """Who stands sways, and shifts their weight, by this and more in all; things do not, as a robot
    that stands sees them across its view."""
    watched_s: float = 1.0
    """Time over which a place is averaged at least: beams lie centimetres apart."""
    same_m: float = 0.1
    """Where more or less of it is seen than before by more than this, its middle moved by that."""
    stands_m: float = 0.06
    """A robot that has moved by no more than this stands: it sees a thing from the same side."""
    stands_rad: float = 0.01
    """The same of its turns, and of corrections of its heading, which move all that it sees."""
    within_m: float = 2.0
    """Distance from the robot beyond which its beams lie too far apart to tell."""


STIRRING = StirringParams()


class Swing(NamedTuple):
    """How far something has moved to and fro across the view of a robot that stands."""

    robot: Pose2D
    """Where that stands."""
    hidden: float
    """What of it was hidden; see `people.sights`."""
    seen_m: float
    """How wide the part is that was seen at first."""
    place: tuple[float, float]
    """Its middle at first [m]."""
    right_m: float = 0.0
    """The farthest to the right (negative) of there that it was."""
    left_m: float = 0.0
    """The same to the left."""

    def goes_on(self, now: "Swing") -> bool:
        """Say whether the same of it is seen now by a robot that has stood since."""
        return (
            self.hidden == now.hidden
            and abs(self.seen_m - now.seen_m) <= STIRRING.same_m
            and self.robot.distance_to(now.robot) <= STIRRING.stands_m
            and abs(wrap_angle(now.robot.yaw - self.robot.yaw)) <= STIRRING.stands_rad
        )

    def extended(self, now: "Swing") -> "Swing":
        """Return it with where its middle is now; along the view it may only seem to move."""
        (x, y), (now_x, now_y) = self.place, now.place
        away_x, away_y = x - self.robot.x, y - self.robot.y
        left_m = (away_x * (now_y - y) - away_y * (now_x - x)) / math.hypot(away_x, away_y)
        return self._replace(right_m=min(self.right_m, left_m), left_m=max(self.left_m, left_m))


class Stirring:
    """Watches what stands somewhere for as long as it is asked about."""

    def __init__(self) -> None:
        self._swings: dict[object, Swing] = {}

    def update(self, trails: Sequence[Trail], robot: Pose2D) -> bool:
        """Say whether any of them has stirred since they were asked about first.

        Args:
            trails: what stands there.
            robot: pose of the robot, in their frame.
        """
        before, self._swings = self._swings, {}
        for one in trails:
            watched_s, sights = -float(one.track[0, 0]), one.track[:, 1:]
            hidden, seen_m = float(sights[-1, HIDDEN]), width_seen(sights[-1])
            is_near = math.dist(one.place, (robot.x, robot.y)) < STIRRING.within_m
            is_same = watched_s >= STIRRING.watched_s and bool((sights[:, HIDDEN] == hidden).all())
            if not is_near or not is_same:
                continue
            x, y = np.mean([middle_of(sight, one.width_m) for sight in sights], axis=0).tolist()
            swing, now = before.get(one.identity), Swing(robot, hidden, seen_m, (x, y))
            is_known = swing is not None and swing.goes_on(now)
            self._swings[one.identity] = swing.extended(now) if is_known else now
        swings = self._swings.values()
        return any(one.left_m - one.right_m > STIRRING.stirs_m for one in swings)
