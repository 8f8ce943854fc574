"""What the robot has touched: each contact is counted once, until it has ended."""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley_base.world.body import SKIN_M

COLLISION_SPEED = 0.02
"""A robot that approaches a contact at this speed or faster has driven into it [m/s]."""
RELEASE_M = 0.01
"""A contact has ended when this gap has opened [m]."""


@dataclass(frozen=True, slots=True)
class Contact:
    """The robot and something touched.

    Attributes:
        stamp_ns: time since the simulation began.
        name: of what was touched; `map` for its walls.
        speed: of the robot's own motion towards it [m/s].
        is_collision: the robot drove into it; otherwise it came to the robot, or very slowly.
    """

    stamp_ns: int
    name: str
    speed: float
    is_collision: bool


class ContactLog:
    """Counts contacts by body.

    Args:
        names: of all bodies.
    """

    def __init__(self, names: list[str]) -> None:
        self.names = names
        """Of the bodies that there are."""
        self._state = np.zeros(len(names), dtype=np.int8)
        self.collisions = 0
        """Contacts that the robot drove into."""
        self.bumps = 0
        """All others."""
        self.newest: deque[Contact] = deque(maxlen=256)

    def rename(self, names: list[str]) -> None:
        """Take other bodies into account; contacts with those of the same name go on."""
        known = dict(zip(self.names, self._state, strict=True))
        self._state = np.array([known.get(name, 0) for name in names], dtype=np.int8)
        self.names = names

    def update(
        self,
        now_ns: int,
        gaps: NDArray[np.float64],
        towards: NDArray[np.float64],
        touched: list[int],
    ) -> None:
        """Count new contacts.

        Args:
            now_ns: time since the simulation began.
            gaps: (bodies,) [m].
            towards: (bodies,) speed towards those that stopped the robot [m/s], NaN for others.
            touched: bodies that came to the robot.
        """
        # 1 is an ongoing bump, 2 an ongoing collision.
        self._state[gaps > RELEASE_M] = 0
        pressed = np.flatnonzero((gaps < SKIN_M) | ~np.isnan(towards))
        for body in {*pressed.tolist(), *touched}:
            speed = float(towards[body])
            speed = 0.0 if math.isnan(speed) else speed
            level = 2 if speed > COLLISION_SPEED else 1
            if level <= self._state[body]:
                continue
            self._state[body] = level
            self.collisions += level == 2
            self.bumps += level == 1
            self.newest.append(Contact(now_ns, self.names[body], speed, level == 2))
