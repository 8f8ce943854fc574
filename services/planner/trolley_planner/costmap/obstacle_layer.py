"""The layer of the costmap that the lidar makes: obstacles seen, cleared again, and forgotten."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D
from trolley_planner.kernels.beams import (
    EchoLayer,
    ScanShape,
    cut_at_lines,
    place_beams_into,
    smooth_ranges_into,
)
from trolley_planner.kernels.echoes import (
    TICK_S,
    fade,
    forget_inside,
    forget_near,
    lift_cells,
    lift_echoes,
    mark_echoes,
    trace_beams,
)

NOTHING_DIRTY = (2**31, -1, 2**31, -1)

# An echo in the cell beside a wall of the map is that wall: surfaces lie on borders of cells.
EXPLAINED_CELLS = 1.2


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """One scan and how the lidar moved while it was taken.

    Attributes:
        ranges_m: (n,) float32; +inf = no echo, 0 or NaN = invalid.
        shape: how the beams lie in `laser`.
        start: pose of the lidar at the first beam, in the frame of the costmap.
        end: pose of the lidar at the last beam.
        body_laser: (m, 2) the robot's outline in `laser` [m].
    """

    ranges_m: NDArray[np.float32]
    shape: ScanShape
    start: Pose2D
    end: Pose2D
    body_laser: NDArray[np.float64]


class Echoes:
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
        self.layer = EchoLayer(
            evidence=np.zeros(shape, dtype=np.uint8),
            hits=np.zeros(shape, dtype=np.uint8),
            seen_ticks=np.zeros(shape, dtype=np.int32),
            points=np.zeros((*shape, 2), dtype=np.float32),
            observed=np.zeros(shape, dtype=np.uint8),
            touched=np.zeros((*shape, 2), dtype=np.int32),
            dirty=np.array(NOTHING_DIRTY, dtype=np.int64),
        )
        self.beams = np.empty((0, 6), dtype=np.float64)
        """(n, 6) the newest scan in `grid`, cut at mirrors and walls (columns: kernels.beams)."""
        self.standing = self.beams
        """The same without the echoes of who walks."""

    def add(
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
        trace_beams(self.layer, walls, beams, self._resolution_m, self._scan_number)
        body_cells = sweep.end.transform_points(sweep.body_laser) / self._resolution_m
        forget_inside(self.layer, body_cells, self._resolution_m)
        limits = (self._resolution_m, config.mark_range_m, EXPLAINED_CELLS * self._resolution_m)
        now_ticks = ticks(now_ns)
        mark_echoes(self.layer, wall_distance_m, beams, limits, self._scan_number, now_ticks)
        self.beams = self.standing = beams

    def lift(self, walkers: NDArray[np.float64]) -> None:
        """Take who walks by the newest scan out of what stands.

        Args:
            walkers: (n, 5) in `grid`: x, y [m], velocity [m/s], radius [m].
        """
        if len(walkers) > 0:
            self.standing = self.beams.copy()
            lift_echoes(self.standing, walkers)
            lift_cells(self.layer, walkers, self._resolution_m, self._scan_number)

    def forget_old(self, now_ns: int) -> None:
        """Forget what has been out of sight for too long."""
        config = self._config
        kept = (config.fade_s, config.fade_per_sighting_s, config.fade_max_s)
        least, per_hit, most = (max(1, round(time / TICK_S)) for time in kept)
        fade(self.layer, ticks(now_ns), (least, per_hit, most))

    def forget_around(self, x_grid: float, y_grid: float, radius_m: float) -> None:
        """Forget what was seen within a circle [m]."""
        scale = 1.0 / self._resolution_m
        forget_near(self.layer, x_grid * scale, y_grid * scale, radius_m * scale)

    def forget_all(self) -> None:
        """Forget everything that was seen, as after a jump of the pose."""
        for array in (self.layer.evidence, self.layer.hits, self.layer.observed):
            array.fill(0)
        self.touch_all()
        self.beams = self.standing = np.empty((0, 6), dtype=np.float64)

    def touch_all(self) -> None:
        """Say that anything may have changed."""
        rows, cols = self.layer.evidence.shape
        self.layer.dirty[:] = (0, rows - 1, 0, cols - 1)

    def take_dirty(self) -> tuple[int, int, int, int] | None:
        """Return first and last row, first and last column of what changed since the last call."""
        first_row, last_row, first_col, last_col = self.layer.dirty.tolist()
        self.layer.dirty[:] = NOTHING_DIRTY
        return None if last_row < first_row else (first_row, last_row, first_col, last_col)


def ticks(now_ns: int) -> int:
    """Return robot time in the coarse unit that is kept per cell."""
    return int(now_ns * 1e-9 / TICK_S) & 0x7FFFFFFF
