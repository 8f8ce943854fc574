"""Obstacles around a place, in cells fine enough to check the footprint to a centimetre."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.gridmap.kernels import column_distances_into, distance_transform_into, is_in_disc
from trolley.jit import kernel, lean_kernel
from trolley_planner.costmap.costmap import Costmap
from trolley_planner.costmap.inflation import FREE, UNKNOWN, WALL
from trolley_planner.costmap.obstacle_grid import ObstacleGrid
from trolley_planner.sensing.beams import CLEAR, DX, DY, ECHO, X, Y


class FineGridParams(NamedTuple):
    """Size of fine cells, and what the lidar says of walls; by hand."""

    finest_m: float = 0.015
    """Largest edge of a fine cell, where there are not too many of them."""
    looks_m: float = 1.0
    """A wall that is farther from the lidar than this is looked at before the robot is there."""
    deepest_m: float = 0.3
    """Most of a wall that a beam opens: a beam along a wall that the map has 4 cm off runs in it
    for 20 cm."""
    off_m: float = 0.1
    """Most that the face of a wall is taken to lie behind that of the map: the map's error, and the
    pose's. What the map has deeper may be something that the lidar does not see."""
    noise_m: float = 0.02
    """This much before an echo the wall stays: what is left of the noise of ranges."""


FINE = FineGridParams()
LEAST_PARTS = 3
"""Cells of walls that are divided in fewer parts than this are drawn as a whole."""


class Box(NamedTuple):
    """Which cells of the costmap are divided, and how."""

    row: int
    """Row of the costmap at the corner; may lie outside."""
    col: int
    """The same of the column."""
    parts: int
    """Fine cells in the edge of a cell."""
    cell_m: float
    """Edge of a cell of the costmap [m]."""


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
        kinds, keepout = costmap.static.kinds, costmap.static.keepout
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
        box = Box(*first, self.parts, costmap.resolution_m)
        manner = not costmap.unknown_is_free, has_seen, layer.in_sight_since
        fill_window(self.mask, kinds, keepout, layer.grid, box, manner, layer.beams)
        if has_seen:
            open_walls(self.mask, kinds, keepout, box, layer.beams, layer.echoes_m)
            draw_echoes(self.mask, layer.static_beams, box)
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
    box: Box,
    manner: tuple[bool, bool, int],
    beams: NDArray[np.float64],
) -> None:
    """Write 1 where something stands: what was seen as the point seen, walls but for their rims.

    A wall fills the cells at its surface only in part; where they end, the lidar sees, and what is
    far away it sees before the robot is there. Where it does not look beside the robot, they count
    as filled, and so does all beyond the costmap if what nobody has seen does.

    Args:
        out_mask: (rows, cols) fine cells, overwritten.
        kinds: of the costmap's cells.
        keepout: of the costmap's cells.
        grid: what the lidar has seen.
        box: where the fine cells lie.
        manner: whether cells that nobody has seen count as something, whether what the lidar has
            seen does, and the number of the scan since which the lidar must have seen a cell to be
            looking there now.
        beams: (n, 6) of the newest scan, which tell where the lidar is.
    """
    rows, cols = kinds.shape
    out_mask[:, :] = 0
    parts, scale = box.parts, box.parts / box.cell_m
    unknown_blocks, has_seen, in_sight_since = manner
    observed = grid.observed
    laser_x, laser_y = math.inf, math.inf
    if beams.shape[0] > 0:
        laser_x, laser_y = beams[-1, X] / box.cell_m, beams[-1, Y] / box.cell_m
    for row in range(box.row, box.row + out_mask.shape[0] // parts):
        for col in range(box.col, box.col + out_mask.shape[1] // parts):
            top, left = (row - box.row) * parts, (col - box.col) * parts
            if not (0 <= row < rows and 0 <= col < cols):
                if unknown_blocks:
                    out_mask[top : top + parts, left : left + parts] = 1
                continue
            unseen = kinds[row, col] == UNKNOWN and observed[row, col] == 0
            if keepout[row, col] != 0 or (unknown_blocks and unseen):
                out_mask[top : top + parts, left : left + parts] = 1
            elif kinds[row, col] == WALL:
                is_near = is_in_disc(row, col, laser_x, laser_y, FINE.looks_m / box.cell_m)
                since = in_sight_since if is_near else 0
                draw_wall(out_mask, kinds, observed, box, (row, col), since)
            elif has_seen and grid.evidence[row, col]:
                fine_row = math.floor(grid.points[row, col, 1] * scale) - box.row * parts
                fine_col = math.floor(grid.points[row, col, 0] * scale) - box.col * parts
                # Rounding of the point may put it just outside its cell.
                fine_row = min(max(fine_row, top), top + parts - 1)
                fine_col = min(max(fine_col, left), left + parts - 1)
                out_mask[fine_row, fine_col] = 1


@lean_kernel
def draw_wall(
    out_mask: NDArray[np.uint8],
    kinds: NDArray[np.uint8],
    observed: NDArray[np.int32],
    box: Box,
    cell: tuple[int, int],
    since: int,
) -> None:
    """Set the fine cells of a cell of a wall, but for its rims beside floor that is looked at.

    Args:
        out_mask: (rows, cols) fine cells, changed in place.
        kinds: of the costmap's cells.
        observed: numbers of the scans in which beams last passed the costmap's cells.
        box: where the fine cells lie.
        cell: row and column of the costmap.
        since: number of the scan since which the lidar looks there.
    """
    row, col = cell
    parts = box.parts
    top, left, bottom, right = 0, 0, parts, parts
    if parts >= LEAST_PARTS:
        top += row > 0 and is_face(kinds[row - 1, col], observed[row - 1, col], since)
        bottom -= row < kinds.shape[0] - 1 and is_face(
            kinds[row + 1, col], observed[row + 1, col], since
        )
        left += col > 0 and is_face(kinds[row, col - 1], observed[row, col - 1], since)
        right -= col < kinds.shape[1] - 1 and is_face(
            kinds[row, col + 1], observed[row, col + 1], since
        )
    first_row, first_col = (row - box.row) * parts, (col - box.col) * parts
    for fine_row in range(first_row + top, first_row + bottom):
        for fine_col in range(first_col + left, first_col + right):
            out_mask[fine_row, fine_col] = 1


@lean_kernel
def is_face(kind: int, observed: int, since: int) -> bool:
    """Say whether a cell beside a wall is free and the lidar looks there; see `fill_window`."""
    return kind == FREE and observed >= since


@kernel
def open_walls(
    out_mask: NDArray[np.uint8],
    kinds: NDArray[np.uint8],
    keepout: NDArray[np.uint8],
    box: Box,
    beams: NDArray[np.float64],
    echoes_m: NDArray[np.float64],
) -> None:
    """Clear walls as far as the newest beams go in them, and set the fine cells where those end.

    A wall is where the lidar sees it: between walls that the map, or the error of the pose, has
    nearer than they are, the robot would not turn where it can. A beam that leaves the wall again
    shows nothing of it: it may have gone through glass.

    Args:
        out_mask: (rows, cols) fine cells, changed in place.
        kinds: of the costmap's cells.
        keepout: of the costmap's cells; these stay set.
        box: where the fine cells lie.
        beams: (n, 6) in `grid`, cut at mirrors and walls.
        echoes_m: (n,) how far off their echoes lie, those in walls as well; 0 = none.
    """
    step_m, cell_m = 0.5 * box.cell_m / box.parts, box.cell_m
    for beam in range(beams.shape[0]):
        echo = echoes_m[beam]
        was_cut = beams[beam, ECHO] == 0.0
        wall = beams[beam, CLEAR] if was_cut else echo - cell_m
        end = fine_cell(box, beams, beam, echo)
        if echo <= 0.0 or echo - wall > FINE.deepest_m or not is_inside(out_mask, end[0], end[1]):
            continue
        if was_cut and not ends_in_wall(kinds, box, beams, beam, (wall, echo)):
            continue
        at = echo - FINE.noise_m
        while at > wall:
            fine = fine_cell(box, beams, beam, at)
            if is_inside(out_mask, fine[0], fine[1]):
                row, col = coarse_cell(box, fine)
                if is_wall(kinds, row, col) and keepout[row, col] == 0:
                    out_mask[fine[0], fine[1]] = 0
            at -= step_m
    draw_ends(out_mask, kinds, box, beams, echoes_m)


@lean_kernel
def draw_ends(
    out_mask: NDArray[np.uint8],
    kinds: NDArray[np.uint8],
    box: Box,
    beams: NDArray[np.float64],
    echoes_m: NDArray[np.float64],
) -> None:
    """Set the fine cells in walls where beams end, though others pass them; see `open_walls`."""
    for beam in range(beams.shape[0]):
        end = fine_cell(box, beams, beam, echoes_m[beam])
        if echoes_m[beam] > 0.0 and is_inside(out_mask, end[0], end[1]):
            row, col = coarse_cell(box, end)
            if is_wall(kinds, row, col):
                out_mask[end[0], end[1]] = 1


@lean_kernel
def ends_in_wall(
    kinds: NDArray[np.uint8],
    box: Box,
    beams: NDArray[np.float64],
    beam: int,
    stretch: tuple[float, float],
) -> bool:
    """Say whether a beam is in a wall from where it meets it up to its echo, close to its face.

    Args:
        kinds: of the costmap's cells.
        box: how these are divided.
        beams: (n, 6).
        beam: which of them.
        stretch: where it meets the wall, and where its echo lies [m].
    """
    step_m, at = 0.5 * box.cell_m / box.parts, stretch[1]
    while at > stretch[0]:
        row, col = coarse_cell(box, fine_cell(box, beams, beam, at))
        if not is_wall(kinds, row, col):
            return False
        at -= step_m
    return is_near_face(kinds, box, beams, beam, stretch[1])


@lean_kernel
def is_near_face(
    kinds: NDArray[np.uint8],
    box: Box,
    beams: NDArray[np.float64],
    beam: int,
    along_m: float,
) -> bool:
    """Say whether there is floor `FINE.off_m` from so far along a beam, on the side it came from.

    Args:
        kinds: of the costmap's cells.
        box: how these are divided.
        beams: (n, 6).
        beam: which of them.
        along_m: the place on it.
    """
    dx, dy = beams[beam, DX], beams[beam, DY]
    end_row, end_col = coarse_cell(box, fine_cell(box, beams, beam, along_m))
    most = max(1, round(FINE.off_m / box.cell_m))
    for row in range(max(end_row - most, 0), min(end_row + most + 1, kinds.shape[0])):
        for col in range(max(end_col - most, 0), min(end_col + most + 1, kinds.shape[1])):
            is_before = (row - end_row) * dy + (col - end_col) * dx <= -1.0
            if is_before and kinds[row, col] == FREE:
                return True
    return False


@lean_kernel
def is_wall(kinds: NDArray[np.uint8], row: int, col: int) -> bool:
    """Say whether there is such a cell, and a wall in it."""
    return is_inside(kinds, row, col) and kinds[row, col] == WALL


@lean_kernel
def fine_cell(box: Box, beams: NDArray[np.float64], beam: int, along_m: float) -> tuple[int, int]:
    """Return row and column of the fine cell so far along a beam; may lie outside."""
    scale = box.parts / box.cell_m
    row = math.floor((beams[beam, Y] + along_m * beams[beam, DY]) * scale) - box.row * box.parts
    col = math.floor((beams[beam, X] + along_m * beams[beam, DX]) * scale) - box.col * box.parts
    return row, col


@lean_kernel
def coarse_cell(box: Box, fine: tuple[int, int]) -> tuple[int, int]:
    """Return row and column of the costmap's cell that holds a fine cell of the box."""
    return fine[0] // box.parts + box.row, fine[1] // box.parts + box.col


@lean_kernel
def is_inside(cells: NDArray[np.uint8], row: int, col: int) -> bool:
    """Say whether there is such a cell."""
    return 0 <= row < cells.shape[0] and 0 <= col < cells.shape[1]


@kernel
def draw_echoes(out_mask: NDArray[np.uint8], beams: NDArray[np.float64], box: Box) -> None:
    """Set the fine cells of the newest echoes, also of those that the map explains.

    Args:
        out_mask: (rows, cols) fine cells, changed in place.
        beams: (n, 6) in `grid`, cut at mirrors and walls.
        box: where the fine cells lie.
    """
    for beam in range(beams.shape[0]):
        echo = beams[beam, ECHO]
        if echo <= 0.0 or beams[beam, CLEAR] <= 0.0:
            continue
        row, col = fine_cell(box, beams, beam, echo)
        if is_inside(out_mask, row, col):
            out_mask[row, col] = 1
