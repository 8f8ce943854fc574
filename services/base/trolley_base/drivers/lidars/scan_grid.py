"""Samples of one revolution into the evenly spaced beams of a scan.

The grid follows the samples: its step is theirs, and it begins where they do, so that the beams of
an evenly sampling sensor lie exactly where it looked. Angles are in degrees and grow as the sensor
turns; 0 is its zero direction.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

SLACK = 0.5
"""A grid may begin this part of a step later than a beam after zero: at the seam of two turns
uneven samples are a little farther apart."""
CLOSE = 1e-3
"""A turn that differs from a whole number of steps by less than this is one."""
BESIDE = 0.25
"""A sample this far beside its beam [steps] may stand for the beam on its other side too, where
that has none of its own."""


class Grid(NamedTuple):
    """Where beams lie: beam j at `first_deg` + j * `step_deg`."""

    first_deg: float
    step_deg: float
    beams: int

    def angles_deg(self) -> Floats:
        """Return the angles of all beams."""
        return self.first_deg + self.step_deg * np.arange(self.beams, dtype=np.float64)


def fit_grid(count: Indices, angle_deg: Floats) -> Grid | None:
    """Find the grid of a revolution.

    Args:
        count: (n,) number of each sample as fired, gaps counted, not falling.
        angle_deg: (n,) where it looked, unwrapped.

    Returns:
        None where the samples do not turn evenly enough to tell a step.

    Source:
        A line fitted by least squares to the angles over the counts.
    """
    if len(count) < 2 or count[-1] == count[0]:
        return None
    centred = count - count.mean()
    step = float(centred @ angle_deg / (centred @ centred))
    if not 0.02 <= step <= 30.0:
        return None
    start = float(angle_deg.mean() - step * count.mean())
    first = start + step * float(np.rint((angle_deg.min() - start) / step))
    # What was lost at the beginning of a revolution is part of it.
    first -= step * max(0, math.ceil(first / step - 1.0 - SLACK))
    turn = 360.0 / step
    reached = int(np.rint((angle_deg.max() - first) / step)) + 1
    beams = min(max(reached, math.floor(turn + CLOSE)), math.ceil(turn - CLOSE))
    return Grid(first, step, beams)


def place(
    grid: Grid, angle_deg: Floats, range_m: Floats, intensity: Floats
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Sort samples into beams; of several in one, the nearest echo counts.

    Args:
        grid: of the beams.
        angle_deg: (n,) where each sample looked.
        range_m: (n,) +inf nothing in reach, 0 invalid.
        intensity: (n,) or (0,).

    Returns:
        Ranges (beams,), 0 where there is no sample, and intensities (beams,) or (0,).
    """
    position = (angle_deg - grid.first_deg) / grid.step_deg
    turn = 360.0 / grid.step_deg
    position = np.where(position >= grid.beams - 0.5, position - turn, position)
    position = np.where(position < -0.5, position + turn, position)
    beam = np.clip(np.rint(position), 0, grid.beams - 1).astype(np.int64)
    beside = position - beam
    other = (beam + np.where(np.abs(beside) > BESIDE, np.sign(beside), 0.0)).astype(np.int64)
    # Least worth first: what is assigned last stays.
    worth = np.where(np.isinf(range_m), 1e6, np.where(range_m > 0.0, range_m, 1e9))
    order = np.argsort(-worth, kind="stable")
    source = np.full(grid.beams, -1)
    source[other[order] % grid.beams] = order
    source[beam[order]] = order
    is_hit = source >= 0
    ranges = np.where(is_hit, range_m[source], 0.0).astype(np.float32)
    if not len(intensity):
        return ranges, np.empty(0, np.float32)
    return ranges, np.where(is_hit, intensity[source], 0.0).astype(np.float32)
