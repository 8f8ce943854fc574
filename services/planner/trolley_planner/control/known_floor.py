"""Floor that the robot has seen and may back over. As in `base`, a cell is met in its middle."""

import itertools

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.geometry.polygon import polygon_contains
from trolley.sight import SIGHT
from trolley_planner.costmap.costmap import Costmap
from trolley_planner.costmap.fine_grid import FineGrid
from trolley_planner.costmap.footprint import Footprint
from trolley_planner.costmap.inflation import UNKNOWN, WALL
from trolley_planner.costmap.obstacle_grid import OBSTACLES
from trolley_planner.paths.hybrid_astar.search_space import IN_SIGHT, NEVER_SEEN, OUT_OF_SIGHT

BACK_STEPS_M = (0.05, 0.1, 0.15)
"""Distances behind the robot at which the floor must be known before it backs up [m]."""
FAR_STEPS_M = (*BACK_STEPS_M, 0.2, 0.25, 0.3)
"""The same before it backs up as fast as it drives: it brakes from 0.5 m/s within these."""
STILL_SEEN_M = 0.4
"""What lies farther off is out of sight before the robot has backed there, unless its lidar looks
all round [m]."""
MIDDLE_CELLS = 0.25
"""Distance from a cell's centre, along both axes, within which a point is in its middle [cells]."""


class KnownFloor:
    """Tells which places are known to be free.

    Args:
        costmap: what was seen where.
        footprint: of the robot.
    """

    def __init__(self, costmap: Costmap, footprint: Footprint) -> None:
        self._costmap = costmap
        self._edge = footprint.edge_points
        self._radius_m = footprint.circumscribed_m
        self._behind = _points_behind(footprint, BACK_STEPS_M)
        self._far_behind = _points_behind(footprint, FAR_STEPS_M)

    def sees_behind(self, pose: Pose2D) -> bool:
        """Say whether the floor behind the robot is known.

        A lidar that looks all round goes on looking there, so the map will do, too. Any other must
        have seen lately that it is free, or the map must have a wall there, which costs enough.

        Args:
            pose: of the robot in `grid`.
        """
        return self._knows(pose.transform_points(self._behind))

    def looks_behind(self, pose: Pose2D) -> bool:
        """Say whether the lidar looks at the floor behind the robot, and knows it.

        Args:
            pose: of the robot in `grid`.
        """
        all_round = self._costmap.obstacle_layer.looks_all_round
        return all_round and self._knows(pose.transform_points(self._far_behind))

    def sees_along(self, poses: NDArray[np.float64]) -> bool:
        """Say whether the floor along poses (n, 3) that it backs through is known."""
        moved = [Pose2D(*pose.tolist()).transform_points(self._edge) for pose in poses]
        points = np.concatenate(moved)
        off = np.abs(points / self._costmap.resolution_m % 1.0 - 0.5)
        return self._knows(points[(off <= MIDDLE_CELLS).all(axis=1)])

    def in_fine_cells(
        self, grid: FineGrid, first: tuple[int, int], place: Pose2D
    ) -> NDArray[np.uint8]:
        """Return how the floor of each fine cell is known: IN_SIGHT, OUT_OF_SIGHT or NEVER_SEEN.

        Args:
            grid: of the fine cells.
            first: row and column of the costmap at its corner.
            place: of the robot in `grid`.
        """
        num_rows, num_cols = (size // grid.parts for size in grid.mask.shape)
        rows, cols = np.indices((num_rows, num_cols))
        rows, cols = rows + first[0], cols + first[1]
        known = self._is_known(rows, cols, OBSTACLES.recent_s)
        is_in_sight = known & self._is_fresh(rows, cols)
        if not self._costmap.obstacle_layer.looks_all_round:
            cell_m = self._costmap.resolution_m
            away_m = np.hypot((cols + 0.5) * cell_m - place.x, (rows + 0.5) * cell_m - place.y)
            is_in_sight &= away_m < STILL_SEEN_M + self._radius_m
        unseen = grid.divided(np.where(is_in_sight, IN_SIGHT, OUT_OF_SIGHT))
        middle = {(grid.parts - 1) // 2, grid.parts // 2}
        for row, col in itertools.product(middle, repeat=2):
            unseen[row :: grid.parts, col :: grid.parts][~known] = NEVER_SEEN
        return unseen

    def _knows(self, points: NDArray[np.float64]) -> bool:
        """Say whether the robot may back into all of some points (n, 2) in `grid`."""
        cells = np.floor(points / self._costmap.resolution_m)
        cols, rows = cells.astype(np.int64).T
        return bool(self._is_known(rows, cols, OBSTACLES.kept_s).all())

    def _is_known(
        self, rows: NDArray[np.int64], cols: NDArray[np.int64], within_s: float
    ) -> NDArray[np.bool_]:
        """Say of cells of the costmap, also outside it, whether the robot may back into them.

        Args:
            rows: of the cells.
            cols: of the cells.
            within_s: what was seen so lately counts where the lidar does not look now.
        """
        costmap = self._costmap
        shape, flat = rows.shape, (rows.reshape(-1), cols.reshape(-1))
        rows, cols = (
            np.clip(at, 0, size - 1) for at, size in zip(flat, costmap.shape, strict=True)
        )
        may_be = costmap.unknown_is_free | ((rows == flat[0]) & (cols == flat[1]))
        layer, kinds = costmap.obstacle_layer, costmap.static.kinds[rows, cols]
        known = kinds != UNKNOWN if layer.looks_all_round else kinds == WALL
        known |= layer.is_known_free(rows, cols, within_s)
        return (known & may_be).reshape(shape)

    def _is_fresh(self, rows: NDArray[np.int64], cols: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Say of known cells, also outside the costmap, whether `base` lets the robot hurry there.

        Args:
            rows: of the cells.
            cols: of the cells.
        """
        layer = self._costmap.obstacle_layer
        if layer.looks_all_round:
            return np.ones(rows.shape, dtype=np.bool_)
        last_row, last_col = (size - 1 for size in self._costmap.shape)
        flat = np.clip(rows.reshape(-1), 0, last_row), np.clip(cols.reshape(-1), 0, last_col)
        return layer.is_known_free(*flat, SIGHT.fresh_s, SIGHT.fresh_s).reshape(rows.shape)


def _points_behind(footprint: Footprint, steps_m: tuple[float, ...]) -> NDArray[np.float64]:
    """Return points (n, 2) in `base_link` that the outline sweeps next when it backs up."""
    shifts = [footprint.edge_points - (distance_m, 0.0) for distance_m in steps_m]
    points = np.concatenate(shifts)
    return points[~polygon_contains(footprint.polygon, points)]
