"""What has been seen of a map: only what comes into view for the first time is new evidence."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley_localizer.matching.map_matcher import BeamSet


@dataclass(frozen=True, slots=True)
class SurfaceParams:
    """What counts as seen; set by hand."""

    block_m: float = 0.3
    """Edge of the blocks in which echoes are remembered, and distance within which what lies beside
    an echo counts as seen as well: beams meet far walls only here and there [m]."""
    least_blocks: int = 8
    """Number of new blocks below which a scan waits for more to come into view: people who walk by
    are new in each scan, but take no more than two or three."""


PARAMS = SurfaceParams()

_SPAN = 1 << 20
"""Number of blocks in a row: more than any map has."""
_AROUND = tuple(_SPAN * row + col for row in (-1, 0, 1) for col in (-1, 0, 1))


@dataclass(frozen=True, slots=True)
class NewSurface:
    """What a scan shows for the first time."""

    beams: BeamSet
    """The scan with only those beams that end there."""
    amount: float
    """How much it is, as a share of what the first scan showed, 0 ... 1."""


class SeenSurface:
    """The surface that scans have shown, if the robot is where it is believed to be.

    Args:
        resolution: cell edge [m].
    """

    def __init__(self, resolution: float) -> None:
        self._block = PARAMS.block_m / resolution
        self._seen: set[int] = set()
        self._first = 0

    def add(self, pose: NDArray[np.float64], beams: BeamSet) -> NewSurface | None:
        """Return what a scan shows for the first time, and take it in; None if it is too little.

        Args:
            pose: where it was taken (3,) x, y [cells], yaw [rad].
            beams: of the scan.
        """
        ends = beams.points(beams.used)
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        cols = np.floor((pose[0] + cos * ends.x - sin * ends.y) / self._block).astype(np.int64)
        rows = np.floor((pose[1] + sin * ends.x + cos * ends.y) / self._block).astype(np.int64)
        blocks, block_of_beam = np.unique(rows * _SPAN + cols, return_inverse=True)
        is_new = np.array([block not in self._seen for block in blocks.tolist()], bool)
        new = blocks[is_new].tolist()
        if self._first > 0 and len(new) < PARAMS.least_blocks:
            return None
        self._seen.update(block + step for block in new for step in _AROUND)
        self._first = self._first or len(new)
        amount = min(1.0, len(new) / max(self._first, 1))
        return NewSurface(beams.only_those(is_new[block_of_beam]), amount)
