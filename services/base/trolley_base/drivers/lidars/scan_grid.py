"""Samples of one revolution into the evenly spaced beams of a scan.

The grid follows the samples: its step is theirs, and it begins where they do, so that the beams of
an evenly sampling sensor lie exactly where it looked. A sensor that triangulates looks beside them:
there a beam gets the range at which it meets the line through two samples of one surface. Angles
are in degrees and grow as the sensor turns; 0 is its zero direction.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
Flags = NDArray[np.bool_]

SLACK = 0.5
"""A grid may begin this part of a step later than a beam after zero: at the seam of two turns
uneven samples are a little farther apart."""
CLOSE = 1e-3
"""A turn that differs from a whole number of steps by less than this is one."""
BESIDE = 0.25
"""A sample this far beside its beam [steps] may stand for the beam on its other side too, where
that has none of its own."""
STRAIGHT = 0.005
"""Three samples are on one surface where the middle one is beside the line through its neighbours
by at most this share of its range. A step in depth puts it beside by half the step, so none of more
than 1 % of the range is bridged; a sensor's noise may be as much, and then its samples stay as they
are."""
NEXT = 2.0
"""Samples farther apart than this [steps] are no neighbours: something between them was lost."""
STEEPEST = 2.0
"""No sample is moved to a beam where its surface would be farther or nearer by this factor."""


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
        angle_deg: (n,) where each sample looked, in the order in which they were measured.
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
    hit = np.flatnonzero(source >= 0)
    ranges = np.zeros(grid.beams, np.float32)
    # How far the beam is from where the sample looked.
    off = np.remainder(hit - position[source[hit]] + 0.5 * turn, turn).astype(np.float64)
    ranges[hit] = _ranges_beside(angle_deg, range_m, grid.step_deg, source[hit], off - 0.5 * turn)
    intensities = np.zeros(grid.beams if len(intensity) else 0, np.float32)
    if len(intensity):
        intensities[hit] = intensity[source[hit]]
    return ranges, intensities


def _ranges_beside(
    angle_deg: Floats, range_m: Floats, step_deg: float, source: Indices, off: Floats
) -> Floats:
    """Return the ranges that samples would have had a little beside where they looked.

    Args:
        angle_deg: (n,) where each looked.
        range_m: (n,) +inf nothing in reach, 0 invalid.
        step_deg: between two samples.
        source: (m,) which of them.
        off: (m,) how far beside it [steps].

    Returns:
        (m,) that of the line through the sample and its neighbour on that side; through the other
        neighbour, where the first is on no surface with it; the sample's own, where neither is.

    Source:
        In polar coordinates a line is 1 / r = a cos(angle) + b sin(angle).
    """
    own = range_m[source]
    gap_deg = np.diff(angle_deg)
    is_next = _are_on_one_surface(gap_deg, range_m, step_deg)
    # Of each sample: whether the one before it is on its surface, and whether the one after it is.
    has_before, has_after = np.append(False, is_next)[source], np.append(is_next, False)[source]
    goes_on = np.where(off > 0.0, has_after, ~has_before & has_after)
    can_move = (has_before | has_after) & (off != 0.0)
    neighbour = np.where(can_move, np.where(goes_on, source + 1, source - 1), source)
    apart = np.where(can_move, np.radians(angle_deg[neighbour] - angle_deg[source]), 1.0)
    inverse, to_beam = 1.0 / np.where(can_move, own, 1.0), np.radians(off * step_deg)
    beside = 1.0 / np.where(can_move, range_m[neighbour], 1.0)
    # 1 / r at the beam, over 1 / r of the sample.
    slope = (beside / inverse - np.cos(apart)) / np.sin(apart)
    nearer = np.cos(to_beam) + np.sin(to_beam) * slope
    can_move &= (nearer < STEEPEST) & (nearer > 1.0 / STEEPEST)
    return np.where(can_move, own / np.where(can_move, nearer, 1.0), own)


def _are_on_one_surface(gap_deg: Floats, range_m: Floats, step_deg: float) -> Flags:
    """Say of each sample but the last whether it and the next are on a straight piece of surface.

    Two samples alone do not tell a step in depth from a wall that is seen at a flat angle, so both
    must be on one line with the sample before them or the one behind them.
    """
    is_pair = (gap_deg > 0.0) & (gap_deg <= NEXT * step_deg)
    is_echo = (range_m > 0.0) & np.isfinite(range_m)
    is_pair &= is_echo[:-1] & is_echo[1:]
    if len(range_m) < 3:
        return np.zeros_like(is_pair)
    inverse, gap = 1.0 / np.where(is_echo, range_m, 1.0), np.radians(gap_deg)
    is_three = is_pair[:-1] & is_pair[1:]
    width = np.where(is_three, gap[:-1] + gap[1:], 1.0)
    on_line = (inverse[:-2] * np.sin(gap[1:]) + inverse[2:] * np.sin(gap[:-1])) / np.sin(width)
    is_three &= np.abs(on_line / inverse[1:-1] - 1.0) <= STRAIGHT
    return np.append(is_three, False) | np.append(False, is_three)
