"""What the lidar has seen in each cell: how echoes mark it, beams clear it, and time fades it."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.gridmap.kernels import begin_march, disc_box, is_in_disc
from trolley.jit import kernel, lean_kernel
from trolley.sight import SIGHT
from trolley_planner.sensing.beams import CLEAR, DX, DY, ECHO, X, Y, box_of, inside_polygon


class ObstacleParams(NamedTuple):
    """How echoes become obstacles and are forgotten; all by hand."""

    explained_cells: float = 1.2
    """An echo this near to a wall of the map is that wall: surfaces lie on borders of
    cells."""
    tick_s: float = 0.1
    """Unit of the times kept per cell [s]: coarse, so that 32 bits last for years."""
    most_evidence: int = 12
    """Scans without an echo that a well-seen obstacle outlives."""
    mark_evidence: int = 3
    """Evidence that each scan with an echo adds; one that sees through takes away 1."""
    person_margin_m: float = 0.05
    """Distance from a person's disc within which echoes belong to that person."""
    trail_s: float = 0.5
    """Time for which obstacles seen where a person was are taken for that person once unseen."""
    widest_gap_rad: float = 0.06
    """Angle between neighbouring beams above which the floor between them stays unknown."""
    sight_scans: int = 3
    """Number of newest scans that count as the present view of a lidar that does not see all round.
    """
    recent_s: float = 15.0
    """Time for which floor seen free stays free out of the lidar's view."""
    kept_s: float = SIGHT.memory_s - 3.0
    """Time for which floor seen free stays free for a drive that began within `recent_s`: 1.2 m at
    `base`'s creep speed. A little later `base` lets nobody drive there."""
    stood_s: float = SIGHT.trail_s - 20.0
    """Time for which floor that the robot stood on stays free out of view, so that it can leave a
    dead end as it came; 20 s less than `base`'s own limit."""


OBSTACLES = ObstacleParams()


class ObstacleGrid(NamedTuple):
    """What the lidar has seen, per cell: the arrays of `ObstacleLayer`."""

    evidence: NDArray[np.uint8]
    """(rows, cols) 0 = no obstacle seen."""
    hits: NDArray[np.uint8]
    """(rows, cols) scans that confirmed it, saturating."""
    seen_ticks: NDArray[np.int32]
    """(rows, cols) robot time of the last echo, in `OBSTACLES.tick_s`."""
    points: NDArray[np.float32]
    """(rows, cols, 2) where in the cell the last echo lay [m]."""
    observed: NDArray[np.int32]
    """(rows, cols) number of the scan in which a beam last passed, or over which the robot first
    stood; 0 = never."""
    stood_ticks: NDArray[np.int32]
    """(rows, cols) robot time when the robot last stood there, in `OBSTACLES.tick_s`; 0 = never."""
    touched: NDArray[np.int32]
    """(rows, cols, 2) number of the scan that last saw through, and that last marked."""
    dirty: NDArray[np.int64]
    """(4,) first and last row, first and last column of what changed since it was reset."""


@lean_kernel
def see_through(grid: ObstacleGrid, row: int, col: int, scan_number: int) -> None:
    """Note that a beam passed a cell; evidence falls once a scan, however many beams pass."""
    if grid.observed[row, col] == 0:
        mark_dirty(grid.dirty, row, col)
    grid.observed[row, col] = scan_number
    if grid.evidence[row, col] == 0 or grid.touched[row, col, 0] == scan_number:
        return
    grid.touched[row, col, 0] = scan_number
    if grid.evidence[row, col] > 1:
        grid.evidence[row, col] -= 1
    else:
        forget_cell(grid, row, col)


@lean_kernel
def trace_ray(
    grid: ObstacleGrid,
    walls: NDArray[np.uint8],
    ray: tuple[float, float, float, float],
    stretch: tuple[float, float],
    scan_number: int,
) -> float:
    """Clear the cells that a ray passes, up to the first wall of the map.

    Args:
        grid: changed in place.
        walls: (rows, cols), set where rays end.
        ray: x, y of its start and its direction [cells].
        stretch: distance from which on it clears, and where it ends [cells].
        scan_number: differs from that of every other scan.

    Returns:
        How far it ran into a wall [cells], infinity where there was none.
    """
    rows, cols = walls.shape
    x, y, dx, dy = ray
    observed, evidence = grid.observed, grid.evidence
    at = begin_march((x, y), (dx, dy), (math.floor(y), math.floor(x)), 0.0)
    row, col, travelled, next_col, next_row = at[:5]
    while travelled < stretch[1] and 0 <= row < rows and 0 <= col < cols:
        if walls[row, col]:
            return travelled
        if travelled >= stretch[0]:
            if observed[row, col] == 0 or evidence[row, col] != 0:
                see_through(grid, row, col, scan_number)
            observed[row, col] = scan_number
        # As `next_cell`, but without a branch, which would be foreseen wrongly half the time.
        is_col = next_col < next_row
        travelled = min(next_col, next_row)
        col += at.step_col if is_col else 0
        row += 0 if is_col else at.step_row
        next_col += at.per_col if is_col else 0.0
        next_row += 0.0 if is_col else at.per_row
    return math.inf


@lean_kernel
def free_cells(beams: NDArray[np.float64], beam: int, resolution_m: float) -> float:
    """Return how far a beam clears [cells]: the cell of its echo and the one before are left."""
    reach = beams[beam, CLEAR] / resolution_m
    if beams[beam, ECHO] > 0.0:
        reach = min(reach, beams[beam, ECHO] / resolution_m - 0.7)
    return reach


@lean_kernel
def trace_beams(
    grid: ObstacleGrid,
    walls: NDArray[np.uint8],
    beams: NDArray[np.float64],
    resolution_m: float,
    scan_number: int,
) -> None:
    """Clear the cells that beams pass, up to the first wall of the map, and those between them.

    What a beam shows behind a wall of the map is a reflection or an error of the pose: its echo
    is dropped, and nothing behind the wall is cleared. Far away neighbours are more than a cell
    apart: what both of them pass is free between them, too.

    Args:
        grid: changed in place.
        walls: (rows, cols), set where rays end.
        beams: (n, 6); echoes behind walls are set to 0.
        resolution_m: cell edge [m].
        scan_number: differs from that of every other scan.
    """
    for beam in range(beams.shape[0]):
        reach = free_cells(beams, beam, resolution_m)
        if reach > 0.0:
            x, y = beams[beam, X] / resolution_m, beams[beam, Y] / resolution_m
            ray = (x, y, beams[beam, DX], beams[beam, DY])
            stopped = trace_ray(grid, walls, ray, (0.0, reach), scan_number)
            if stopped < math.inf:
                beams[beam, ECHO] = 0.0
                beams[beam, CLEAR] = stopped * resolution_m
    for beam in range(beams.shape[0] - 1):
        clear_between(grid, walls, beams, beam, resolution_m, scan_number)


@lean_kernel
def clear_between(
    grid: ObstacleGrid,
    walls: NDArray[np.uint8],
    beams: NDArray[np.float64],
    beam: int,
    resolution_m: float,
    scan_number: int,
) -> None:
    """Clear the cells between a beam and the next one, from where they are a cell apart."""
    reach = min(free_cells(beams, beam, resolution_m), free_cells(beams, beam + 1, resolution_m))
    dx, dy = beams[beam, DX], beams[beam, DY]
    turn_x, turn_y = beams[beam + 1, DX] - dx, beams[beam + 1, DY] - dy
    spread = math.hypot(turn_x, turn_y)
    if reach * spread <= 1.0 or spread > OBSTACLES.widest_gap_rad:
        return
    between = math.ceil(reach * spread) - 1
    x, y = beams[beam, X] / resolution_m, beams[beam, Y] / resolution_m
    for index in range(between):
        share = (index + 1.0) / (between + 1.0)
        ray = (x, y, dx + share * turn_x, dy + share * turn_y)
        trace_ray(grid, walls, ray, (1.0 / spread, reach), scan_number)


@lean_kernel
def mark_echoes(
    grid: ObstacleGrid,
    wall_distance_m: NDArray[np.float32],
    beams: NDArray[np.float64],
    limits_m: tuple[float, float, float],
    scan_number: int,
    now_ticks: int,
) -> None:
    """Mark the cells of echoes that the map does not explain.

    Args:
        grid: changed in place.
        wall_distance_m: (rows, cols) distance of each cell to the nearest wall of the map.
        beams: (n, 6).
        limits_m: cell edge; echoes farther than the second are not marked; echoes nearer to a
            wall than the third are the wall.
        scan_number: of this scan, as in `trace_beams`, which comes first.
        now_ticks: robot time of the scan, in `OBSTACLES.tick_s`.
    """
    rows, cols = wall_distance_m.shape
    resolution_m, mark_max_m, explained_m = limits_m
    for beam in range(beams.shape[0]):
        echo = beams[beam, ECHO]
        if echo <= 0.0 or echo > mark_max_m:
            continue
        x = beams[beam, X] + echo * beams[beam, DX]
        y = beams[beam, Y] + echo * beams[beam, DY]
        row, col = math.floor(y / resolution_m), math.floor(x / resolution_m)
        if not (0 <= row < rows and 0 <= col < cols) or wall_distance_m[row, col] < explained_m:
            continue
        grid.points[row, col, 0] = x
        grid.points[row, col, 1] = y
        if grid.touched[row, col, 1] == scan_number:
            continue
        grid.touched[row, col, 1] = scan_number
        grid.seen_ticks[row, col] = now_ticks
        # A beam beside the echo may have seen through the same cell in this scan.
        passed = 1 if grid.touched[row, col, 0] == scan_number else 0
        before = int(grid.evidence[row, col]) + passed
        if grid.evidence[row, col] == 0:
            mark_dirty(grid.dirty, row, col)
        grid.evidence[row, col] = min(before + OBSTACLES.mark_evidence, OBSTACLES.most_evidence)
        grid.hits[row, col] = min(int(grid.hits[row, col]) + 1, 255)


@lean_kernel
def fade(grid: ObstacleGrid, now_ticks: int, kept_ticks: tuple[int, int, int]) -> None:
    """Forget what has not been seen for long: the sooner, the less often it was confirmed.

    People leave few echoes in each cell, furniture many, so what moves is forgotten first.

    Args:
        grid: changed in place.
        now_ticks: robot time, in `OBSTACLES.tick_s`.
        kept_ticks: how long a cell is kept at least, how much longer for each scan that
            confirmed it, and how long at most.
    """
    rows, cols = grid.evidence.shape
    least, per_hit, most = kept_ticks
    for row in range(rows):
        for col in range(cols):
            if grid.evidence[row, col] == 0:
                continue
            kept = min(least + per_hit * int(grid.hits[row, col]), most)
            if now_ticks - grid.seen_ticks[row, col] > kept:
                forget_cell(grid, row, col)


@lean_kernel
def forget_near(grid: ObstacleGrid, x_cells: float, y_cells: float, radius_cells: float) -> None:
    """Forget every obstacle seen whose cell centre lies within a circle [cells]."""
    rows, cols = grid.evidence.shape
    top, left, bottom, right = disc_box(x_cells, y_cells, radius_cells, rows, cols)
    for row in range(top, bottom):
        for col in range(left, right):
            near = is_in_disc(row, col, x_cells, y_cells, radius_cells)
            if near and grid.evidence[row, col] > 0:
                forget_cell(grid, row, col)


@lean_kernel
def clear_inside_robot(
    grid: ObstacleGrid,
    polygon_cells: NDArray[np.float64],
    resolution_m: float,
    now: tuple[int, int],
) -> None:
    """Forget every obstacle whose last echo lay inside a polygon (n, 2) [cells], and know it free.

    Nothing else can be where the robot is; a lidar that does not look all around would never see
    that what it once saw there is gone, nor the place that the robot set off from, and would not
    let it back up to there. `now` is the number of the scan and its time, in `OBSTACLES.tick_s`.
    """
    rows, cols = grid.evidence.shape
    low_x, low_y, high_x, high_y = box_of(polygon_cells)
    for row in range(max(0, math.floor(low_y)), min(rows, math.ceil(high_y))):
        for col in range(max(0, math.floor(low_x)), min(cols, math.ceil(high_x))):
            if inside_polygon(polygon_cells, col + 0.5, row + 0.5):
                if grid.observed[row, col] == 0:
                    mark_dirty(grid.dirty, row, col)
                    grid.observed[row, col] = now[0]
                grid.stood_ticks[row, col] = now[1]
            if grid.evidence[row, col] == 0:
                continue
            x = grid.points[row, col, 0] / resolution_m
            y = grid.points[row, col, 1] / resolution_m
            if inside_polygon(polygon_cells, x, y):
                forget_cell(grid, row, col)


@kernel
def seen_lately(
    grid: ObstacleGrid,
    walls: NDArray[np.uint8],
    rows: NDArray[np.int64],
    cols: NDArray[np.int64],
    since: tuple[int, float],
) -> NDArray[np.bool_]:
    """Say for cells (n,) whether beams passed lately, or beside what stands, in a cell beside them.

    Args:
        grid: what was seen.
        walls: (rows, cols), set where rays end for certain.
        rows: of the cells.
        cols: of the cells.
        since: number of the scan since which beams must have passed, and robot time after which the
            robot must have stood there else, in `OBSTACLES.tick_s`.
    """
    observed, stood_ticks, evidence = grid.observed, grid.stood_ticks, grid.evidence
    first_scan, first_ticks = since[0], max(since[1], 0.0)
    last_row, last_col = walls.shape[0] - 1, walls.shape[1] - 1
    seen = np.empty(rows.shape[0], np.bool_)
    for index in range(rows.shape[0]):
        row, col = rows[index], cols[index]
        is_seen = observed[row, col] >= first_scan or stood_ticks[row, col] > first_ticks
        if not is_seen:
            is_occupied, is_beside = False, False
            for near_row in range(max(row - 1, 0), min(row + 1, last_row) + 1):
                for near_col in range(max(col - 1, 0), min(col + 1, last_col) + 1):
                    is_occupied |= (
                        evidence[near_row, near_col] != 0 or walls[near_row, near_col] != 0
                    )
                    is_beside |= (
                        observed[near_row, near_col] >= first_scan
                        or stood_ticks[near_row, near_col] > first_ticks
                    )
            is_seen = is_occupied and is_beside
        seen[index] = is_seen
    return seen


@lean_kernel
def off_trail(walker: NDArray[np.float64], x: float, y: float, trail_s: float) -> float:
    """Return how far a point is from where a person was within the last `trail_s` [m].

    Args:
        walker: (5,) x, y [m], velocity [m/s], radius [m].
        x: [m].
        y: [m].
        trail_s: 0 for where they are.
    """
    dx, dy, vx, vy = x - walker[0], y - walker[1], walker[2], walker[3]
    squared = vx * vx + vy * vy
    ago_s = -(dx * vx + dy * vy) / squared if squared > 0.0 else 0.0
    ago_s = min(max(ago_s, 0.0), trail_s)
    return math.hypot(dx + ago_s * vx, dy + ago_s * vy) - walker[4]


@lean_kernel
def lift_echoes(beams: NDArray[np.float64], walkers: NDArray[np.float64]) -> None:
    """Set the echoes of people (n, 5) to 0 in beams (m, 6)."""
    for beam in range(beams.shape[0]):
        echo = beams[beam, ECHO]
        if echo <= 0.0:
            continue
        x = beams[beam, X] + echo * beams[beam, DX]
        y = beams[beam, Y] + echo * beams[beam, DY]
        for index in range(walkers.shape[0]):
            if off_trail(walkers[index], x, y, 0.0) < OBSTACLES.person_margin_m:
                beams[beam, ECHO] = 0.0


@lean_kernel
def lift_cells(
    grid: ObstacleGrid, walkers: NDArray[np.float64], resolution_m: float, scan_number: int
) -> None:
    """Forget what was seen of people, and where they were unless it is still seen.

    Args:
        grid: changed in place.
        walkers: (n, 5) x, y [m], velocity [m/s], radius [m].
        resolution_m: cell edge [m].
        scan_number: of the newest scan.
    """
    rows, cols = grid.evidence.shape
    for index in range(walkers.shape[0]):
        x, y, vx, vy, radius = walkers[index]
        back_x, back_y, reach = (
            x - OBSTACLES.trail_s * vx,
            y - OBSTACLES.trail_s * vy,
            radius + OBSTACLES.person_margin_m,
        )
        first_row = max(0, math.floor((min(y, back_y) - reach) / resolution_m))
        end_row = min(rows, math.ceil((max(y, back_y) + reach) / resolution_m))
        first_col = max(0, math.floor((min(x, back_x) - reach) / resolution_m))
        end_col = min(cols, math.ceil((max(x, back_x) + reach) / resolution_m))
        for row in range(first_row, end_row):
            for col in range(first_col, end_col):
                if grid.evidence[row, col] == 0:
                    continue
                trail_s = 0.0 if grid.touched[row, col, 1] == scan_number else OBSTACLES.trail_s
                px, py = grid.points[row, col, 0], grid.points[row, col, 1]
                if off_trail(walkers[index], px, py, trail_s) < OBSTACLES.person_margin_m:
                    forget_cell(grid, row, col)


@lean_kernel
def mark_dirty(dirty: NDArray[np.int64], row: int, col: int) -> None:
    """Extend the box of changed cells by one cell."""
    dirty[0] = min(dirty[0], row)
    dirty[1] = max(dirty[1], row)
    dirty[2] = min(dirty[2], col)
    dirty[3] = max(dirty[3], col)


@lean_kernel
def forget_cell(grid: ObstacleGrid, row: int, col: int) -> None:
    """Forget the obstacle seen in a cell."""
    grid.evidence[row, col] = 0
    grid.hits[row, col] = 0
    mark_dirty(grid.dirty, row, col)
