"""Tells the planner about the people of a scene what its lidar cannot: where they truly are or go.

What the planner does better with it is what its tracking, or its prediction, costs; what it still
does badly is the controller's part. People whose future is known are priced as other robots are:
only for as long as a rollout lasts, and not for where the robot stands after it.
"""

import copy
from collections.abc import Callable
from typing import Literal

import numpy as np
from bench.planner.crowds import Crowd, Seen
from bench.planner.people_judge import CIRCLE, PEOPLE_S
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley_planner.people.encounters import times_of_encounters
from trolley_planner.people.free_space import FREE_SPACE
from trolley_planner.people.moving_obstacles import GROWTH_MPS, NOBODY, ROBOT_DT_S, MovingObstacles
from trolley_planner.people.tracker import TrackedPerson, person_discs
from trolley_planner.service import PlannerService

Floats = NDArray[np.float64]
Knows = Literal["tracks", "truth", "future"]
"""What the planner goes by: its own tracks, where people truly are and how they move, or where
they will be, which it is told as other robots tell it."""
FUTURE_S = 8.0
"""Their future is told for so long [s]."""
BODY_POINTS = 10
FAR = Seen(Pose2D(-1000.0, -1000.0, 0.0), 0.2)
"""Where a robot is that nobody sees."""


class Future:
    """Where everybody of a crowd that does not see the robot will be.

    Args:
        crowd: as it is now, which is not changed.
    """

    def __init__(self, crowd: Crowd) -> None:
        self._crowd = copy.deepcopy(crowd)
        self._places = [self._crowd.at.copy()]

    def at(self, seconds: float) -> Floats:
        """Return where they are (n, 2) so long after the beginning [m]."""
        step = round(max(seconds, 0.0) / PEOPLE_S)
        while len(self._places) <= step:
            self._crowd.step(PEOPLE_S, FAR)
            self._places.append(self._crowd.at.copy())
        return self._places[step]


class KnownPeople(MovingObstacles):
    """People as they truly are, in place of those that the lidar shows; hidden ones, too.

    Args:
        crowd: the people.
        clocks: how long the people have walked, and the simulated time [s].
        future: where they will be; None: they are taken to walk on as now.
        grid_T_people: says where their frame lies in `grid`.
    """

    def __init__(
        self,
        crowd: Crowd,
        clocks: tuple[Callable[[], float], Callable[[], float]],
        future: Future | None,
        grid_T_people: Callable[[], Pose2D],
    ) -> None:
        super().__init__()
        self._crowd, self._future = crowd, future
        self._walked_s, self._now_s = clocks
        self._place_people = grid_T_people
        self._lidar = Pose2D(0.0, 0.0, 0.0)

    def update(
        self, now_ns: int, beams: Floats, wall_distance_m: NDArray[np.float32], resolution_m: float
    ) -> None:
        """Take over who is as near as people are tracked."""
        del now_ns, wall_distance_m, resolution_m
        x, y = beams[:, :2].mean(axis=0).tolist()
        self._lidar = Pose2D(x, y, 0.0)
        self.people = [self._person(index) for index in self._near()]

    def walkers_at(self, now_ns: int) -> Floats:
        """Return the discs (n, 7) of people; see `Field.walkers`."""
        people = [] if self._future is not None else [self._person(one) for one in self._near()]
        if not people:
            return NOBODY
        discs, ahead_s = person_discs(people), now_ns * 1e-9 - self._now_s()
        growth = np.full(len(discs), GROWTH_MPS[0])
        walkers = np.column_stack([discs, growth, times_of_encounters(discs)])
        walkers[:, :2] += ahead_s * walkers[:, 2:4]
        walkers[:, 6] -= ahead_s
        return walkers

    def robots_at(self, now_ns: int) -> Floats:
        """Return the discs (n, steps, 3) of people whose future is known; see `Field.robots`."""
        near = self._near()
        if self._future is None or not near:
            return super().robots_at(now_ns)
        ahead_s = now_ns * 1e-9 - self._now_s()
        steps = round(FUTURE_S / ROBOT_DT_S)
        found = np.empty((len(near), steps, 3))
        found[:, :, 2] = person_discs([self._person(index) for index in near])[:, None, 4]
        for step in range(steps):
            places = self._future.at(self._walked_s() + ahead_s + step * ROBOT_DT_S)[near]
            found[:, step, :2] = self._grid_T_people.transform_points(places)
        return found

    @property
    def _grid_T_people(self) -> Pose2D:
        return self._place_people()

    def _near(self) -> list[int]:
        """Return who is within sight of the lidar, hidden or not."""
        at = self._grid_T_people.transform_points(self._crowd.at)
        away = np.hypot(at[:, 0] - self._lidar.x, at[:, 1] - self._lidar.y)
        return np.flatnonzero(away < FREE_SPACE.sight_m).tolist()

    def _person(self, index: int) -> TrackedPerson:
        circles = self._crowd.solids()[index]
        turned = Pose2D(0.0, 0.0, self._grid_T_people.yaw)
        place, *edges = self._grid_T_people.transform_points(
            np.vstack(
                [self._crowd.at[index]]
                + [
                    circle[:2] + circle[2] * CIRCLE[:: len(CIRCLE) // BODY_POINTS]
                    for circle in circles
                ]
            )
        )
        velocity = turned.transform_points(self._crowd.velocity[index : index + 1])[0]
        return TrackedPerson(np.array(edges), place, velocity, GROWTH_MPS[0])


class Informant:
    """Puts what is known of a crowd that has not set off yet in the place of the planner's tracks.

    Args:
        planner: that is told.
        crowd: the people.
        knows: what it is told; not `tracks`.
        clocks: how long the people have walked, and the simulated time [s].
        frame_T_people: says where the people's frame lies in that of the goals.
    """

    def __init__(
        self,
        planner: PlannerService,
        crowd: Crowd,
        knows: Knows,
        clocks: tuple[Callable[[], float], Callable[[], float]],
        frame_T_people: Callable[[], Pose2D],
    ) -> None:
        self._costmaps = planner.navigator.costmap_manager
        future = Future(crowd) if knows == "future" else None
        self._people = KnownPeople(crowd, clocks, future, self._grid_T_people)
        self._frame_T_people = frame_T_people

    def tell(self) -> None:
        """Tell the planner, which may have made itself a new costmap meanwhile."""
        self._costmaps.require_context().costmap.moving = self._people

    def _grid_T_people(self) -> Pose2D:
        return self._costmaps.require_context().costmap.grid_T_frame @ self._frame_T_people()
