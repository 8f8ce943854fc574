"""The cells of one grid as another one has them that lies elsewhere, turned or coarser."""

import math

import numpy as np
from numpy.typing import NDArray

from trolley import codes
from trolley.codes import Refused
from trolley.geometry import Pose2D
from trolley.gridmap import MAX_CELLS, OCCUPIED_FROM, UNKNOWN, GridMap

Floats = NDArray[np.float64]
Cells = NDArray[np.int8]
# Cells that are worked on at once: what is needed for each of them is some hundred bytes.
_CHUNK = 1 << 18
_SIDE = 4
# A cell is wall if this many of its 4 x 4 samples are: with 4 a row of cells that touch at their
# corners, turned by 45 degrees and halfway between two rows, would fall apart.
_WALL_SAMPLES = 3


def check_size(rows: int, cols: int) -> None:
    """Refuse a grid that would be too large.

    Raises:
        Refused: `too_large`.
    """
    if rows * cols > MAX_CELLS:
        raise Refused(
            codes.TOO_LARGE,
            f"The map would have {cols} x {rows} cells; {MAX_CELLS} is the most. Crop it first.",
        )


def known_box(cells: Cells) -> tuple[int, int, int, int]:
    """Return row0, row1, col0, col1 of the part that holds all known cells.

    Raises:
        Refused: `bad_request`, nothing is known.
    """
    rows = np.flatnonzero((cells != UNKNOWN).any(axis=1))
    cols = np.flatnonzero((cells != UNKNOWN).any(axis=0))
    if not len(rows):
        raise Refused(codes.BAD_REQUEST, "Nothing of the map would be left.")
    return int(rows[0]), int(rows[-1]) + 1, int(cols[0]), int(cols[-1]) + 1


def part_of(grid: GridMap, box: tuple[int, int, int, int]) -> GridMap:
    """Return a part of a grid, a view of its cells; they stay where they are in `map`."""
    row0, row1, col0, col1 = box
    shift = Pose2D(col0 * grid.resolution, row0 * grid.resolution, 0.0)
    return GridMap(
        grid.name, grid.resolution, grid.origin @ shift, grid.cells[row0:row1, col0:col1]
    )


def resample(source: GridMap, frame_T_source: Pose2D, target: GridMap) -> Cells:
    """Return the cells of `source` as `target` would hold them, -1 where there are none.

    Each cell takes the value under its centre, but walls are never lost: a cell is wall where
    three sixteenths of it are, so walls grow by about half a cell in all.

    Args:
        source: the cells.
        frame_T_source: maps points of the source's map frame to the frame that `target` lies in.
        target: says where the new cells are; its own cells do not matter.

    Returns:
        (rows, cols) of the target, int8.
    """
    source_T_target = (frame_T_source @ source.origin).inverse() @ target.origin
    ratio = target.resolution / source.resolution
    walls = source.cells >= OCCUPIED_FROM
    near_walls = _grown(walls, math.ceil(0.71 * ratio + 0.5))
    out = np.full(target.cells.shape, UNKNOWN, np.int8)
    step = max(1, _CHUNK // target.cols)
    for row0 in range(0, target.rows, step):
        row1 = min(row0 + step, target.rows)
        rows, cols = np.mgrid[row0:row1, : target.cols]
        centres = np.column_stack([cols.ravel(), rows.ravel()]) + 0.5
        points = _in_source(centres, source_T_target, target, source)
        values = _values_at(source.cells, points)
        close = np.flatnonzero(_values_at(near_walls.view(np.int8), points, 1) == 1)
        values[close] = _with_walls(source, values[close], centres[close], source_T_target, target)
        out[row0:row1] = values.reshape(row1 - row0, target.cols)
    if ratio > 1.3:  # samples that lie further apart than a wall is thick would miss it
        _splat(out, source, walls, source_T_target.inverse(), target)
    return out


def _in_source(points: Floats, source_T_target: Pose2D, target: GridMap, source: GridMap) -> Floats:
    """Return points (n, 2) x, y in cells of the target in cells of the source."""
    return source_T_target.transform_points(points * target.resolution) / source.resolution


def _values_at(cells: Cells, points: Floats, outside: int = UNKNOWN) -> Cells:
    """Return the values under points (n, 2) x, y in cells, (n,)."""
    index = np.floor(points).astype(np.int64)
    cols, rows = index[:, 0], index[:, 1]
    inside = (rows >= 0) & (rows < cells.shape[0]) & (cols >= 0) & (cols < cells.shape[1])
    values = np.full(len(points), outside, np.int8)
    values[inside] = cells[rows[inside], cols[inside]]
    return values


def _with_walls(
    source: GridMap, values: Cells, centres: Floats, source_T_target: Pose2D, target: GridMap
) -> Cells:
    """Return values (n,) of cells near walls, with those made wall that are so in part."""
    offsets = (np.arange(_SIDE) + 0.5) / _SIDE - 0.5
    count = np.zeros(len(values), np.int64)
    most = values.copy()
    for dx in offsets:
        for dy in offsets:
            points = _in_source(centres + np.array((dx, dy)), source_T_target, target, source)
            found = _values_at(source.cells, points)
            is_wall = found >= OCCUPIED_FROM
            count += is_wall
            most = np.where(is_wall, np.maximum(most, found), most)
    return np.where(count >= _WALL_SAMPLES, most, values).astype(np.int8)


def _splat(
    out: Cells, source: GridMap, walls: NDArray[np.bool_], target_T_source: Pose2D, target: GridMap
) -> None:
    """Make each cell wall that the centre of a wall's cell lies in."""
    found = np.argwhere(walls)
    centres = (found[:, ::-1] + 0.5) * source.resolution
    index = np.floor(target_T_source.transform_points(centres) / target.resolution)
    cols, rows = index.astype(np.int64).T
    inside = (rows >= 0) & (rows < target.rows) & (cols >= 0) & (cols < target.cols)
    values = source.cells[found[:, 0], found[:, 1]]
    np.maximum.at(out, (rows[inside], cols[inside]), values[inside])


def _grown(mask: NDArray[np.bool_], reach: int) -> NDArray[np.bool_]:
    """Return a mask with all cells set that lie within `reach` rows and columns of a set one."""
    grown = mask.copy()
    for _ in range(reach):
        wider = grown.copy()
        wider[1:] |= grown[:-1]
        wider[:-1] |= grown[1:]
        grown = wider.copy()
        grown[:, 1:] |= wider[:, :-1]
        grown[:, :-1] |= wider[:, 1:]
    return grown
