"""One scan and the odometry that belongs to it, as beams in `base_link`."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.scan_input import ScanInput
from trolley_localizer.kernels import beams as kernels
from trolley_localizer.kernels.layout import Points

# Shorter beams end near any wall that the robot stands at: they tell little of where it is [m].
_TELLING_M = 0.5
# A scan with fewer telling beams, or a smaller share of them, says nothing (a covered lidar).
_MIN_TELLING = 15
_MIN_TELLING_SHARE = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class BeamSet:
    """The beams of a scan in `base_link` at its stamp, corrected for the motion during the scan.

    Attributes:
        end: (n,) end points of all beams [cells].
        start: (n,) where the laser was for each [cells].
        classes: (n,) uint8: UNUSED where there is no echo, else NOT_ON_MAP until judged.
        used: (m,) int64, indices of beams that may be matched with the map.
        is_blind: the scan holds too little to compare it with a map.
    """

    end: Points
    start: Points
    classes: NDArray[np.uint8]
    used: NDArray[np.int64]
    is_blind: bool

    def points(self, index: NDArray[np.int64]) -> Points:
        """Return the end points of some beams."""
        return Points(self.end.x[index], self.end.y[index])

    def spread(self, count: int, phase: float = 0.5) -> Points:
        """Return at most `count` used end points, evenly over the scan.

        Args:
            count: how many at most.
            phase: 0 ... 1, shifts the choice between neighbours.
        """
        size = self.used.size
        if size <= count:
            return self.points(self.used)
        chosen = ((np.arange(count) + phase) * (size / count)).astype(np.int64)
        return self.points(self.used[np.minimum(chosen, size - 1)])

    def only(self, classes: NDArray[np.uint8], used: NDArray[np.int64]) -> "BeamSet":
        """Return the same beams with other classes, fewer of them used."""
        return BeamSet(self.end, self.start, classes, used, self.is_blind)


def read_beams(scan: ScanInput, resolution: float, max_range_m: float) -> BeamSet:
    """Project a scan into `base_link`, in cells of `resolution` [m]."""
    ranges = np.require(scan.ranges, np.float32, ["C", "W"])
    count = ranges.size
    end = Points(np.empty(count), np.empty(count))
    start = Points(np.empty(count), np.empty(count))
    used = np.empty(count, np.uint8)
    # The nearest float32 above 0, so that "invalid" is below the limit.
    nearest = max(scan.range_min, 1e-6)
    kernels.project_beams(
        end,
        start,
        used,
        ranges,
        np.array([scan.angle_min, scan.angle_increment]),
        np.array([nearest, min(scan.range_max, max_range_m), resolution]),
        scan.base_T_laser.as_array(),
        (scan.odom_T_base.inverse() @ scan.odom_T_base_end).as_array(),
    )
    classes = np.where(used == 1, kernels.NOT_ON_MAP, kernels.UNUSED).astype(np.uint8)
    index = np.flatnonzero(used)
    telling = int(np.count_nonzero(ranges[index] > _TELLING_M))
    is_blind = telling < max(_MIN_TELLING, _MIN_TELLING_SHARE * index.size)
    return BeamSet(end, start, classes, index, is_blind)
