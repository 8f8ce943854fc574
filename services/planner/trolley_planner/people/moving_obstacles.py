"""What moves around the robot: people, by the lidar, and other robots, by their messages."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley_planner.people.encounters import times_of_encounters
from trolley_planner.people.stirring import Stirring
from trolley_planner.people.tracker import PeopleTracker, Track, TrackedPerson, person_discs
from trolley_planner.people.walls import walk_along_walls

Floats = NDArray[np.float64]
SAME_M = 0.15
"""Distance from a robot's reported position within which a tracked person is that robot [m]."""
SOMEBODY_M = 0.5
"""Distance from what is seen of somebody, or of two side by side, to their middle at most [m]."""
GROWTH_MPS = 0.02, 0.15
"""Least and greatest rate at which the discs that stand for people grow [m/s]."""
MAX_AGE_S = 0.5
"""Longest time after the last scan for which people are extrapolated [s]."""
ROBOT_DT_S = 0.1
"""Time between two positions of a robot's predicted trajectory [s]."""
NOBODY = np.empty((0, 7))
"""Nobody walks."""
NO_ROBOTS = np.empty((0, 1, 3))
"""No other robot drives."""


class MovingObstacles:
    """People, by the newest scan, and other robots, by their messages; all in frame `grid`."""

    def __init__(self) -> None:
        self._tracker, self._stirring = PeopleTracker(), Stirring()
        self._walkers, self._robots = NOBODY, NO_ROBOTS
        self._robots_now = np.empty((0, 3))
        self._scanned_ns = self._robots_ns = 0
        self.people: list[TrackedPerson] = []
        """Who moves by the newest scan."""

    def update(
        self, now_ns: int, beams: Floats, wall_distance_m: NDArray[np.float32], resolution_m: float
    ) -> None:
        """Track people through a new scan; see `PeopleTracker.update`."""
        self.people = self._tracker.update(now_ns, beams, wall_distance_m, resolution_m)
        self._walkers = NOBODY
        if self.people:
            discs = person_discs(self.people)
            deviations = np.array([one.velocity_std for one in self.people])
            walk_along_walls(discs, deviations, wall_distance_m, resolution_m)
            growth = np.clip(deviations, *GROWTH_MPS)
            self._walkers = np.column_stack([discs, growth, times_of_encounters(discs)])
        self._scanned_ns = now_ns

    @property
    def tracks(self) -> list[Track]:
        """Objects of a person's size in the newest scan; see `PeopleTracker.tracks`."""
        return self._tracker.tracks()

    def is_somebody_at(self, x: float, y: float, robot: Pose2D) -> bool:
        """Say whether somebody stands at a place, who was seen to walk or stirs while one asks.

        Args:
            x: of the place [m].
            y: the same.
            robot: pose of the robot.
        """
        near = [
            one for one in self._tracker.standing() if math.dist(one.place, (x, y)) < SOMEBODY_M
        ]
        are_robots = self._are_robots(np.array([one.place for one in near]).reshape(-1, 2))
        near = [one for one, is_robot in zip(near, are_robots, strict=True) if not is_robot]
        return self._stirring.update(near, robot) or any(one.has_walked for one in near)

    def set_robots(self, places: Floats, tracks: Sequence[Floats], now_ns: int) -> None:
        """Replace what is known of the other robots.

        Args:
            places: (n, 3) x, y, radius [m] of all, standing ones, too.
            tracks: (discs, steps, 3) of each that drives: the same at each `ROBOT_DT_S`.
            now_ns: robot time of the first step.
        """
        self._robots = np.concatenate(tracks) if tracks else NO_ROBOTS
        self._robots_now = np.concatenate([places, self._robots[:, 0]])
        self._robots_ns = now_ns

    def forget_people(self) -> None:
        """Forget everybody, as after a jump of the pose."""
        self._tracker.reset()
        self.people, self._walkers = [], NOBODY

    def walkers_at(self, now_ns: int) -> Floats:
        """Return the discs (n, 7) of people where they are now; see `Field.walkers`."""
        walkers = self._walkers[~self._are_robots(self._walkers)]
        age_s = min(max((now_ns - self._scanned_ns) * 1e-9, 0.0), MAX_AGE_S)
        walkers[:, :2] += age_s * walkers[:, 2:4]
        walkers[:, 6] -= age_s
        return walkers

    def robots_at(self, now_ns: int) -> Floats:
        """Return the discs (n, steps, 3) of other robots from now on; see `Field.robots`."""
        age_s = min(max((now_ns - self._robots_ns) * 1e-9, 0.0), MAX_AGE_S)
        passed = min(round(age_s / ROBOT_DT_S), self._robots.shape[1] - 1)
        return np.ascontiguousarray(self._robots[:, passed:]) if len(self._robots) else NO_ROBOTS

    def _are_robots(self, walkers: Floats) -> NDArray[np.bool_]:
        """Say for discs (n, 2 or more) whether each is a robot, which knows where it will be."""
        gaps = walkers[:, None, :2] - self._robots_now[None, :, :2]
        near = self._robots_now[None, :, 2] + SAME_M
        return np.asarray((np.hypot(gaps[..., 0], gaps[..., 1]) < near).any(axis=1))
