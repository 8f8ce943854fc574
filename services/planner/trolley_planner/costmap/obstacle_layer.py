"""The costmap layer of the lidar: obstacles seen, cleared again, and forgotten."""

import math
from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.config import PlannerConfig
from trolley.gridmap.kernels import begin_march, disc_box, is_in_disc
from trolley.jit import kernel
from trolley.sight import SIGHT
from trolley_planner.sensing.beams import (
    CLEAR,
    DX,
    DY,
    ECHO,
    Sweep,
    X,
    Y,
    cut_at_lines,
    inside_polygon,
    place_beams_into,
    smooth_ranges_into,
)

NOTHING_DIRTY = (2**31, -1, 2**31, -1)


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
    """Echoes this near to a person's disc are theirs [m],"""
    trail_s: float = 0.5
    """and so is what was seen where they were within this time, if it is seen no more [s]."""
    widest_gap_rad: float = 0.06
    """Nothing is known between neighbouring beams farther apart than this."""
    all_round_rad: float = 1.95 * math.pi
    """A lidar that covers less does not look all round."""
    sight_scans: int = 3
    """Such a lidar looks where one of so many of the newest scans saw floor."""
    recent_s: float = 15.0
    """What it saw free is free for this long out of its view,"""
    kept_s: float = SIGHT.memory_s - 3.0
    """and to the end of what was begun in time for this long: at `base`'s creep that is 1.2 m. A
    little later `base` lets nobody drive there."""
    stood_s: float = SIGHT.trail_s - 20.0
    """Where the robot stood is free out of its view for this long: it leaves a dead end as it came;
    `base` lets it for 20 s more."""


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


class ObstacleLayer:
    """Obstacles that the lidar has seen and the map does not hold.

    Each cell carries evidence: echoes raise it, beams that see through lower it, so a thin leg
    that is hit by every third scan stays and a person who left is gone within a second.

    Args:
        shape: rows and columns.
        resolution_m: cell edge [m].
        config: ranges, tolerances and times.
    """

    def __init__(self, shape: tuple[int, int], resolution_m: float, config: PlannerConfig) -> None:
        self._resolution_m = resolution_m
        self._config = config
        self._scan_number = 0
        self._now_ticks = 0
        self._scans_ns: deque[int] = deque()
        self._walls = np.zeros(shape, dtype=np.uint8)
        self.looks_all_round = True
        """Whether the lidar of the newest scan does."""
        self.grid = ObstacleGrid(
            evidence=np.zeros(shape, dtype=np.uint8),
            hits=np.zeros(shape, dtype=np.uint8),
            seen_ticks=np.zeros(shape, dtype=np.int32),
            points=np.zeros((*shape, 2), dtype=np.float32),
            observed=np.zeros(shape, dtype=np.int32),
            stood_ticks=np.zeros(shape, dtype=np.int32),
            touched=np.zeros((*shape, 2), dtype=np.int32),
            dirty=np.array(NOTHING_DIRTY, dtype=np.int64),
        )
        self.beams = np.empty((0, 6), dtype=np.float64)
        """(n, 6) the newest scan in `grid`, cut at mirrors and walls (columns: sensing.beams)."""
        self.static_beams = self.beams
        """The same without the echoes of people."""

    def update(
        self,
        sweep: Sweep,
        walls: NDArray[np.uint8],
        wall_distance_m: NDArray[np.float32],
        segments: NDArray[np.float64],
        now_ns: int,
    ) -> None:
        """Clear what the beams of a scan pass and mark where their echoes lie.

        Args:
            sweep: the scan, with poses in `grid`.
            walls: (rows, cols), set where rays end for certain.
            wall_distance_m: (rows, cols) distance to the nearest wall [m].
            segments: (m, 4) mirrors, glass, and where mirrors are suspected, in `grid` [m].
            now_ns: robot time of the scan.
        """
        self._scan_number += 1
        self._walls = walls
        self._note_time(now_ns)
        self.looks_all_round = sweep.covered_rad >= OBSTACLES.all_round_rad
        config, beams = self._config, np.empty((sweep.ranges_m.shape[0], 6))
        ranges_m = np.empty(sweep.ranges_m.shape[0], dtype=np.float32)
        smooth_ranges_into(ranges_m, sweep.ranges_m, sweep.shape.angle_increment)
        place_beams_into(
            beams,
            ranges_m,
            sweep.shape,
            sweep.start.as_array(),
            sweep.end.as_array(),
            sweep.body_laser,
            config.clear_range_m,
        )
        cut_at_lines(beams, segments, config.mirror_tolerance_m)
        trace_beams(self.grid, walls, beams, self._resolution_m, self._scan_number)
        body_cells = sweep.end.transform_points(sweep.body_laser) / self._resolution_m
        self._now_ticks = ticks(now_ns)
        now = self._scan_number, self._now_ticks
        clear_inside_robot(self.grid, body_cells, self._resolution_m, now)
        limits = (
            self._resolution_m,
            config.mark_range_m,
            OBSTACLES.explained_cells * self._resolution_m,
        )
        mark_echoes(self.grid, wall_distance_m, beams, limits, *now)
        self.beams = self.static_beams = beams

    def take_over(self, other: "ObstacleLayer", rows: int, cols: int) -> None:
        """Take what another layer of the same resolution has seen, where both lie.

        Args:
            other: the layer before this one.
            rows: how many rows its corner lies above this one's; below is negative.
            cols: the same to the right.
        """
        mine, theirs = _overlap(self.grid.evidence.shape, other.grid.evidence.shape, rows, cols)
        for name, array in other.grid._asdict().items():
            if name != "dirty":
                getattr(self.grid, name)[mine] = array[theirs]
        corner_m = np.array([cols, rows], np.float32) * np.float32(self._resolution_m)
        self.grid.points[mine] += corner_m
        self._scan_number, self._now_ticks = other._scan_number, other._now_ticks
        self._scans_ns = other._scans_ns.copy()
        self.looks_all_round = other.looks_all_round
        self.mark_all_dirty()

    @property
    def in_sight_since(self) -> int:
        """Number of the scan since which a cell must have been observed to be in sight now."""
        if self.looks_all_round:
            return 0
        return max(self._scan_number - OBSTACLES.sight_scans, 0) + 1

    def remove_people(self, walkers: NDArray[np.float64]) -> None:
        """Remove people by the newest scan from what stands.

        Args:
            walkers: (n, 5) in `grid`: x, y [m], velocity [m/s], radius [m].
        """
        if len(walkers) > 0:
            self.static_beams = self.beams.copy()
            lift_echoes(self.static_beams, walkers)
            lift_cells(self.grid, walkers, self._resolution_m, self._scan_number)

    def is_known_free(
        self,
        rows: NDArray[np.int64],
        cols: NDArray[np.int64],
        within_s: float,
        stood_s: float = OBSTACLES.stood_s,
    ) -> NDArray[np.bool_]:
        """Say of cells (n,) whether the lidar saw them, and where it does not look, lately.

        Beside what stands no beam passes: there a neighbouring cell will do. Where the robot
        itself stood it may go back for longer.

        Args:
            rows: of the cells.
            cols: of the cells.
            within_s: what counts as lately, at most `OBSTACLES.kept_s`,
            stood_s: and where the robot stood.
        """
        observed, stood_ticks = self.grid.observed, self.grid.stood_ticks
        if self.looks_all_round:
            return observed[rows, cols] != 0
        last_row, last_col = observed.shape[0] - 1, observed.shape[1] - 1
        around = np.array([-1, 0, 1])
        near_rows = np.clip(rows[:, None, None] + around[:, None], 0, last_row)
        near_cols = np.clip(cols[:, None, None] + around, 0, last_col)
        since_ns = self._scans_ns[-1] - within_s * 1e9 if self._scans_ns else 0.0
        num_recent = sum(time_ns >= since_ns for time_ns in self._scans_ns)
        oldest = self._scan_number - num_recent + 1
        stood_since = max(self._now_ticks - stood_s / OBSTACLES.tick_s, 0.0)
        near = near_rows, near_cols
        known = (observed[near] >= oldest) | (stood_ticks[near] > stood_since)
        stands = (self.grid.evidence[near] != 0) | (self._walls[near] != 0)
        return known[:, 1, 1] | (stands.any(axis=(1, 2)) & known.any(axis=(1, 2)))

    def forget_old(self, now_ns: int) -> None:
        """Forget what has been out of sight for too long."""
        config = self._config
        kept = (config.fade_s, config.fade_per_sighting_s, config.fade_max_s)
        least, per_hit, most = (max(1, round(time / OBSTACLES.tick_s)) for time in kept)
        fade(self.grid, ticks(now_ns), (least, per_hit, most))

    def forget_around(self, x_grid: float, y_grid: float, radius_m: float) -> None:
        """Forget what was seen within a circle [m]."""
        scale = 1.0 / self._resolution_m
        forget_near(self.grid, x_grid * scale, y_grid * scale, radius_m * scale)

    def forget_all(self) -> None:
        """Forget everything that was seen, as after a jump of the pose."""
        for array in (self.grid.evidence, self.grid.hits, self.grid.observed):
            array.fill(0)
        self.mark_all_dirty()
        self.beams = self.static_beams = np.empty((0, 6), dtype=np.float64)

    def mark_all_dirty(self) -> None:
        """Say that anything may have changed."""
        rows, cols = self.grid.evidence.shape
        self.grid.dirty[:] = (0, rows - 1, 0, cols - 1)

    def _note_time(self, now_ns: int) -> None:
        """Note when this scan was made, and drop those that no longer matter."""
        times = self._scans_ns
        times.append(now_ns)
        while now_ns - times[0] > OBSTACLES.kept_s * 1e9:
            times.popleft()

    def pop_dirty(self) -> tuple[int, int, int, int] | None:
        """Return first and last row, first and last column of what changed since the last call."""
        first_row, last_row, first_col, last_col = self.grid.dirty.tolist()
        self.grid.dirty[:] = NOTHING_DIRTY
        return None if last_row < first_row else (first_row, last_row, first_col, last_col)


def ticks(now_ns: int) -> int:
    """Return robot time in the coarse unit that is kept per cell."""
    return int(now_ns * 1e-9 / OBSTACLES.tick_s) & 0x7FFFFFFF


def _overlap(
    mine: tuple[int, ...], theirs: tuple[int, ...], rows: int, cols: int
) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Return the parts of two grids that lie on each other; see `ObstacleLayer.take_over`."""
    here: list[slice] = []
    there: list[slice] = []
    for size, other, shift in zip(mine, theirs, (rows, cols), strict=True):
        first, end = max(shift, 0), max(min(other + shift, size), max(shift, 0))
        here.append(slice(first, end))
        there.append(slice(first - shift, end - shift))
    return (here[0], here[1]), (there[0], there[1])


@kernel
def see_through(grid: ObstacleGrid, row: int, col: int, scan_number: int) -> None:
    """Note that a beam passed a cell; evidence falls once a scan, however many beams pass."""
    if grid.observed[row, col] == 0:
        mark_dirty(grid.dirty, row, col)
    grid.observed[row, col] = scan_number
    if grid.evidence[row, col] == 0 or grid.touched[row, col, 0] == scan_number:
        return
    grid.touched[row, col, 0] = scan_number
    grid.evidence[row, col] -= 1
    if grid.evidence[row, col] == 0:
        grid.hits[row, col] = 0
        mark_dirty(grid.dirty, row, col)


@kernel
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


@kernel
def free_cells(beams: NDArray[np.float64], beam: int, resolution_m: float) -> float:
    """Return how far a beam clears [cells]: the cell of its echo and the one before are left."""
    reach = beams[beam, CLEAR] / resolution_m
    if beams[beam, ECHO] > 0.0:
        reach = min(reach, beams[beam, ECHO] / resolution_m - 0.7)
    return reach


@kernel
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


@kernel
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


@kernel
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


@kernel
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
                grid.evidence[row, col] = 0
                grid.hits[row, col] = 0
                mark_dirty(grid.dirty, row, col)


@kernel
def forget_near(grid: ObstacleGrid, x_cells: float, y_cells: float, radius_cells: float) -> None:
    """Forget every obstacle seen whose cell centre lies within a circle [cells]."""
    rows, cols = grid.evidence.shape
    top, left, bottom, right = disc_box(x_cells, y_cells, radius_cells, rows, cols)
    for row in range(top, bottom):
        for col in range(left, right):
            near = is_in_disc(row, col, x_cells, y_cells, radius_cells)
            if near and grid.evidence[row, col] > 0:
                grid.evidence[row, col] = 0
                grid.hits[row, col] = 0
                mark_dirty(grid.dirty, row, col)


@kernel
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
    for row in range(
        max(0, math.floor(polygon_cells[:, 1].min())),
        min(rows, math.ceil(polygon_cells[:, 1].max())),
    ):
        for col in range(
            max(0, math.floor(polygon_cells[:, 0].min())),
            min(cols, math.ceil(polygon_cells[:, 0].max())),
        ):
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
                grid.evidence[row, col] = 0
                grid.hits[row, col] = 0
                mark_dirty(grid.dirty, row, col)


@kernel
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


@kernel
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


@kernel
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
                    grid.evidence[row, col] = 0
                    grid.hits[row, col] = 0
                    mark_dirty(grid.dirty, row, col)


@kernel
def mark_dirty(dirty: NDArray[np.int64], row: int, col: int) -> None:
    """Extend the box of changed cells by one cell."""
    dirty[0] = min(dirty[0], row)
    dirty[1] = max(dirty[1], row)
    dirty[2] = min(dirty[2], col)
    dirty[3] = max(dirty[3], col)
