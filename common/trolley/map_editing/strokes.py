"""Which cells a polygon covers, or a brush along its path."""

import math

import numpy as np
from numpy.typing import NDArray

from trolley import codes
from trolley.codes import Refused
from trolley.geometry.polygon import check_polygon
from trolley.gridmap import GridMap
from trolley.messages.editing import MAX_POINTS

Floats = NDArray[np.float64]
# A point may lie this far outside the map [cells]: beyond is a slip, not a stroke.
_FAR_CELLS = 1e5
# From here on a dab touches the cell that it lies in, and cells of a line have a side in common, so
# that no beam slips through a wall between two corners.
_LEAST_CELLS = math.sqrt(2.0)
# Long strokes are drawn in pieces, whose boxes are small [cells].
_PIECE_CELLS = 64.0
_MAX_PIECES = 20_000
_MAX_WORK = 300_000_000


def polygon_mask(grid: GridMap, points: list[tuple[float, float]]) -> NDArray[np.bool_]:
    """Return the cells (rows, cols) whose centres lie in a polygon.

    Args:
        grid: says where the cells are.
        points: the corners x, y [m] in `map`; closed by itself.

    Raises:
        Refused: it is not a polygon, or lies outside the map.

    Source:
        Foley et al., Computer Graphics, section 3.6: the even-odd rule by scan lines.
    """
    _checked(grid, points)
    try:
        corners = grid.world_to_grid(check_polygon(points)) / grid.resolution
    except ValueError as error:
        raise Refused(codes.BAD_REQUEST, f"{str(error)[:1].upper()}{str(error)[1:]}.") from error
    mask = np.zeros(grid.cells.shape, np.bool_)
    ends = np.roll(corners, -1, axis=0)
    centres = np.arange(grid.cols) + 0.5
    low = max(0, math.floor(corners[:, 1].min()))
    high = min(grid.rows, math.ceil(corners[:, 1].max()))
    for row in range(low, high):
        y = row + 0.5
        straddles = (corners[:, 1] > y) != (ends[:, 1] > y)
        a, b = corners[straddles], ends[straddles]
        crossings = np.sort(a[:, 0] + (y - a[:, 1]) * (b[:, 0] - a[:, 0]) / (b[:, 1] - a[:, 1]))
        mask[row] = np.searchsorted(crossings, centres) % 2 == 1
    return _touched(mask)


def stroke_mask(
    grid: GridMap, points: list[tuple[float, float]], width_m: float
) -> NDArray[np.bool_]:
    """Return the cells (rows, cols) whose centres a brush comes over.

    Args:
        grid: says where the cells are.
        points: the path of the brush's centre, x, y [m] in `map`; one point is a dab.
        width_m: of the brush [m]; a finer one is as wide as the diagonal of a cell.

    Raises:
        Refused: it lies outside the map, or is too long.
    """
    way = _checked(grid, points)
    half = 0.5 * max(width_m / grid.resolution, _LEAST_CELLS) + 1e-9
    if len(way) == 1:
        way = np.repeat(way, 2, axis=0)
    starts, ends = _pieces(way[:-1], way[1:])
    low = np.floor(np.minimum(starts, ends) - half).astype(np.int64)
    high = np.ceil(np.maximum(starts, ends) + half).astype(np.int64)
    low, high = np.maximum(low, 0), np.minimum(high, [grid.cols, grid.rows])
    sizes = np.maximum(high - low, 0)
    if int(np.prod(sizes, axis=1).sum()) > _MAX_WORK:
        raise Refused(codes.TOO_LARGE, "The stroke is too long and too wide.")
    mask = np.zeros(grid.cells.shape, np.bool_)
    for i in np.flatnonzero(sizes.all(axis=1)):
        (col0, row0), (col1, row1) = low[i].tolist(), high[i].tolist()
        x: Floats = np.arange(int(col0), int(col1), dtype=np.float64) + 0.5
        y: Floats = np.arange(int(row0), int(row1), dtype=np.float64) + 0.5
        mask[row0:row1, col0:col1] |= _near(x, y, starts[i], ends[i], half)
    return _touched(mask)


def _near(x: Floats, y: Floats, start: Floats, end: Floats, reach: float) -> NDArray[np.bool_]:
    """Say which points of a grid lie within reach of a segment, (len(y), len(x))."""
    across: Floats = (x - start[0])[None, :]
    up: Floats = (y - start[1])[:, None]
    step = end - start
    along: Floats = np.clip(
        (across * step[0] + up * step[1]) / max(float(step @ step), 1e-12), 0.0, 1.0
    )
    return (across - along * step[0]) ** 2 + (up - along * step[1]) ** 2 <= reach * reach


def _checked(grid: GridMap, points: list[tuple[float, float]]) -> Floats:
    """Return points (n, 2) x, y in cells."""
    if not 1 <= len(points) <= MAX_POINTS:
        raise Refused(codes.TOO_LARGE, f"A line can have 1 to {MAX_POINTS} points.")
    wanted = np.array(points, np.float64).reshape(-1, 2)
    if not np.isfinite(wanted).all():
        raise Refused(codes.BAD_REQUEST, "A point needs finite numbers.")
    cells = grid.world_to_grid(wanted) / grid.resolution
    if np.abs(cells).max() > _FAR_CELLS + max(grid.rows, grid.cols):
        raise Refused(codes.OUTSIDE_MAP, "A point lies far outside of the map.")
    return cells


def _pieces(starts: Floats, ends: Floats) -> tuple[Floats, Floats]:
    """Cut segments (n, 2) into pieces whose boxes are small."""
    lengths = np.hypot(*(ends - starts).T)
    counts = np.maximum(np.ceil(lengths / _PIECE_CELLS), 1.0).astype(np.int64)
    if counts.sum() > _MAX_PIECES:
        raise Refused(codes.TOO_LARGE, "The stroke is too long.")
    which = np.repeat(np.arange(len(starts)), counts)
    number = np.arange(len(which)) - np.repeat(np.cumsum(counts) - counts, counts)
    steps = (ends - starts) / counts[:, None]
    begins = starts[which] + number[:, None] * steps[which]
    return begins, begins + steps[which]


def _touched(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    if not mask.any():
        raise Refused(codes.OUTSIDE_MAP, "What was drawn touches no cell of the map.")
    return mask
