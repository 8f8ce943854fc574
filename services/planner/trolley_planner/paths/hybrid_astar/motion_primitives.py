"""How the robot moves along a maneuver, and what a change of that costs."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D, wrap_angle
from trolley.jit import lean_kernel

FORWARDS, BACKWARDS, TURNING, AT_START = 1, -1, 0, 2
"""How the robot comes to a pose."""
CELL_M = 0.025
"""Edge of a state's cell; curves have a pose in each."""
PoseXYYaw = tuple[float, float, float]
"""x, y [m], yaw [rad], measured from the corner of the grid that is searched."""
Motions = tuple[NDArray[np.float64], NDArray[np.int8]]
"""(n, 3) poses, and (n,) how the robot comes to each."""


class MotionCosts(NamedTuple):
    """What motions cost beside their length; by hand."""

    turn_m: float = 0.35
    """Cost of a turn on the spot by one radian."""
    arc_m: float = 0.1
    """Cost of a turn by one radian while driving: straight lines are easier to follow."""
    switch_m: float = 0.3
    """Cost of a change between forwards and backwards."""
    halt_m: float = 0.2
    """Cost of a change between driving and turning."""


COSTS = MotionCosts()


@dataclass(frozen=True, slots=True, eq=False)
class Maneuver:
    """A path with headings.

    Attributes:
        poses: (n, 3) x, y [m], yaw [rad, not wrapped] in `grid`, a little apart.
        motions: (n,) FORWARDS, BACKWARDS or TURNING: how the robot comes to each pose from the
            one before; the first has that of the second.
        kept: number of the first poses that must not be bent.
    """

    poses: NDArray[np.float64]
    motions: NDArray[np.int8]
    kept: int = 0

    @property
    def end(self) -> Pose2D:
        """Where it ends."""
        x, y, yaw = self.poses[-1].tolist()
        return Pose2D(x, y, wrap_angle(yaw))

    def after(self, lead: "Maneuver") -> "Maneuver":
        """Return it with another before it that ends where it begins."""
        if len(lead.poses) == 1:
            return self
        poses = np.concatenate([lead.poses, self.poses[1:]])
        poses[:, 2] = np.unwrap(poses[:, 2])
        motions = np.concatenate([lead.motions, self.motions[1:]])
        kept = len(lead.poses) - 1 + self.kept if self.kept else lead.kept
        return Maneuver(poses, motions, kept)


@lean_kernel
def change_cost(before: int, motion: int) -> float:
    """Return what the change from one motion to another costs [m]."""
    if before == AT_START:
        return 0.0
    if before == motion:
        return 0.0
    return COSTS.halt_m if before == TURNING or motion == TURNING else COSTS.switch_m
