"""Evidence, cell by cell, that the world has changed since the map was made.

Echoes that end on a floor cell indicate that something has appeared; beams that pass through a
wall cell, that it is gone. Cells are kept in tiles, and only where there was such evidence.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.gridmap import OCCUPIED_FROM
from trolley.jit import kernel, lean_kernel
from trolley.scanning import Points
from trolley_localizer.kernels.matching import EXPLAINED, NOT_ON_MAP
from trolley_localizer.kernels.reflection import IMAGE, MIRRORED

TILE = 16
"""Edge of a tile [cells]."""
TILE_CELLS = TILE * TILE

REACH = 3
"""What is gone may be larger than what beams passed through by at most this [cells]."""

NOTHING, APPEARED, GONE = 0, 1, 2

KIND, LOOK, FOR, AGAINST, VISITS, BEGAN, FIRST, LAST, HIT = range(9)
LEFT, LOW, RIGHT, HIGH = range(9, 13)
COLUMNS = 13
"""Columns of what is kept of a cell: what it speaks for; the look that it last had a say in; looks
for and against in the present visit; visits that were for it; when the present visit began, the
first look for it was, and the last [s]; when an echo last ended in it [s]; the corners of where the
robot looked from [cells]."""

MOST_VISITS = 8
"""More visits than these add no certainty."""
_VISITS_LOST = 2
"""Number of visits for a change that one against it cancels."""
_SIDE = 2.0
"""Distance to either side on which a wall must go on for a beam to have passed through it, not by
its edge [cells]."""
_SIDE_WALL = 1.5
"""Distance from a wall of the map within which a place beside the beam belongs to it [cells]."""
_AT_WALL = 2.0
"""Distance from a wall of the map within which a beam's end is that wall [cells]."""


class ChangeEvidence(NamedTuple):
    """What is known of the cells.

    Attributes:
        tiles: (rows / TILE, cols / TILE) int32, which part of the table a tile has; -1 for none.
        table: (capacity * TILE_CELLS, COLUMNS) int32.
        used: (1,) int64, how many tiles have a part.
    """

    tiles: NDArray[np.int32]
    table: NDArray[np.int32]
    used: NDArray[np.int64]


class Moment(NamedTuple):
    """When, and from where, a look is taken.

    Attributes:
        look: its number, from 1 on.
        clock_s: observed time [s].
        visit_s: looks within this time are one visit [s].
        x: where the robot is [cells], `y` alike.
        y: see `x`.
    """

    look: int
    clock_s: int
    visit_s: int
    x: int
    y: int


@lean_kernel
def find_row(evidence: ChangeEvidence, row: int, col: int) -> int:
    """Return where a cell of the map is kept in the table, -1 for nowhere."""
    tile = evidence.tiles[row // TILE, col // TILE]
    if tile < 0:
        return -1
    return int(tile) * TILE_CELLS + (row % TILE) * TILE + col % TILE


@lean_kernel
def claim_row(evidence: ChangeEvidence, row: int, col: int) -> int:
    """Allot a place in the table to a cell and return it, -1 if there is no room."""
    if evidence.tiles[row // TILE, col // TILE] < 0:
        if (evidence.used[0] + 1) * TILE_CELLS > evidence.table.shape[0]:
            return -1
        evidence.tiles[row // TILE, col // TILE] = evidence.used[0]
        evidence.used[0] += 1
    return find_row(evidence, row, col)


@lean_kernel
def end_visit(cell: NDArray[np.int32], clock_s: int) -> None:
    """Conclude a visit to one cell (COLUMNS,), and begin another at a time [s]."""
    if cell[FOR] > cell[AGAINST]:
        cell[VISITS] = min(cell[VISITS] + 1, MOST_VISITS)
    elif cell[FOR] < cell[AGAINST]:
        cell[VISITS] -= _VISITS_LOST
    cell[FOR] = cell[AGAINST] = 0
    cell[BEGAN] = clock_s
    if cell[VISITS] <= 0:
        cell[KIND] = NOTHING


@lean_kernel
def vote(cell: NDArray[np.int32], kind: int, is_for: bool, moment: Moment) -> None:
    """Count one look at one cell, once.

    Args:
        cell: (COLUMNS,) changed.
        kind: APPEARED or GONE.
        is_for: whether it speaks for the change.
        moment: of the look.
    """
    if cell[KIND] == kind and cell[LOOK] == moment.look:
        return
    if cell[KIND] == kind and moment.clock_s - cell[BEGAN] >= moment.visit_s:
        end_visit(cell, moment.clock_s)
    if cell[KIND] != kind:
        if not is_for:
            return
        cell[KIND] = kind
        cell[FOR] = cell[AGAINST] = cell[VISITS] = 0
        cell[BEGAN] = cell[FIRST] = moment.clock_s
        cell[LEFT] = cell[RIGHT] = moment.x
        cell[LOW] = cell[HIGH] = moment.y
    cell[LOOK] = moment.look
    if not is_for:
        cell[AGAINST] += 1
        return
    cell[FOR] += 1
    cell[LAST] = moment.clock_s
    cell[LEFT] = min(cell[LEFT], moment.x)
    cell[RIGHT] = max(cell[RIGHT], moment.x)
    cell[LOW] = min(cell[LOW], moment.y)
    cell[HIGH] = max(cell[HIGH], moment.y)


@lean_kernel
def claim_about(evidence: ChangeEvidence, row: int, col: int, cells: NDArray[np.int8]) -> None:
    """Keep a cell's neighbours as well, to record which of them are seen to be there still."""
    for r in (max(row - REACH, 0), min(row + REACH, cells.shape[0] - 1)):
        for c in (max(col - REACH, 0), min(col + REACH, cells.shape[1] - 1)):
            claim_row(evidence, r, c)


@lean_kernel
def place_rays(
    out_rays: NDArray[np.float64], pose: NDArray[np.float64], end: Points, start: Points
) -> None:
    """Transform the beams into the map.

    Args:
        out_rays: (n, 5) where a beam begins, its direction, its length, overwritten [cells].
        pose: (3,) x, y [cells], yaw [rad] in `grid`.
        end: (n,) end points in `base_link` [cells].
        start: (n,) where the laser was [cells].
    """
    cos = math.cos(pose[2])
    sin = math.sin(pose[2])
    for i in range(end.x.size):
        dx = end.x[i] - start.x[i]
        dy = end.y[i] - start.y[i]
        length = max(math.hypot(dx, dy), 1e-6)
        out_rays[i, 0] = pose[0] + cos * start.x[i] - sin * start.y[i]
        out_rays[i, 1] = pose[1] + sin * start.x[i] + cos * start.y[i]
        out_rays[i, 2] = (cos * dx - sin * dy) / length
        out_rays[i, 3] = (sin * dx + cos * dy) / length
        out_rays[i, 4] = length


@lean_kernel
def is_inside(cells: NDArray[np.int8], x: float, y: float) -> bool:
    """Say whether a point [cells] lies on the map."""
    return 0.0 <= x < cells.shape[1] and 0.0 <= y < cells.shape[0]


@lean_kernel
def sees_end(
    evidence: ChangeEvidence, ray: NDArray[np.float64], cells: NDArray[np.int8], margin: float
) -> bool:
    """Say whether no wall blocks a beam, apart from those that seem to be gone.

    Args:
        evidence: what is known of the cells.
        ray: (5,) as `place_rays` writes it.
        cells: (rows, cols) of the map.
        margin: a wall this near to the end does not count [cells].
    """
    way = 0.5
    while way < ray[4] - margin:
        x = ray[0] + way * ray[2]
        y = ray[1] + way * ray[3]
        if not is_inside(cells, x, y):
            return False
        if cells[int(y), int(x)] >= OCCUPIED_FROM:
            at = find_row(evidence, int(y), int(x))
            if at < 0 or evidence.table[at, KIND] != GONE or evidence.table[at, VISITS] < 2:
                return False
        way += 0.7
    return True


@lean_kernel
def count_hit(
    evidence: ChangeEvidence, x: float, y: float, cells: NDArray[np.int8], moment: Moment
) -> None:
    """Count an echo as evidence for the walls that it ended at.

    Args:
        evidence: what is known of the cells; changed.
        x: where it ended [cells], `y` alike.
        y: see `x`.
        cells: (rows, cols) of the map.
        moment: of the look.
    """
    for row in range(max(int(y) - 1, 0), min(int(y) + 2, cells.shape[0])):
        for col in range(max(int(x) - 1, 0), min(int(x) + 2, cells.shape[1])):
            at = find_row(evidence, row, col)
            if at >= 0 and cells[row, col] >= OCCUPIED_FROM:
                evidence.table[at, HIT] = moment.clock_s
                vote(evidence.table[at], GONE, False, moment)


@lean_kernel
def is_passed(field: NDArray[np.float32], x: float, y: float, dx: float, dy: float) -> bool:
    """Say whether a wall continues on both sides of where a beam is inside it.

    Args:
        field: (rows + 2, cols + 2) distance to the nearest wall [cells].
        x: on the map [cells], `y` alike.
        y: see `x`.
        dx: the beam's direction, a unit vector with `dy`.
        dy: see `dx`.
    """
    for side in (-_SIDE, _SIDE):
        row = int(y + side * dx + 1.0)
        col = int(x - side * dy + 1.0)
        if not (0 <= row < field.shape[0] and 0 <= col < field.shape[1]):
            return False
        if field[row, col] > _SIDE_WALL:
            return False
    return True


@lean_kernel
def may_testify(
    ray: NDArray[np.float64], verdict: int, cells: NDArray[np.int8], field: NDArray[np.float32]
) -> bool:
    """Say whether a beam that went through walls shows that they are gone.

    It must end at a wall of the map, or where the map knows nothing, and not as in a mirror.

    Args:
        ray: (5,) as `place_rays` writes it.
        verdict: on the beam, see `reflection`.
        cells: (rows, cols) of the map.
        field: (rows + 2, cols + 2) distance to the nearest wall [cells].
    """
    if verdict in (MIRRORED, IMAGE):
        return False
    x = ray[0] + ray[4] * ray[2]
    y = ray[1] + ray[4] * ray[3]
    if not is_inside(cells, x, y):
        return True
    return cells[int(y), int(x)] < 0 or field[int(y + 1.0), int(x + 1.0)] <= _AT_WALL


@lean_kernel
def take_echoes(
    evidence: ChangeEvidence,
    rays: NDArray[np.float64],
    classes: NDArray[np.uint8],
    mirrored: NDArray[np.int64],
    cells: NDArray[np.int8],
    limits: NDArray[np.float64],
    moment: Moment,
) -> None:
    """Count the ends of the beams as evidence.

    Args:
        evidence: what is known of the cells; changed.
        rays: (n, 5) as `place_rays` writes them.
        classes: (n,) of the beams.
        mirrored: (n,) number of the cell of the field that a beam seems mirrored at, or -1.
        cells: (rows, cols) of the map.
        limits: (2,) how far an echo may be, and how far before its end a wall may stand [cells].
        moment: of the look.
    """
    wide = cells.shape[1] + 2
    for i in range(classes.size):
        if mirrored[i] >= 0:
            at = find_row(evidence, mirrored[i] // wide - 1, mirrored[i] % wide - 1)
            if at >= 0:
                vote(evidence.table[at], GONE, False, moment)
            continue
        if classes[i] > NOT_ON_MAP or rays[i, 4] > limits[0]:
            continue
        x = rays[i, 0] + rays[i, 4] * rays[i, 2]
        y = rays[i, 1] + rays[i, 4] * rays[i, 3]
        if not is_inside(cells, x, y):
            continue
        if classes[i] == EXPLAINED:
            count_hit(evidence, x, y, cells, moment)
        elif 0 <= cells[int(y), int(x)] < OCCUPIED_FROM and sees_end(
            evidence, rays[i], cells, limits[1]
        ):
            at = claim_row(evidence, int(y), int(x))
            if at >= 0:
                vote(evidence.table[at], APPEARED, True, moment)


@lean_kernel
def take_passages(
    evidence: ChangeEvidence,
    rays: NDArray[np.float64],
    classes: NDArray[np.uint8],
    verdicts: NDArray[np.uint8],
    maps: tuple[NDArray[np.int8], NDArray[np.float32]],
    limits: NDArray[np.float64],
    moment: Moment,
) -> None:
    """Count the paths of the beams as evidence, after `take_echoes`.

    Args:
        evidence: what is known of the cells; changed.
        rays: (n, 5) as `place_rays` writes them.
        classes: (n,) of the beams.
        verdicts: (n,) on the beams, see `reflection`.
        maps: the map's cells (rows, cols), and the distance to the nearest wall
            (rows + 2, cols + 2) [cells].
        limits: (2,) how far a beam is followed, and how far before its end it is not [cells].
        moment: of the look.
    """
    cells, field = maps
    for i in range(classes.size):
        if classes[i] > NOT_ON_MAP:
            continue
        testifies = may_testify(rays[i], verdicts[i], cells, field)
        last = min(rays[i, 4] - limits[1], limits[0])
        way = 1.0
        while way < last:
            x = rays[i, 0] + way * rays[i, 2]
            y = rays[i, 1] + way * rays[i, 3]
            way += 1.0
            if not is_inside(cells, x, y):
                break
            row, col = int(y), int(x)
            if cells[row, col] < OCCUPIED_FROM:
                at = find_row(evidence, row, col)
                if at >= 0:
                    vote(evidence.table[at], APPEARED, False, moment)
            elif testifies and is_passed(field, x, y, rays[i, 2], rays[i, 3]):
                at = claim_row(evidence, row, col)
                if at >= 0:
                    vote(evidence.table[at], GONE, True, moment)
                    claim_about(evidence, row, col, cells)


@lean_kernel
def is_at_edge(cells: NDArray[np.int8], row: int, col: int) -> bool:
    """Say whether floor is near a wall cell: there, nothing is certainly seen through."""
    for r in range(max(row - REACH, 0), min(row + REACH + 1, cells.shape[0])):
        for c in range(max(col - REACH, 0), min(col + REACH + 1, cells.shape[1])):
            if 0 <= cells[r, c] < OCCUPIED_FROM:
                return True
    return False


@kernel
def grow_gone(
    mask: NDArray[np.uint8],
    corner: tuple[int, int],
    evidence: ChangeEvidence,
    cells: NDArray[np.int8],
    since_s: int,
) -> None:
    """Grow what is gone over its edges, unless they were seen to be there still.

    Args:
        mask: (rows, cols) of a window on the map: 1 where something is gone; grows.
        corner: row and column on the map where the window begins.
        evidence: what is known of the cells.
        cells: (rows, cols) of the map.
        since_s: walls where echoes ended later than this are still there [s].
    """
    rows, cols = mask.shape
    for _ in range(REACH):
        before = mask.copy()
        for row in range(rows):
            for col in range(cols):
                if before[row, col] or cells[corner[0] + row, corner[1] + col] < OCCUPIED_FROM:
                    continue
                touches = (
                    (row > 0 and before[row - 1, col])
                    or (row + 1 < rows and before[row + 1, col])
                    or (col > 0 and before[row, col - 1])
                    or (col + 1 < cols and before[row, col + 1])
                )
                if not touches:
                    continue
                at = find_row(evidence, corner[0] + row, corner[1] + col)
                is_occupied = at >= 0 and evidence.table[at, HIT] > since_s
                if not is_occupied and is_at_edge(cells, corner[0] + row, corner[1] + col):
                    mask[row, col] = 1
