"""What the mapper says after each scan, and poses that move with the map."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D

State = Literal["mapping", "unsure", "lost"]


@dataclass(frozen=True, slots=True, eq=False)
class MapEstimate:
    """Where the robot was at the stamp of a scan, on the map as it is so far."""

    stamp_ns: int
    """Robot time of the scan's first beam, for which the pose holds [ns]."""
    pose: Pose2D
    """`map_T_base`; while `lost` what odometry and scans make of the last one that was known."""
    covariance: NDArray[np.float64]
    """(3, 3) over x, y [m], yaw [rad] in the map frame, against the keyframes nearby."""
    match: float
    """Share of the scan that the map explains, 0 ... 1."""
    state: State
    """`mapping`: the map grows. `unsure`: followed, the map does not grow. `lost`: what is mapped
    hangs loose until it is known how it lies to the map."""
    message: str
    """What is the matter, in one sentence; empty when all is well."""
    map_T_odom: Pose2D
    """`pose` with the odometry taken off."""
    closed_loop: bool
    """Whether a loop was closed since the estimate before: poses and the map have moved."""


@dataclass(frozen=True, slots=True)
class Anchor:
    """A pose that is tied to a keyframe, so that it moves when loops are closed."""

    keyframe: int
    """The keyframe's number; -1: tied to the map frame itself."""
    keyframe_T_pose: Pose2D
    """The pose as seen from it."""
