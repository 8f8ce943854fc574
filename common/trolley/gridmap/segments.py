"""Lines across a grid, such as mirrors: as segments, clipped to it, and drawn."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D


def line_segments(
    lines: Sequence[Sequence[tuple[float, float]]], grid_T_map: Pose2D
) -> NDArray[np.float64]:
    """Return the segments (m, 4) x1, y1, x2, y2 [m] of lines, in `grid`."""
    segments = [np.empty((0, 4))]
    for line in lines:
        points = grid_T_map.transform_points(np.array(line, dtype=np.float64).reshape(-1, 2))
        segments.append(np.hstack([points[:-1], points[1:]]))
    return np.concatenate(segments)


def draw_segments(
    grid: NDArray[np.uint8], segments: NDArray[np.float64], resolution_m: float, value: int
) -> None:
    """Set every cell that a segment (m, 4) [m] passes.

    Points are set a quarter of a cell apart, so that a cell is left out only where the line cuts
    off a corner of less than that.
    """
    rows, cols = grid.shape
    size_m = cols * resolution_m, rows * resolution_m
    for segment in clip_segments(segments, size_m) / resolution_m:
        x1, y1, x2, y2 = (float(value) for value in segment)
        count = max(2, math.ceil(4.0 * math.hypot(x2 - x1, y2 - y1)) + 1)
        along_cols = np.floor(np.linspace(x1, x2, count)).astype(np.int64)
        along_rows = np.floor(np.linspace(y1, y2, count)).astype(np.int64)
        on_grid = (along_cols >= 0) & (along_cols < cols) & (along_rows >= 0) & (along_rows < rows)
        grid[along_rows[on_grid], along_cols[on_grid]] = value


def clip_segments(segments: NDArray[np.float64], size: tuple[float, float]) -> NDArray[np.float64]:
    """Return the parts of segments (m, 4) x1, y1, x2, y2 in the rectangle from 0, 0 to `size`.

    Whatever is stored as a mirror, what of it is drawn then is no longer than the map. Segments
    that lie wholly inside stay as they are.

    Source:
        Liang, Barsky, A new concept and method for line clipping (1984).
    """
    starts, ends = segments[:, :2], segments[:, 2:]
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        steps = ends - starts
        at_low, at_high = -starts / steps, (size - starts) / steps
        is_inside = (starts >= 0.0) & (starts <= size)
        # Along an axis that a segment does not move on, it is inside all the way or never.
        never = np.where(is_inside, -np.inf, np.inf)
        enters = np.where(steps == 0.0, never, np.minimum(at_low, at_high)).max(axis=1)
        leaves = np.where(steps == 0.0, -never, np.maximum(at_low, at_high)).min(axis=1)
    first, last = np.maximum(enters, 0.0), np.minimum(leaves, 1.0)
    kept = (first <= last) & np.isfinite(steps).all(axis=1)
    starts, ends, steps = starts[kept], ends[kept], steps[kept]
    first, last = first[kept, None], last[kept, None]
    return np.hstack([starts + first * steps, np.where(last == 1.0, ends, starts + last * steps)])
