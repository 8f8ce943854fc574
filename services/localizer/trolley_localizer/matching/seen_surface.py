"""What has been seen of a map, and whether what comes into view is where the map says."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley_localizer.kernels.matching import expect_walls, mark_known
from trolley_localizer.matching.likelihood_field import LikelihoodField
from trolley_localizer.matching.map_matcher import BeamSet


@dataclass(frozen=True, slots=True)
class SurfaceParams:
    """What counts as seen, and as where the map says; set by hand."""

    block_m: float = 0.3
    """Edge of the blocks in which surface is remembered, and distance within which what lies beside
    it counts as seen as well: beams meet far walls only here and there [m]."""
    reach_m: float = 12.0
    """Distance up to which a wall of the map is expected to be seen [m]."""
    agree_m: float = 0.3
    """Difference in range within which a beam ended where the map says [m]."""
    least_blocks: int = 8
    """Number of new blocks below which a scan waits for more to come into view: somebody who walks
    by covers no more than two or three."""
    common_blocks: int = 20
    """Number of blocks that tell nothing of the place: two walls and their corner are alike in many
    rooms."""
    telling_blocks: int = 50
    """Number of blocks from which on what was seen tells the place from all others; with fewer it
    does so in proportion. On maps of other houses the robot was mostly sure of places of which it
    saw 12 to 38, with 180 degrees of view 25 to 34; at right ones it mostly sees more than 50."""


PARAMS = SurfaceParams()

_SPAN = 1 << 20
"""Number of blocks in a row: more than any map has."""
_AROUND = tuple(_SPAN * row + col for row in (-1, 0, 1) for col in (-1, 0, 1))


@dataclass(frozen=True, slots=True)
class NewSurface:
    """What a scan shows for the first time, or should have."""

    amount: float
    """How much it is, as a share of what the first scan showed, 0 ... 1."""
    agreement: float
    """Share of its beams that ended where the map says, 0 ... 1."""


NOTHING_NEW = NewSurface(0.0, 0.0)


class SeenSurface:
    """The surface that scans have shown, if the robot is where it is believed to be.

    Args:
        field: of the map.
    """

    def __init__(self, field: LikelihoodField) -> None:
        self._field = field
        self._block = PARAMS.block_m / field.resolution
        self._seen: set[int] = set()
        self._first = 0
        self._shown = 0

    @property
    def extent(self) -> float:
        """How much was seen, as a share of what tells a place from all others, 0 ... 1."""
        telling = self._shown - PARAMS.common_blocks
        return min(1.0, max(0.0, telling / (PARAMS.telling_blocks - PARAMS.common_blocks)))

    def add(self, pose: NDArray[np.float64], beams: BeamSet) -> NewSurface:
        """Return what a scan shows that none before has shown, and take it in.

        A beam shows something new where the map has a wall for it that was not seen, or where it
        went through the one that was. What stands in front of a wall, people and furniture, does
        not count, nor does what the map does not know: behind a door that was shut, too.

        Args:
            pose: where it was taken (3,) x, y [cells], yaw [rad].
            beams: of the scan.
        """
        ends, starts = beams.points(beams.used), beams.starts(beams.used)
        field, resolution = self._field, self._field.resolution
        x, y, lead = np.empty((3, ends.x.size))
        limit = PARAMS.reach_m / resolution
        expect_walls(x, y, lead, pose, ends, starts, field.distance, limit)
        is_known = np.empty(ends.x.size, np.uint8)
        mark_known(is_known, field.known, ends, pose)
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        expected = self._blocks(x, y)
        met = self._blocks(
            pose[0] + cos * ends.x - sin * ends.y, pose[1] + sin * ends.x + cos * ends.y
        )
        slack = PARAMS.agree_m / resolution
        is_unseen = self._is_unseen(expected)
        is_behind = (lead < -slack) & (is_known != 0) & self._is_unseen(met)
        is_new = (lead <= slack) & (is_unseen | is_behind)
        new = np.unique(np.where(is_unseen, expected, met)[is_new]).tolist()
        if self._first > 0 and len(new) < PARAMS.least_blocks:
            return NOTHING_NEW
        self._shown += len(new)
        # A wall that beams went through at a few places may be there at others.
        is_through = lead < -slack
        stopped = {*expected[is_new & ~is_through].tolist(), *met[is_new].tolist()}
        self._seen.update(block + step for block in stopped for step in _AROUND)
        if self._first > 0:
            self._seen.update(expected[is_new & is_through].tolist())
        self._first = self._first or max(len(new), PARAMS.least_blocks)
        agreement = float(np.mean(np.abs(lead[is_new]) <= slack)) if new else 0.0
        return NewSurface(min(1.0, len(new) / self._first), agreement)

    def _blocks(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return the blocks in which points (n,) [cells] lie."""
        rows, cols = np.floor(y / self._block), np.floor(x / self._block)
        return (rows * _SPAN + cols).astype(np.int64)

    def _is_unseen(self, blocks: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Say which blocks none of the scans has shown."""
        return np.array([block not in self._seen for block in blocks.tolist()], bool)
