"""Waiting beside the only path while something stands on it, as a door in which somebody talks.

Who waits in front of them is in their way when they come out. Nobody knows where they will turn: a
place is wanted beside all directions in which they may, or, where there is none, beside those near
the path's.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D, wrap_angles
from trolley_planner.driving.goal_execution import GoalExecution
from trolley_planner.driving.route import Blockage
from trolley_planner.fleet.refuge import REFUGE, Surroundings
from trolley_planner.paths.path import SPACING_M, PlannedPath


class BesideWayParams(NamedTuple):
    """Where they may come, and where it is good to wait; all by hand."""

    leaves_mps: float = 0.25
    """Speed at which they are taken to come; slow, since they will hardly set off at once."""
    turns_rad: tuple[float, ...] = (0.6, 0.3)
    """How far they may turn from the path; less where that leaves no place to wait."""
    between_rad: float = 0.3
    """Angle between two directions."""
    along_m: float = 0.3
    """Length of path before and behind them that tells its direction."""
    away_m: float = 1.2
    """Least distance from what is seen of them; nearer to a stranger is too near: Hall, The Hidden
    Dimension (1966)."""
    past_m: float = 0.7
    """A path that comes as near to what is seen of them leads past them."""
    most_s: float = 5.0
    """Longest time to get there."""
    room_m: float = 0.1
    """Least clearance there: beside a wall the robot sets off slowly."""
    worth_radps: float = 0.1
    """A place that is reached later must lie this much farther off that direction [rad/s]."""


BESIDE_WAY = BesideWayParams()


class BesideWay:
    """Where to wait for what stands on the only path, and for how long."""

    def __init__(self) -> None:
        self.there: tuple[float, float] | None = None
        """Where it stands, x, y in `grid` [m]; None if it is not waited for."""

    def forget(self) -> None:
        """Wait for it no longer."""
        self.there = None

    def find_place(
        self, driven: GoalExecution, pose: Pose2D, speed: float
    ) -> tuple[float, float] | None:
        """Return where to wait, x, y in `grid`; None if no place is better than the present one.

        Args:
            driven: how the goal is driven to; it waits for what stands on its path.
            pose: of the robot in `grid`.
            speed: that it may have [m/s].
        """
        context, route = driven.context, driven.route
        blockage = route.blockage
        if blockage is None:
            return None
        there = blockage.place
        circumscribed_m, costmap = context.footprint.circumscribed_m, context.costmap
        back_rad = direction_back(route.path, there)
        keep_m = circumscribed_m + REFUGE.keep_m
        # They stand yet: the way to the place leads past nobody but those who walk now.
        now = Surroundings(context, pose)
        arrival_s = now.arrivals(now.closes_s(keep_m), pose, speed)
        for turn_rad in BESIDE_WAY.turns_rad:
            around = Surroundings(context, pose, who_may_come(there, back_rad, turn_rad))
            is_refuge = around.is_refuge(around.closes_s(keep_m))
            cells = np.nonzero(is_refuge & (arrival_s <= BESIDE_WAY.most_s))
            places = around.points_of(*cells)
            cols, rows = np.floor(places / costmap.resolution_m).astype(np.int64).T
            off_x, off_y = (places - there).T
            is_good = np.hypot(off_x, off_y) >= BESIDE_WAY.away_m
            is_good &= costmap.distance_m[rows, cols] >= circumscribed_m + BESIDE_WAY.room_m
            if not is_good.any():
                continue
            off_rad = np.abs(wrap_angles(np.arctan2(off_y, off_x) - back_rad))
            worth_rad = off_rad - BESIDE_WAY.worth_radps * arrival_s[cells]
            x, y = places[int(np.where(is_good, worth_rad, -np.inf).argmax())].tolist()
            self.there = there
            return x, y
        return None

    def must_wait(self, driven: GoalExecution, pose: Pose2D, elapsed_s: float) -> bool:
        """Say whether it stands there yet, or is just leaving, and is worth waiting for.

        Args:
            driven: see `find_place`.
            pose: of the robot in `grid`.
            elapsed_s: since the last time.
        """
        if self.there is None:
            return False
        route, progress = driven.route, driven.progress
        # From the side half of them is seen: a path that leads past them would not be free.
        past_m = float(np.hypot(*(route.path.points - self.there).T).min())
        is_gone = past_m > BESIDE_WAY.past_m or route.what_stands_near(*self.there) is None
        is_free = is_gone and not route.is_blocked
        is_over = is_free and not progress.is_anyone_near(pose)
        blockage = None if is_over else Blockage(self.there, 0.0)
        # Who has left and only has to come past is no reason to fail.
        waits = progress.wait_on_way if is_free else driven.wait_on_way
        waits(blockage, pose, elapsed_s)
        if not progress.is_waiting_on_way:
            self.there = None
        return self.there is not None


def direction_back(path: PlannedPath, there: tuple[float, float]) -> float:
    """Return where a path comes from at a place of it [rad].

    Args:
        path: in `grid`.
        there: x, y in `grid` [m].
    """
    nearest = int(np.hypot(*(path.points - there).T).argmin())
    reach = round(BESIDE_WAY.along_m / SPACING_M)
    before, behind = path.points[max(nearest - reach, 0)], path.points[nearest:][:reach][-1]
    x, y = (before - behind).tolist()
    return math.atan2(y, x)


def who_may_come(
    there: tuple[float, float], back_rad: float, turn_rad: float
) -> NDArray[np.float64]:
    """Return (n, 7) whom to expect where something stands, see `Field.walkers`.

    Args:
        there: x, y in `grid` [m].
        back_rad: in which direction they leave.
        turn_rad: how far they may turn from it.
    """
    count = round(turn_rad / BESIDE_WAY.between_rad)
    ways = back_rad + BESIDE_WAY.between_rad * np.arange(-count, count + 1)
    people = np.zeros((len(ways), 7))
    people[:, :2] = there
    people[:, 2] = BESIDE_WAY.leaves_mps * np.cos(ways)
    people[:, 3] = BESIDE_WAY.leaves_mps * np.sin(ways)
    people[:, 4], people[:, 6] = REFUGE.person_m, math.inf
    return people
