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
SECTORS = 360
SECTOR_RAD = 2.0 * math.pi / SECTORS


class LidarView:
    """Where a lidar ever measured: elsewhere it does not look, or sees only the robot itself.

    A beam of which nothing comes back just now, as from black furniture, is no end of its view.
    """

    def __init__(self) -> None:
        self._looks = np.zeros(SECTORS, np.bool_)

    def note(self, ranges_m: NDArray[np.float32], angle_min: float, angle_increment: float) -> None:
        """Take in a scan.

        Args:
            ranges_m: (n,) 0 or NaN where a beam did not measure.
            angle_min: of beam 0 in `laser` [rad].
            angle_increment: from one beam to the next [rad].
        """
        angles = angle_min + np.flatnonzero(ranges_m > 0.0) * angle_increment
        self._looks[np.floor(angles / SECTOR_RAD).astype(np.int64) % SECTORS] = True

    @property
    def widest_gap_rad(self) -> float:
        """The widest angle without any beam [rad]."""
        looks = np.flatnonzero(self._looks)
        if not looks.size:
            return 2.0 * math.pi
        gaps = np.diff(looks, append=looks[0] + SECTORS) - 1
        return float(gaps.max()) * SECTOR_RAD

    @property
    def is_all_round(self) -> bool:
        """Whether it looks everywhere around itself, but for gaps as narrow as a post."""
        return self.widest_gap_rad < SIGHT.hidden_rad
