"""The local costmap: exact distances around the robot, and the cost-to-go along the path."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D
from trolley.geometry.polygon import polygon_contains
from trolley.jit import kernel
from trolley.sight import SIGHT
from trolley_planner.costmap.costmap import TABLE_STEP_M, Costmap
from trolley_planner.costmap.fine_grid import FINE, FineGrid
from trolley_planner.costmap.footprint import NO_LIMITS, Field, Footprint
from trolley_planner.costmap.inflation import (
    LETHAL,
    UNKNOWN,
    WALL,
    WEIGHT_UNIT,
    inflation_table,
    soften_disc,
    weigh_into,
)
from trolley_planner.costmap.obstacle_layer import OBSTACLES
from trolley_planner.paths.search import STEP, UNREACHED, cost_to_go_into, make_queue
from trolley_planner.people.moving_obstacles import NO_ROBOTS, NOBODY


@dataclass(frozen=True, slots=True)
class LocalCostmapParams:
    """Cells and costs of the local costmap; all by hand."""

    fine_m: float = 0.03
    """Largest edge of a fine cell where there would be too many of the finest."""
    most_fine_cells: int = 350
    """Most of the finest cells along the edge of the local costmap."""
    unreached_m: float = 100.0
    """Cost-to-go of places from which no path leads on."""
    edge_rise_m: float = 0.5
    """Beside reached places the cost-to-go rises by this much from cell to cell,"""
    edge_cells: int = 3
    """over this many cells."""
    middle_cells: float = 0.25
    """Nearer to the middle of a cell than this along both axes is in its middle."""
    border_cells: float = 0.02
    """Points of the path this near to the border of two cells belong to both."""
    escape_m: float = 0.3
    """Within this radius around the robot lethal cells are passable,"""
    escape_weight: int = 240
    """at this weight."""
    tight_weight: int = 80
    """Weight of places with less than the usual clearance, where they may be passed at all."""
    narrow_m: float = 0.08
    """With less room than this beside the robot"""
    narrow_factor: float = 3.0
    """a metre of the path counts this much: getting on must be worth driving close to walls,
    and backwards too."""


LOCAL = LocalCostmapParams()
TIGHT_CLEARANCE_M = 0.005
"""Clearance in places that are passed only because there is no other path [m]."""
BACK_STEPS_M = (0.05, 0.1, 0.15)
"""To back up, the robot must know what is this far behind it [m]."""


class LocalCostmap:
    """A square of fine cells that moves with the robot; its arrays are made once.

    Args:
        costmap: what stands where.
        footprint: of the robot.
        config: costs.
        half_m: from the robot to the local costmap's edge [m].
    """

    def __init__(
        self, costmap: Costmap, footprint: Footprint, config: PlannerConfig, half_m: float
    ) -> None:
        self._costmap = costmap
        is_small = 2.0 * half_m / FINE.finest_m < LOCAL.most_fine_cells
        edge_m = FINE.finest_m if is_small else LOCAL.fine_m
        needed = footprint.circumscribed_m + config.caution_distance_m + 0.1
        self._table = inflation_table(
            footprint.inscribed_m + config.clearance_m,
            config.inflation_falloff_m,
            config.inflation_height,
            TABLE_STEP_M,
            WEIGHT_UNIT,
        )
        self.fine_grid = FineGrid(costmap, edge_m, max(self._table.shape[0] * TABLE_STEP_M, needed))
        """What stands around the robot."""
        parts, self.fine_m = self.fine_grid.parts, self.fine_grid.fine_m
        self._group = max(1, round(0.05 / self.fine_m))
        self.coarse_m = self._group * self.fine_m
        # A multiple of both kinds of cells.
        unit = math.lcm(parts, self._group)
        cells = unit * math.ceil(2.0 * half_m / self.fine_m / unit)
        self._map_cells = cells // parts
        self._coarse_cells = cells // self._group
        coarse = (self._coarse_cells,) * 2
        self._coarse_m = np.zeros(coarse, dtype=np.float32)
        self._weights = np.zeros(coarse, dtype=np.uint8)
        self._costs = np.zeros(self._coarse_cells**2, dtype=np.int32)
        self._cost_m = np.zeros(coarse, dtype=np.float32)
        self._queue = make_queue(self._coarse_cells**2)
        near = footprint.inscribed_m + np.array([TIGHT_CLEARANCE_M, config.clearance_m])
        self._tight_table = self._table.copy()
        first, last = np.ceil(near / TABLE_STEP_M).astype(np.int64)
        self._tight_table[first:last] = LOCAL.tight_weight
        self._edge, self._behind = footprint.edge_points, _points_behind(footprint)
        self._x = self._y = 0.0
        self._robot_cell = 0
        self._narrow_m = footprint.inscribed_m + LOCAL.narrow_m
        self._price_of_path = 1.0
        self._walkers, self._robots = NOBODY, NO_ROBOTS
        self.body = footprint.body

    def update_moving(self, now_ns: int) -> None:
        """Move those who walk, and other robots, on to where they are now."""
        self._walkers = self._costmap.moving.walkers_at(now_ns)
        self._robots = self._costmap.moving.robots_at(now_ns)

    def leave_people_out(self) -> None:
        """Take nobody to walk, until `update_moving`."""
        self._walkers = NOBODY

    def walkers_now(self) -> NDArray[np.float64]:
        """Return the discs (n, 6) of those who walk, see `Field.walkers`; a copy."""
        return self._walkers.copy()

    def is_anyone_near(self, pose: Pose2D, within_m: float) -> bool:
        """Say whether somebody walks, or another robot drives, this near to a place [m]."""
        now = self._robots[:, 0]
        moving = np.concatenate([self._walkers[:, [0, 1, 4]], now])
        away = np.hypot(moving[:, 0] - pose.x, moving[:, 1] - pose.y) - moving[:, 2]
        return bool((away < within_m).any())

    def update(self, x: float, y: float, is_tight: bool = False) -> None:
        """Centre on a point of `grid` [m] and compute the distances there anew.

        Args:
            x: of the robot.
            y: of the robot.
            is_tight: whether the path may lead where there is less than the usual clearance.
        """
        resolution = self._costmap.resolution_m
        half = self._map_cells // 2
        first = math.floor(y / resolution) - half, math.floor(x / resolution) - half
        self.fine_grid.update(first, (self._map_cells, self._map_cells))
        self._x, self._y = self.fine_grid.x, self.fine_grid.y
        coarsen_into(self._coarse_m, self.fine_grid.distance_m, self._group)
        table = self._tight_table if is_tight else self._table
        weigh_into(self._weights, self._coarse_m, table, TABLE_STEP_M)
        self._weights[0] = self._weights[-1] = LETHAL
        self._weights[:, 0] = self._weights[:, -1] = LETHAL
        centre = (x - self._x) / self.coarse_m, (y - self._y) / self.coarse_m
        self._robot_cell = math.floor(centre[1]) * self._coarse_cells + math.floor(centre[0])
        room_m = self._coarse_m.reshape(-1)[self._robot_cell]
        # A robot that stepped aside for somebody is near a wall, too, and in no hurry.
        is_narrow = is_tight or (room_m < self._narrow_m and not self._costmap.moving.people)
        self._price_of_path = LOCAL.narrow_factor if is_narrow else 1.0
        soften_disc(
            self._weights,
            self._coarse_m,
            centre,
            LOCAL.escape_m / self.coarse_m,
            LOCAL.escape_weight,
        )

    def compute_cost_to_go(
        self, points: NDArray[np.float64], remaining_m: NDArray[np.float64]
    ) -> bool:
        """Compute the cost-to-go towards these points of the path.

        If something stands on the path only the points behind it count, so that the robot drives
        around it; if there is no way around, those before it, and the answer is False.

        Args:
            points: (n, 2) in `grid` [m], in the order of the path, the first near the robot;
                those outside the local costmap are left out.
            remaining_m: (n,) cost of the path from each point on [m of free floor].
        """
        # A path along the border of two rows of cells counts for both.
        points, remaining_m = np.repeat(points, 2, axis=0), np.repeat(remaining_m, 2)
        beside = np.resize((-LOCAL.border_cells, LOCAL.border_cells), len(points))[:, None]
        on_window = (points - (self._x, self._y)) / self.coarse_m + beside
        cells = np.floor(on_window).astype(np.int32)
        inside = ((cells > 0) & (cells < self._coarse_cells - 1)).all(axis=1)
        cells = cells[inside]
        price = self._price_of_path * self.cost_of_metre
        prices = np.rint(remaining_m[inside] * price).astype(np.int32)
        blocked = np.flatnonzero(self._weights[cells[:, 1], cells[:, 0]] == LETHAL)
        flat = np.stack([cells[:, 1] * self._coarse_cells + cells[:, 0], prices], axis=1)
        if blocked.size == 0:
            return self._spread(flat)
        if self._spread(flat[blocked[-1] + 1 :]):
            return True
        self._spread(flat[: blocked[0]])
        return False

    def _spread(self, seeds: NDArray[np.int32]) -> bool:
        """Compute the cost-to-go to seeds (cell, cost); say whether the robot can reach one."""
        ordered = np.ascontiguousarray(seeds[np.argsort(seeds[:, 1], kind="stable")])
        size = self._coarse_cells
        flat = self._weights.reshape(-1)
        cost_to_go_into(self._costs, flat, self._queue, ordered, size, (-1, 0), 8)
        costs_to_metres(self._cost_m, self._costs, 1.0 / self.cost_of_metre, LOCAL.unreached_m)
        slope_edges(self._cost_m, LOCAL.unreached_m, LOCAL.edge_rise_m, LOCAL.edge_cells)
        return bool(self._costs[self._robot_cell] != UNREACHED)

    def sees_behind(self, pose: Pose2D) -> bool:
        """Say whether what the robot would back into is known.

        A lidar that looks all round goes on looking there, so the map will do, too. Any other must
        have seen lately that it is free, or the map must have a wall there, which costs enough.

        Args:
            pose: of the robot in `grid`.
        """
        return self._knows(pose.transform_points(self._behind))

    def sees_along(self, poses: NDArray[np.float64]) -> bool:
        """Say whether what the robot would back into is known, on its way along poses (n, 3)."""
        moved = [Pose2D(*pose.tolist()).transform_points(self._edge) for pose in poses]
        points = np.concatenate(moved)
        # As in `base`, a cell is met where its middle is.
        off = np.abs(points / self._costmap.resolution_m % 1.0 - 0.5)
        return self._knows(points[(off <= LOCAL.middle_cells).all(axis=1)])

    def _knows(self, points: NDArray[np.float64]) -> bool:
        """Say whether the robot may back into all of some points (n, 2) in `grid`."""
        cells = np.floor(points / self._costmap.resolution_m)
        cols, rows = cells.astype(np.int64).T
        return bool(self.is_known(rows, cols, OBSTACLES.kept_s).all())

    def is_known(
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
        layer, kinds = costmap.obstacle_layer, costmap.kinds[rows, cols]
        known = kinds != UNKNOWN if layer.looks_all_round else kinds == WALL
        return (known | layer.is_known_free(rows, cols, within_s)).reshape(shape)

    def is_fresh(self, rows: NDArray[np.int64], cols: NDArray[np.int64]) -> NDArray[np.bool_]:
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

    @property
    def cost_of_metre(self) -> float:
        """Units of cost in one metre of free floor."""
        return 2 * STEP * WEIGHT_UNIT / self.coarse_m

    @property
    def field(self) -> Field:
        """What the kernels look up."""
        costmap = self._costmap
        limits = costmap.speed_limits if costmap.has_speed_limits else NO_LIMITS
        return Field(
            self.fine_grid.distance_m,
            self._cost_m,
            limits,
            self._x,
            self._y,
            self.fine_m,
            self.coarse_m,
            costmap.resolution_m,
            self._walkers,
            self._robots,
        )


def _points_behind(footprint: Footprint) -> NDArray[np.float64]:
    """Return points (n, 2) in `base_link` that the outline sweeps next when it backs up."""
    shifts = [footprint.edge_points - (distance_m, 0.0) for distance_m in BACK_STEPS_M]
    points = np.concatenate(shifts)
    return points[~polygon_contains(footprint.polygon, points)]


@kernel
def coarsen_into(out_m: NDArray[np.float32], distance_m: NDArray[np.float32], parts: int) -> None:
    """Write the largest distance in each coarse cell.

    Passages should not close where the footprint still fits; rollouts are checked exactly.

    Args:
        out_m: (rows, cols) coarse cells, overwritten.
        distance_m: (rows * parts, cols * parts) fine cells.
        parts: fine cells in the edge of a coarse cell.
    """
    rows, cols = out_m.shape
    line = np.empty(cols * parts, np.float32)
    for row in range(rows):
        line[:] = distance_m[row * parts, : line.shape[0]]
        for part in range(1, parts):
            raise_to(line, distance_m[row * parts + part, : line.shape[0]])
        for col in range(cols):
            largest = line[col * parts]
            for part in range(1, parts):
                largest = max(largest, line[col * parts + part])
            out_m[row, col] = largest


@kernel
def raise_to(values: NDArray[np.float32], others: NDArray[np.float32]) -> None:
    """Raise values (n,) to others where these are larger; without branches, so many at a time."""
    for index in range(values.shape[0]):
        values[index] = max(values[index], others[index])


@kernel
def costs_to_metres(
    out_m: NDArray[np.float32], cost: NDArray[np.int32], metres: float, unreached_m: float
) -> None:
    """Write costs-to-go as metres of free floor.

    Args:
        out_m: (rows, cols), overwritten.
        cost: (cells,) row-major.
        metres: of one unit of cost.
        unreached_m: where there is no path.
    """
    rows, cols = out_m.shape
    for row in range(rows):
        for col in range(cols):
            value = cost[row * cols + col]
            out_m[row, col] = unreached_m if value == UNREACHED else value * metres


@kernel
def slope_edges(cost_m: NDArray[np.float32], unreached_m: float, rise_m: float, width: int) -> None:
    """Let the cost-to-go rise beside the cells that were reached, instead of jumping.

    Between two cells it is interpolated; a jump would push the robot out of narrow passages.

    Args:
        cost_m: (rows, cols), changed in place; its outermost cells stay.
        unreached_m: what the cells hold that were not reached.
        rise_m: from cell to cell.
        width: of the slope [cells].
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
