"""Operations on a map, one after another."""

import math

import numpy as np

from trolley import codes
from trolley.codes import Refused
from trolley.geometry import Pose2D, angle_problem
from trolley.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from trolley.map_editing.resample import check_size, known_box, part_of, resample
from trolley.map_editing.strokes import polygon_mask, stroke_mask
from trolley.messages.editing import Crop, DrawWall, EraseArea, EraseStroke, MapOp, Turn
from trolley.messages.mapping import MAX_COORDINATE_M

_VALUES = {"free": FREE, "unknown": UNKNOWN}


def apply(grid: GridMap, op: MapOp) -> tuple[GridMap, Pose2D]:
    """Do one operation that needs no other map.

    Args:
        grid: the map; it is left as it is.
        op: what to do.

    Returns:
        The new map, and old_T_new, which maps its points to those of the old one.

    Raises:
        Refused: with the reason; among others `outside_map` and `too_large`.
    """
    same = Pose2D.identity()
    match op:
        case EraseArea():
            return _painted(grid, polygon_mask(grid, op.points), _VALUES[op.to]), same
        case EraseStroke():
            mask = stroke_mask(grid, op.points, op.width)
            return _painted(grid, mask, _VALUES[op.to]), same
        case DrawWall():
            mask = stroke_mask(grid, op.points, op.width)
            return _painted(grid, mask, OCCUPIED), same
        case Turn():
            return turn(grid, op.angle, op.about)
        case Crop():
            return crop(grid, *op.corners), same
        case _:
            raise Refused(codes.BAD_REQUEST, "That cannot be done to a map alone.")


def turn(
    grid: GridMap, angle: float, about: tuple[float, float] = (0.0, 0.0)
) -> tuple[GridMap, Pose2D]:
    """Turn a map about a point of its frame; the cells run along the axes afterwards.

    Args:
        grid: the map.
        angle: counter-clockwise [rad].
        about: x, y [m] in `map`.

    Returns:
        The turned map, trimmed to what is known, and old_T_new.

    Raises:
        Refused: numbers that are not finite, more than a full turn, or the map would be too large.
    """
    _refuse_odd_angle(angle)
    _refuse_odd_numbers(*about)
    x, y = about
    new_T_old = Pose2D(x, y, angle).wrapped() @ Pose2D(-x, -y, 0.0)
    known = part_of(grid, known_box(grid.cells))
    corners = new_T_old.transform_points(known.corners())
    low = corners.min(axis=0)
    _refuse_odd_numbers(*low.tolist())
    size = np.ceil((corners.max(axis=0) - low) / grid.resolution - 1e-6).astype(np.int64)
    cols, rows = (max(1, int(one)) for one in size)
    check_size(rows, cols)
    origin = Pose2D(float(low[0]), float(low[1]), 0.0)
    place = GridMap(grid.name, grid.resolution, origin, np.full((rows, cols), UNKNOWN, np.int8))
    turned = GridMap(grid.name, grid.resolution, origin, resample(known, new_T_old, place))
    return _own(part_of(turned, known_box(turned.cells))), new_T_old.inverse()


def crop(grid: GridMap, a: tuple[float, float], b: tuple[float, float]) -> GridMap:
    """Keep the cells whose centres lie in a rectangle.

    Args:
        grid: the map.
        a: one corner x, y [m] in `map`.
        b: the opposite one.

    Raises:
        Refused: there is nothing of the map in it.
    """
    _refuse_odd_numbers(*a, *b)
    (x0, x1), (y0, y1) = sorted((a[0], b[0])), sorted((a[1], b[1]))
    cols, rows = np.arange(grid.cols) + 0.5, np.arange(grid.rows) + 0.5
    cos, sin = math.cos(grid.origin.yaw), math.sin(grid.origin.yaw)
    x = grid.origin.x + grid.resolution * (cos * cols[None, :] - sin * rows[:, None])
    y = grid.origin.y + grid.resolution * (sin * cols[None, :] + cos * rows[:, None])
    inside = (x >= x0) & (x <= x1) & (y >= y0) & (y <= y1)
    if not inside.any():
        raise Refused(codes.OUTSIDE_MAP, "That rectangle contains nothing of the map.")
    cells = np.where(inside, grid.cells, np.int8(UNKNOWN))
    known_box(cells)  # refuses a map without anything on it
    held_rows, held_cols = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
    box = (int(held_rows[0]), int(held_rows[-1]) + 1, int(held_cols[0]), int(held_cols[-1]) + 1)
    return _own(part_of(GridMap(grid.name, grid.resolution, grid.origin, cells), box))


def merge(grid: GridMap, other: GridMap, this_T_other: Pose2D) -> GridMap:
    """Fill in from another map what this one does not know; what it knows stays.

    Args:
        grid: this map.
        other: the other one, of any resolution.
        this_T_other: where it lies: maps points of its frame to this map's.

    Raises:
        Refused: the map would be too large, or the pose is out of this world.
    """
    _refuse_odd_angle(this_T_other.yaw)
    _refuse_odd_numbers(this_T_other.x, this_T_other.y)
    known = part_of(other, known_box(other.cells))
    corners = grid.world_to_grid(this_T_other.transform_points(known.corners())) / grid.resolution
    col0, row0 = np.minimum(np.floor(corners.min(axis=0) + 1e-6), 0).astype(np.int64).tolist()
    far = np.ceil(corners.max(axis=0) - 1e-6)
    col1, row1 = np.maximum(far, [grid.cols, grid.rows]).astype(np.int64).tolist()
    check_size(row1 - row0, col1 - col0)
    cells = np.full((row1 - row0, col1 - col0), UNKNOWN, np.int8)
    shift = Pose2D(col0 * grid.resolution, row0 * grid.resolution, 0.0)
    place = GridMap(grid.name, grid.resolution, grid.origin @ shift, cells)
    cells = resample(known, this_T_other, place)
    mine = cells[-row0 : grid.rows - row0, -col0 : grid.cols - col0]
    mine[...] = np.where(grid.cells != UNKNOWN, grid.cells, mine)
    return GridMap(grid.name, grid.resolution, place.origin, cells)


def _painted(
    grid: GridMap, mask: np.ndarray[tuple[int, ...], np.dtype[np.bool_]], value: int
) -> GridMap:
    cells = np.where(mask, np.int8(value), grid.cells)
    return GridMap(grid.name, grid.resolution, grid.origin, cells)


def _own(grid: GridMap) -> GridMap:
    """Return a grid whose cells are no view of larger ones."""
    return GridMap(grid.name, grid.resolution, grid.origin, grid.cells.copy())


def _refuse_odd_numbers(*values: float) -> None:
    if not all(math.isfinite(value) for value in values):
        raise Refused(codes.BAD_REQUEST, "Numbers must be finite.")
    if max(abs(value) for value in values) > MAX_COORDINATE_M:
        raise Refused(codes.OUTSIDE_MAP, "That is too far away.")


def _refuse_odd_angle(angle: float) -> None:
    problem = angle_problem(angle)
    if problem:
        raise Refused(codes.BAD_REQUEST, f"{problem}.")
