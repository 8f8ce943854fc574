"""The costmap layer of the lidar: obstacles seen, cleared again, and forgotten."""

from collections import deque

import numpy as np
from numpy.typing import NDArray

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D
from trolley.sight import LidarView
from trolley_planner.costmap.obstacle_grid import (
    OBSTACLES,
    ObstacleGrid,
    clear_inside_robot,
    fade,
    forget_near,
    lift_cells,
    lift_echoes,
    mark_echoes,
    seen_lately,
    trace_beams,
)
from trolley_planner.sensing.beams import (
    DX,
    DY,
    ECHO,
    Sweep,
    X,
    Y,
    cut_at_lines,
    place_beams_into,
    smooth_ranges_into,
)

NOTHING_DIRTY = (2**31, -1, 2**31, -1)


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
        self._view = LidarView()
        self.looks_all_round = True
        """Whether the lidar does."""
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
        self.echoes_m = np.empty(0, dtype=np.float64)
        """(n,) how far off the echoes of its beams lie, those in walls as well; 0 = none."""

    def update(
        self,
        sweep: Sweep,
        walls: NDArray[np.uint8],
        wall_distance_m: NDArray[np.float32],
        segments: NDArray[np.float64],
        now_ns: int,
        further: NDArray[np.float64],
    ) -> None:
        """Clear what the beams of a scan pass and mark where their echoes lie.

        Args:
            sweep: the scan, with poses in `grid`.
            walls: (rows, cols), set where rays end for certain.
            wall_distance_m: (rows, cols) distance to the nearest wall [m].
            segments: (m, 4) mirrors, glass, and where mirrors are suspected, in `grid` [m].
            now_ns: robot time of the scan.
            further: (n, 2) echoes of extra sensors in `grid` [m], which only mark.
        """
        self._scan_number += 1
        self._walls = walls
        self._note_time(now_ns)
        shape = sweep.shape
        self._view.note(sweep.ranges_m, shape.angle_min, shape.angle_increment)
        self.looks_all_round = self._view.is_all_round
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
        self.echoes_m = beams[:, ECHO].copy()
        trace_beams(self.grid, walls, beams, self._resolution_m, self._scan_number)
        limits = (
            self._resolution_m,
            config.mark_range_m,
            OBSTACLES.explained_cells * self._resolution_m,
        )
        self._now_ticks = ticks(now_ns)
        now = self._scan_number, self._now_ticks
        # Before the robot's own place is cleared, and apart from the beams that show people.
        if len(further) > 0:
            mark_echoes(self.grid, wall_distance_m, _beams_to(further, sweep.end), limits, *now)
        body_cells = sweep.end.transform_points(sweep.body_laser) / self._resolution_m
        clear_inside_robot(self.grid, body_cells, self._resolution_m, now)
        mark_echoes(self.grid, wall_distance_m, beams, limits, *now)
        self.beams = self.static_beams = beams

    def take_over(self, other: "ObstacleLayer", rows: int, cols: int) -> None:
        """Copy what another layer of the same resolution has seen, where both overlap.

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
        self._scan_number, self._now_ticks = other._scan_number, other._now_ticks  # noqa: SLF001
        self._scans_ns = other._scans_ns.copy()  # noqa: SLF001
        self._view, self.looks_all_round = other._view, other.looks_all_round  # noqa: SLF001
        self.mark_all_dirty()

    @property
    def in_sight_since(self) -> int:
        """Number of the scan since which a cell must have been observed to be in sight now."""
        if self.looks_all_round:
            return 0
        return max(self._scan_number - OBSTACLES.sight_scans, 0) + 1

    def remove_people(self, walkers: NDArray[np.float64]) -> None:
        """Remove the people of the newest scan from the obstacles.

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
        """Say which cells (n,) the lidar sees free, or saw free lately where it does not look.

        Beside what stands no beam passes: there a neighbouring cell will do. Where the robot
        itself stood it may go back for longer.

        Args:
            rows: of the cells.
            cols: of the cells.
            within_s: what counts as lately, at most `OBSTACLES.kept_s`,
            stood_s: and where the robot stood.
        """
        if self.looks_all_round:
            return self.grid.observed[rows, cols] != 0
        since_ns = self._scans_ns[-1] - within_s * 1e9 if self._scans_ns else 0.0
        num_recent = sum(time_ns >= since_ns for time_ns in self._scans_ns)
        since = self._scan_number - num_recent + 1, self._now_ticks - stood_s / OBSTACLES.tick_s
        return seen_lately(self.grid, self._walls, rows, cols, since)

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
        """Forget what was seen and where the robot stood, as after a jump of the pose."""
        grid = self.grid
        for array in (grid.evidence, grid.hits, grid.observed, grid.stood_ticks):
            array.fill(0)
        self._scans_ns.clear()
        self.mark_all_dirty()
        self.beams = self.static_beams = np.empty((0, 6), dtype=np.float64)
        self.echoes_m = np.empty(0, dtype=np.float64)

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


def _beams_to(points: NDArray[np.float64], start: Pose2D) -> NDArray[np.float64]:
    """Return beams (n, 6) that clear nothing and have their echoes at points (n, 2)."""
    beams = np.zeros((len(points), 6))
    beams[:, X], beams[:, Y] = start.x, start.y
    away = points - (start.x, start.y)
    beams[:, ECHO] = np.maximum(np.hypot(away[:, 0], away[:, 1]), np.finfo(np.float64).tiny)
    beams[:, DX], beams[:, DY] = (away / beams[:, ECHO, None]).T
    return beams


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
