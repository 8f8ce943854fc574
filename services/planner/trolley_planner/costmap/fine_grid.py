"""Obstacles around a place, in cells fine enough to check the footprint to a centimetre."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.gridmap.kernels import column_distances_into, distance_transform_into
from trolley.jit import kernel
from trolley_planner.costmap.costmap import Costmap
from trolley_planner.costmap.inflation import FREE, UNKNOWN, WALL
from trolley_planner.costmap.obstacle_grid import ObstacleGrid
from trolley_planner.sensing.beams import CLEAR, DX, DY, ECHO, X, Y


@dataclass(frozen=True, slots=True)
class FineGridParams:
    """Size of fine cells; by hand."""

    finest_m: float = 0.015
    """Largest edge of a fine cell, where there are not too many of them."""


FINE = FineGridParams()
LEAST_PARTS = 3
"""Cells of walls that are divided in fewer parts than this are drawn as a whole."""


class FineGrid:
    """Obstacles and their distances in fine cells, in a box of the costmap's cells.

    Args:
        costmap: what stands where.
        edge_m: largest edge of a fine cell.
        reach_m: distances are cut off here.
    """

    def __init__(self, costmap: Costmap, edge_m: float, reach_m: float) -> None:
        self._costmap = costmap
        self.parts = max(1, math.ceil(costmap.resolution_m / edge_m))
        """Fine cells in the edge of a cell of the costmap."""
        self.fine_m = costmap.resolution_m / self.parts
        self._reach_m = reach_m
        self._mask = np.zeros(0, dtype=np.uint8)
        self._columns = np.zeros(0, dtype=np.int32)
        self._distances = np.zeros(0, dtype=np.float32)
        self.x = self.y = 0.0
        """Corner in `grid` [m]."""
        # Before the first look nothing is known to be free; look-ups need two cells each way.
        self.mask: NDArray[np.uint8] = np.ones((2, 2), dtype=np.uint8)
        """(rows, cols) set where something stands."""
        self.distance_m: NDArray[np.float32] = np.zeros((2, 2), dtype=np.float32)
        """(rows, cols) to the nearest obstacle."""

    def update(self, first: tuple[int, int], size: tuple[int, int], has_seen: bool = True) -> None:
        """Refill a box.

        Args:
            first: row and column of the costmap at its corner; may lie outside.
            size: rows and columns of the costmap.
            has_seen: with what the lidar has seen; else the map and its zones alone.
        """
        costmap, layer = self._costmap, self._costmap.obstacle_layer
        rows, cols = size[0] * self.parts, size[1] * self.parts
        if self._mask.size < rows * cols:
            self._mask = np.zeros(rows * cols, dtype=np.uint8)
            self._columns = np.zeros(rows * cols, dtype=np.int32)
            self._distances = np.zeros(rows * cols, dtype=np.float32)
        part, shape = slice(rows * cols), (rows, cols)
        self.mask = self._mask[part].reshape(shape)
        self.distance_m = self._distances[part].reshape(shape)
        columns = self._columns[part].reshape(shape)
        self.x, self.y = first[1] * costmap.resolution_m, first[0] * costmap.resolution_m
        fill_window(
            self.mask,
            costmap.static.kinds,
            costmap.static.keepout,
            layer.grid,
            first,
            self.parts,
            (not costmap.unknown_is_free, has_seen, layer.in_sight_since),
            costmap.resolution_m,
        )
        if has_seen:
            fine_first = first[0] * self.parts, first[1] * self.parts
            draw_echoes(self.mask, layer.static_beams, fine_first, self.fine_m)
        column_distances_into(columns, self.mask)
        distance_transform_into(self.distance_m, columns, self.fine_m, self._reach_m)

    def divided(self, cells: NDArray[np.bool_ | np.int_]) -> NDArray[np.uint8]:
        """Return what is said of the costmap's cells (rows, cols) in the box for each fine cell."""
        return cells.astype(np.uint8).repeat(self.parts, 0).repeat(self.parts, 1)

    def contains(self, x: float, y: float) -> bool:
        """Say whether a point of `grid` [m] lies in the box."""
        rows, cols = self.mask.shape
        right, top = self.x + cols * self.fine_m, self.y + rows * self.fine_m
        return self.x <= x < right and self.y <= y < top


@kernel
def fill_window(
    out_mask: NDArray[np.uint8],
    kinds: NDArray[np.uint8],
    keepout: NDArray[np.uint8],
    grid: ObstacleGrid,
    first: tuple[int, int],
    parts: int,
    manner: tuple[bool, bool, int],
    resolution_m: float,
) -> None:
    """Write 1 where something stands: what was seen as the point seen, walls but for their rims.

    A wall fills the cells at its surface only in part; where they end, the lidar sees. Where it
    does not look, they count as filled, and so does all beyond the costmap if what nobody has seen
    does.

    Args:
        out_mask: (rows * parts, cols * parts) fine cells, overwritten.
        kinds: of the costmap's cells.
        keepout: of the costmap's cells.
        grid: what the lidar has seen.
        first: row and column of the costmap at the local costmap's corner; may lie outside.
        parts: fine cells in the edge of a cell of the costmap.
        manner: whether cells that nobody has seen count as something, whether what the lidar has
            seen does, and the number of the scan since which the lidar must have seen a cell to be
            looking there now.
        resolution_m: cell edge of the costmap [m].
    """
    rows, cols = kinds.shape
    out_mask[:, :] = 0
    fine_rows, fine_cols = out_mask.shape
    scale = parts / resolution_m
    unknown_blocks, has_seen, since = manner
    observed = grid.observed
    for window_row in range(fine_rows // parts):
        for window_col in range(fine_cols // parts):
            row, col = first[0] + window_row, first[1] + window_col
            if not (0 <= row < rows and 0 <= col < cols):
                if unknown_blocks:
                    top, left = window_row * parts, window_col * parts
                    out_mask[top : top + parts, left : left + parts] = 1
                continue
            unseen = kinds[row, col] == UNKNOWN and observed[row, col] == 0
            is_filled = keepout[row, col] != 0 or (unknown_blocks and unseen)
            if is_filled or kinds[row, col] == WALL:
                top, left, bottom, right = 0, 0, parts, parts
                if not is_filled and parts >= LEAST_PARTS:
                    top += row > 0 and is_face(kinds[row - 1, col], observed[row - 1, col], since)
                    bottom -= row < rows - 1 and is_face(
                        kinds[row + 1, col], observed[row + 1, col], since
                    )
                    left += col > 0 and is_face(kinds[row, col - 1], observed[row, col - 1], since)
                    right -= col < cols - 1 and is_face(
                        kinds[row, col + 1], observed[row, col + 1], since
                    )
                for part_row in range(top, bottom):
                    for part_col in range(left, right):
                        out_mask[window_row * parts + part_row, window_col * parts + part_col] = 1
            elif has_seen and grid.evidence[row, col]:
                fine_row = math.floor(grid.points[row, col, 1] * scale) - first[0] * parts
                fine_col = math.floor(grid.points[row, col, 0] * scale) - first[1] * parts
                # Rounding of the point may put it just outside its cell.
                fine_row = min(max(fine_row, window_row * parts), (window_row + 1) * parts - 1)
                fine_col = min(max(fine_col, window_col * parts), (window_col + 1) * parts - 1)
                out_mask[fine_row, fine_col] = 1


@kernel
def is_face(kind: int, observed: int, since: int) -> bool:
    """Say whether a cell beside a wall is free and the lidar looks there; see `fill_window`."""
    return kind == FREE and observed >= since


@kernel
def draw_echoes(
    out_mask: NDArray[np.uint8],
    beams: NDArray[np.float64],
    first: tuple[int, int],
    fine_m: float,
) -> None:
    """Set the fine cells of the newest echoes, also of those that the map explains.

    Args:
        out_mask: (rows, cols) fine cells, changed in place.
        beams: (n, 6) in `grid`, cut at mirrors and walls.
        first: fine row and column of the local costmap's corner.
        fine_m: edge of a fine cell [m].
    """
    for beam in range(beams.shape[0]):
        echo = beams[beam, ECHO]
        if echo <= 0.0 or beams[beam, CLEAR] <= 0.0:
            continue
        row = math.floor((beams[beam, Y] + echo * beams[beam, DY]) / fine_m) - first[0]
        col = math.floor((beams[beam, X] + echo * beams[beam, DX]) / fine_m) - first[1]
        if 0 <= row < out_mask.shape[0] and 0 <= col < out_mask.shape[1]:
            out_mask[row, col] = 1
