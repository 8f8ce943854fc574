"""A revolution of the lidar as arrays, for programs; the wire has it as bytes."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from trolley.messages.sensing import Scan
from trolley.messages.types import floats_from_bytes


def is_echo(ranges: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Return which ranges (n,) were measured: neither without an echo nor invalid."""
    return np.isfinite(ranges) & (ranges > 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class LaserScan:
    """One revolution of the lidar; beams go counter-clockwise. The arrays may be read-only."""

    stamp_ns: int
    """Robot time of the first beam [ns]."""
    frame: str
    """The lidar's frame, `laser`."""
    angles: NDArray[np.float64]
    """(n,) direction of each beam in `frame` [rad], 0 = its x axis."""
    ranges: NDArray[np.float32]
    """(n,) distance of each echo [m]: no echo is +inf, invalid is 0."""
    intensities: NDArray[np.float32]
    """(n,) strength of each echo in the lidar's own unit; (0,) if the lidar does not tell."""
    range_min: float
    """Nearest echo that the lidar can measure [m]."""
    range_max: float
    """Farthest echo that the lidar can measure [m]."""

    @classmethod
    def of(cls, scan: Scan) -> Self:
        """The arrays of a message of the wire, without copying the ranges."""
        ranges = floats_from_bytes(scan.ranges)
        return cls(
            stamp_ns=scan.stamp_ns,
            frame=scan.frame,
            angles=scan.angle_min + scan.angle_increment * np.arange(len(ranges), dtype=np.float64),
            ranges=ranges,
            intensities=floats_from_bytes(scan.intensities),
            range_min=scan.range_min,
            range_max=scan.range_max,
        )

    def points(self) -> NDArray[np.float64]:
        """The echoes as points (k, 2) x, y [m] in `frame`, without beams that have none."""
        seen = is_echo(self.ranges)
        angles, ranges = self.angles[seen], self.ranges[seen].astype(np.float64)
        return np.stack([ranges * np.cos(angles), ranges * np.sin(angles)], axis=-1)
