"""Compiled loops that build the window around the robot in which the controller thinks."""

import math

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel
from trolley_planner.kernels.beams import CLEAR, DX, DY, ECHO, EchoLayer, X, Y
from trolley_planner.kernels.layers import UNKNOWN, WALL
from trolley_planner.kernels.search import UNREACHED


@kernel
def fill_window(
    out_mask: NDArray[np.uint8],
    kinds: NDArray[np.uint8],
    keepout: NDArray[np.uint8],
    layer: EchoLayer,
    first: tuple[int, int],
    parts: int,
    unknown_blocks: bool,
    resolution_m: float,
) -> None:
    """Write 1 where something stands: walls as whole cells, what was seen as the point seen.

    Args:
        out_mask: (rows * parts, cols * parts) fine cells, overwritten.
        kinds: of the costmap's cells.
        keepout: of the costmap's cells.
        layer: what the lidar has seen.
        first: row and column of the costmap at the window's corner; may lie outside.
        parts: fine cells in the edge of a cell of the costmap.
        unknown_blocks: whether cells that nobody has seen count as something.
        resolution_m: cell edge of the costmap [m].
    """
    rows, cols = kinds.shape
    out_mask[:, :] = 0
    fine_rows, fine_cols = out_mask.shape
    scale = parts / resolution_m
    for window_row in range(fine_rows // parts):
        for window_col in range(fine_cols // parts):
            row, col = first[0] + window_row, first[1] + window_col
            if not (0 <= row < rows and 0 <= col < cols):
                continue
            unseen = kinds[row, col] == UNKNOWN and layer.observed[row, col] == 0
            if kinds[row, col] == WALL or keepout[row, col] or (unknown_blocks and unseen):
                for part_row in range(parts):
                    for part_col in range(parts):
                        out_mask[window_row * parts + part_row, window_col * parts + part_col] = 1
            elif layer.evidence[row, col]:
                fine_row = math.floor(layer.points[row, col, 1] * scale) - first[0] * parts
                fine_col = math.floor(layer.points[row, col, 0] * scale) - first[1] * parts
                # Rounding of the point may put it just outside its cell.
                fine_row = min(max(fine_row, window_row * parts), (window_row + 1) * parts - 1)
                fine_col = min(max(fine_col, window_col * parts), (window_col + 1) * parts - 1)
                out_mask[fine_row, fine_col] = 1


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
        first: fine row and column of the window's corner.
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


@kernel
def coarsen_into(out_m: NDArray[np.float32], distance_m: NDArray[np.float32], parts: int) -> None:
    """Write the largest distance in each coarse cell.

    The way should not close where the footprint still fits; rollouts are checked exactly.

    Args:
        out_m: (rows, cols) coarse cells, overwritten.
        distance_m: (rows * parts, cols * parts) fine cells.
        parts: fine cells in the edge of a coarse cell.
    """
    rows, cols = out_m.shape
    for row in range(rows):
        for col in range(cols):
            largest = np.float32(0.0)
            for part_row in range(parts):
                for part_col in range(parts):
                    largest = max(
                        largest, distance_m[row * parts + part_row, col * parts + part_col]
                    )
            out_m[row, col] = largest


@kernel
def costs_to_metres(
    out_m: NDArray[np.float32], cost: NDArray[np.int32], metres: float, unreached_m: float
) -> None:
    """Write costs-to-go as metres of free floor.

    Args:
        out_m: (rows, cols), overwritten.
        cost: (cells,) row-major.
        metres: of one unit of cost.
        unreached_m: where there is no way.
    """
    rows, cols = out_m.shape
    for row in range(rows):
        for col in range(cols):
            value = cost[row * cols + col]
            out_m[row, col] = unreached_m if value == UNREACHED else value * metres


@kernel
def slope_edges(cost_m: NDArray[np.float32], unreached_m: float, rise_m: float, width: int) -> None:
    """Let the cost-to-go rise beside the cells that were reached, instead of jumping.

    Between two cells it is interpolated; a jump would push the robot out of narrow ways.

    Args:
        cost_m: (rows, cols), changed in place; its outermost cells stay.
        unreached_m: what the cells hold that were not reached.
        rise_m: from cell to cell.
        width: so many cells are filled.
    """
    rows, cols = cost_m.shape
    limit = np.float32(unreached_m)
    for _ in range(width):
        before = cost_m.copy()
        for row in range(1, rows - 1):
            for col in range(1, cols - 1):
                if before[row, col] < limit:
                    continue
                lowest = min(
                    min(before[row - 1, col], before[row + 1, col]),
                    min(before[row, col - 1], before[row, col + 1]),
                )
                cost_m[row, col] = min(limit, lowest + np.float32(rise_m))
