"""Moves the people of a scene through the simulated world, and judges how the robot meets them."""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from bench.planner.crowds import Crowd, Seen
from numpy.typing import NDArray

from trolley.geometry import Pose2D, Twist2D
from trolley_base.world.gaps import outline_to_point
from trolley_base.world.simulation import OtherRobot

PEOPLE_S = 0.02
"""People move and are judged in steps of this, a control period of base [s]."""
TRACE_S = 0.5
PERSONAL_M = 0.45
"""Nobody likes a robot nearer than this: Hall's intimate distance [m]."""
TOUCH_M, RELEASE_M = 0.001, 0.05
"""A contact begins nearer than the first and has ended beyond the second [m]."""
MOVING_MPS, CLOSING_MPS = 0.02, 0.1
"""A robot that is slower stands; one that comes nearer by itself faster has closed in [m/s]."""
WATCHED_M = 2.0
SOMEBODY = "somebody"
_ANGLES = np.arange(20) * (2.0 * math.pi / 20)
CIRCLE = np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES)])
"""Outline of a body or a leg of radius 1; flat sides of a body of 0.2 m lie 2.5 mm inside."""


class Placed(Protocol):
    """Where a robot truly is."""

    @property
    def pose(self) -> Pose2D:
        """In frame `map`."""
        ...

    @property
    def twist(self) -> Twist2D:
        """Its velocity."""
        ...


class World(Protocol):
    """A robot that people walk around."""

    def truth(self) -> Placed:
        """Return where the robot is now."""
        ...

    def set_others(self, others: list[OtherRobot]) -> None:
        """Stand people around the robot."""
        ...


@dataclass(frozen=True)
class Hit:
    """A contact with somebody.

    Attributes:
        seconds: when, since the first goal was sent.
        at: where they were [m].
        robot_mps: how fast the robot moved there.
        closing_mps: its own speed towards them; negative: it was giving way.
        their_mps: their speed towards the robot.
    """

    seconds: float
    at: tuple[float, float]
    robot_mps: float
    closing_mps: float
    their_mps: float

    @property
    def is_moving(self) -> bool:
        """Whether the robot moved."""
        return self.robot_mps > MOVING_MPS

    @property
    def is_by_robot(self) -> bool:
        """Whether the robot itself closed in."""
        return self.closing_mps > CLOSING_MPS


class PeopleJudge:
    """Moves the people of a scene, stands them in the simulated world, and watches them.

    Args:
        crowd: the people.
        world: the simulated world.
        footprint: (n, 2) of the robot [m].
    """

    def __init__(self, crowd: Crowd, world: World, footprint: NDArray[np.float64]) -> None:
        self._crowd, self._world, self._footprint = crowd, world, footprint
        self._radius = float(np.hypot(*footprint.T).max())
        self._is_in_contact = np.zeros(len(crowd.at), dtype=np.bool_)
        self._last_s: float | None = None
        self._outline = np.empty_like(footprint)
        self.hits: list[Hit] = []
        self.closest_m = math.inf
        self.seconds, self.near_s = 0.0, 0.0
        self.trace: list[tuple[float, NDArray[np.float64]]] = []
        """Time and where everybody was [s, (n, 2) m], twice a second."""
        self._place()

    def update(self, now_s: float) -> None:
        """Let the people walk on, and look who is near."""
        if self._last_s is None:
            self._last_s = now_s
        dt = now_s - self._last_s
        if dt < PEOPLE_S - 1e-9:
            return
        self._last_s = now_s
        pose = self._world.truth().pose
        self._crowd.step(dt, Seen(pose, self._radius))
        self.seconds += dt
        self._place()
        self._watch(pose, dt)
        if not self.trace or self.seconds - self.trace[-1][0] >= TRACE_S:
            self.trace.append((self.seconds, self._crowd.at.copy()))

    def _place(self) -> None:
        """Stand everybody in the world."""
        others: list[OtherRobot] = []
        for index, circles in enumerate(self._crowd.solids()):
            for part, (x, y, radius) in enumerate(circles.tolist()):
                outline = (x, y) + radius * CIRCLE
                others.append(OtherRobot(f"{SOMEBODY} {index}.{part}", outline))
        self._world.set_others(others)

    def _watch(self, pose: Pose2D, dt: float) -> None:
        self._outline[:] = pose.transform_points(self._footprint)
        far = np.hypot(*(self._crowd.at - (pose.x, pose.y)).T)
        solids = self._crowd.solids()
        is_near = False
        for index in np.flatnonzero(far < WATCHED_M + self._crowd.radius_m).tolist():
            x, y = self._crowd.at[index].tolist()
            to_body = outline_to_point(self._outline, x, y)[0] - self._crowd.radius_m
            is_near |= to_body < PERSONAL_M
            gap, at, on_robot = min(
                (found[0] - radius, (cx, cy), found[1:])
                for cx, cy, radius in solids[index].tolist()
                for found in (outline_to_point(self._outline, cx, cy),)
            )
            self.closest_m = min(self.closest_m, max(0.0, gap))
            if gap > RELEASE_M:
                self._is_in_contact[index] = False
            elif gap < TOUCH_M and not self._is_in_contact[index]:
                self._is_in_contact[index] = True
                self.hits.append(self._hit(index, at, on_robot, pose))
        self._is_in_contact[far >= WATCHED_M + self._crowd.radius_m] = False
        self.near_s += dt * is_near

    def _hit(
        self, index: int, at: tuple[float, float], on_robot: tuple[float, float], pose: Pose2D
    ) -> Hit:
        """Describe a contact of the robot's nearest point with somebody's nearest circle."""
        twist = self._world.truth().twist
        arm = np.array([on_robot[0] - pose.x, on_robot[1] - pose.y])
        mine = np.array(
            [
                twist.vx * math.cos(pose.yaw) - twist.wz * arm[1],
                twist.vx * math.sin(pose.yaw) + twist.wz * arm[0],
            ]
        )
        towards = np.array(at) - (pose.x, pose.y)
        towards /= max(1e-9, float(np.hypot(*towards)))
        theirs = self._crowd.velocity[index]
        return Hit(
            self.seconds, at, float(np.hypot(*mine)), float(mine @ towards),
            float(-theirs @ towards),
        )  # fmt: skip
