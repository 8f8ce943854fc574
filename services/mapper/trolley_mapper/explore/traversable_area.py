"""What an exploring robot may drive on: the map with its zones, as far as it is known."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.geometry.polygon import polygon_contains
from trolley.gridmap import UNKNOWN as NOT_KNOWN
from trolley.gridmap import GridMap
from trolley.gridmap.segments import draw_segments, line_segments
from trolley.messages import Zone
from trolley.zones import LINE_KINDS
from trolley_mapper.kernels.frontiers import BLOCKED, FREE, UNKNOWN

MARGIN_CELLS = 2
"""Unknown cells that are kept all round what is known."""


@dataclass(frozen=True, slots=True, eq=False)
class TraversableArea:
    """The part of a map that is known, and a few cells round it."""

    kinds: NDArray[np.uint8]
    """(rows, cols) of `FREE`, `UNKNOWN` and `BLOCKED`."""
    resolution: float
    """Cell edge [m]."""
    map_T_area: Pose2D
    """The outer corner of cell (0, 0)."""

    def place(self, cell: int, yaw: float = 0.0) -> Pose2D:
        """Return a pose on the map at the centre of a cell, given by its number.

        Args:
            cell: row * cols + col.
            yaw: in the frame of the cells [rad].
        """
        row, col = divmod(cell, self.kinds.shape[1])
        edge = self.resolution
        return self.map_T_area @ Pose2D((col + 0.5) * edge, (row + 0.5) * edge, yaw)

    def in_cells(self, pose: Pose2D) -> tuple[float, float]:
        """Return where a pose of the map lies along columns and rows [cells]."""
        at = self.map_T_area.inverse() @ pose
        return at.x / self.resolution, at.y / self.resolution


def lay_out_area(
    grid: GridMap,
    zones: Sequence[Zone],
    here: Pose2D,
    radius_m: float,
    within: tuple[Pose2D, float],
) -> TraversableArea:
    """Return what of a map may be driven on.

    Keep-outs, mirrors and glass are blocked, and all that lies too far away; a keep-out that holds
    the robot is not, so that it can leave. Where the robot stands nothing else does.

    Args:
        grid: the map so far.
        zones: its zones.
        here: map_T_base.
        radius_m: radius of what the robot covers [m].
        within: a place and how far from it may be explored [m].
    """
    # A map is cut to what is known: floor that is free may end at its border.
    wider = np.pad(grid.cells, MARGIN_CELLS, constant_values=NOT_KNOWN)
    rows, cols = _known(wider)
    cells = wider[rows, cols]
    edge = grid.resolution
    first_row, first_col = rows.start - MARGIN_CELLS, cols.start - MARGIN_CELLS
    corner = Pose2D(first_col * edge, first_row * edge, 0.0)
    area = TraversableArea(np.full(cells.shape, UNKNOWN, np.uint8), edge, grid.origin @ corner)
    kinds = area.kinds
    part = GridMap(grid.name, edge, area.map_T_area, cells)
    kinds[part.free_mask() != 0] = FREE
    kinds[(kinds == UNKNOWN) & _disc(area, here, radius_m)] = FREE
    kinds[part.occupied_mask() != 0] = BLOCKED
    kinds[~_disc(area, *within)] = BLOCKED
    lines = [zone.points for zone in zones if zone.kind in LINE_KINDS]
    draw_segments(kinds, line_segments(lines, area.map_T_area.inverse()), edge, BLOCKED)
    for zone in zones:
        points = np.array(zone.points, np.float64)
        if zone.kind == "keepout" and not polygon_contains(points, here.as_array()[None, :2])[0]:
            _block_polygon(area, points)
    return area


def _known(cells: NDArray[np.int8]) -> tuple[slice, slice]:
    """Return the rows and columns that are known, with a margin; a corner if nothing is."""
    known = cells >= 0
    spans: list[slice] = []
    for axis in (1, 0):
        where = np.flatnonzero(known.any(axis=axis))
        size = cells.shape[1 - axis]
        first, last = (int(where[0]), int(where[-1])) if where.size else (0, 0)
        spans.append(slice(max(first - MARGIN_CELLS, 0), min(last + MARGIN_CELLS + 1, size)))
    return spans[0], spans[1]


def _disc(area: TraversableArea, centre: Pose2D, radius_m: float) -> NDArray[np.bool_]:
    """Return (rows, cols), true within a circle on the map."""
    x, y = area.in_cells(centre)
    along, across = np.indices(area.kinds.shape, dtype=np.float32)
    away = np.hypot(across + (0.5 - x), along + (0.5 - y))
    return np.asarray(away <= radius_m / area.resolution)


def _block_polygon(area: TraversableArea, points: NDArray[np.float64]) -> None:
    """Block the cells whose centres lie in a polygon."""
    corners = area.map_T_area.inverse().transform_points(points) / area.resolution
    left, low = (max(math.floor(float(value)), 0) for value in corners.min(axis=0))
    right, high = (math.ceil(float(value)) for value in corners.max(axis=0))
    part = area.kinds[low : max(high, low), left : max(right, left)]
    along, across = np.indices(part.shape, dtype=np.float64)
    centres = np.column_stack([across.ravel() + left + 0.5, along.ravel() + low + 0.5])
    part[polygon_contains(corners, centres).reshape(part.shape)] = BLOCKED
