"""One scan and the odometry that belongs to it, as beams in `base_link`."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.scanning.deskew import Points, deskew, is_blind
from trolley.scanning.front_end import FrontEndParams, ScanInput
from trolley_localizer.kernels.beams import NOT_ON_MAP, UNUSED

FRONT_END = FrontEndParams(
    # The nearest float32 above 0, so that "invalid" is below the limit.
    least_range_m=1e-6,
    usable_range_share=1.0,
    telling_range_m=0.5,
    min_telling_share=0.1,
)


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
    """Deskew a scan into `base_link`, in cells of `resolution` [m]."""
    seen = deskew(scan, FRONT_END, max_range_m, resolution)
    classes = np.full(scan.ranges.size, UNUSED, np.uint8)
    classes[seen.echoes] = NOT_ON_MAP
    blind = is_blind(scan.ranges[seen.echoes], FRONT_END)
    return BeamSet(seen.ends, seen.starts, classes, seen.echoes, blind)
