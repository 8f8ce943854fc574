"""What a program may drive over that the lidar does not see just now, and how fast.

`base` holds every program to it, and the planner, which knows it, does not try what `base` will not
let it do. A lidar that looks all round sees everything near just now.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class SightParams:
    """How long floor counts as free that nobody looks at; set by hand."""

    fresh_s: float = 3.0
    """What nobody has looked at for longer than this may have been stepped onto: it counts as
    free, but is driven over at a creep only [s]."""
    memory_s: float = 30.0
    """What was seen to be free and lies out of view now, as behind a lidar that looks ahead only,
    counts as free for this long: recovering from a dead end takes that long [s]."""
    trail_s: float = 120.0
    """Where the robot itself stood counts as free for this long: a robot that waited at a place
    may leave as it came [s]."""
    creep_mps: float = 0.1
    """Speed at a creep, or that of a turn with the same energy: what is met at it is pushed, and
    can be stepped away from. The corners of a box move at 0.17 m/s in such a turn [m/s]."""
    hidden_rad: float = 0.35
    """Angle without any beam from which on a lidar does not look all round: half a metre from it,
    something as wide as a small robot goes unseen; four thin posts do not count [rad]."""


SIGHT = SightParams()


def looks_all_round(looks: NDArray[np.bool_], step_rad: float) -> bool:
    """Say whether a lidar looks everywhere around itself, but for gaps as narrow as a post.

    Args:
        looks: (n,) whether its beams measure; not where the robot's own body is masked.
        step_rad: angle from one beam to the next.
    """
    if not looks.any():
        return False
    beyond = max(0, round((2.0 * math.pi - len(looks) * step_rad) / step_rad))
    around = np.flatnonzero(np.concatenate([looks, np.zeros(beyond, np.bool_)]))
    gaps = np.diff(around, append=around[0] + len(looks) + beyond) - 1
    return bool(gaps.max() * step_rad < SIGHT.hidden_rad)
