"""What the mapper keeps of a scan that became part of the map."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.scan_matching.layout import Cloud
from trolley.scan_matching.sweep import Sweep


@dataclass(frozen=True, slots=True, eq=False)
class Keyframe:
    """The echoes of one scan; where it was taken stands in the pose graph.

    Attributes:
        number: its own for as long as the map lives, ascending.
        stamp_ns: robot time of the scan [ns].
        points: (n, 2) float32 in `base_link` at the stamp [m].
        normals: (n, 2) float32 of the surfaces, towards the laser; zero where unclear.
        laser: (2,) float32, where the laser was in `base_link` [m].
        floor: (m, 2) float32, places known to be free [m]; only of a map made before, which has no
            beams that show them.
    """

    number: int
    stamp_ns: int
    points: NDArray[np.float32]
    normals: NDArray[np.float32]
    laser: NDArray[np.float32]
    floor: NDArray[np.float32] | None = None

    @classmethod
    def of(cls, number: int, stamp_ns: int, sweep: Sweep) -> "Keyframe":
        """Keep a scan."""
        return cls(
            number,
            stamp_ns,
            sweep.cloud.points.astype(np.float32),
            sweep.cloud.normals.astype(np.float32),
            sweep.laser.astype(np.float32),
        )

    @property
    def is_blind(self) -> bool:
        """Whether it shows nothing: it was taken where the lidar was covered."""
        return len(self.points) == 0

    @property
    def is_prior(self) -> bool:
        """Whether it is an earlier map instead of a scan."""
        return self.floor is not None

    def cloud(self) -> Cloud:
        """Return the points as the kernels want those of a scan."""
        return Cloud(self.points.astype(np.float64), self.normals.astype(np.float64))

    @property
    def num_bytes(self) -> int:
        """Bytes that it takes, about."""
        floor = 0 if self.floor is None else self.floor.nbytes
        return self.points.nbytes + self.normals.nbytes + floor + 500
