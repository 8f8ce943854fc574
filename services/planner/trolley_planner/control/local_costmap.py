"""The local costmap: exact distances around the robot, and the cost-to-go along the path."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D
from trolley.jit import kernel
from trolley_planner.control.known_floor import KnownFloor
from trolley_planner.costmap.costmap import Costmap
from trolley_planner.costmap.fine_grid import FINE, FineGrid
from trolley_planner.costmap.footprint import NO_LIMITS, Field, Footprint
from trolley_planner.costmap.inflation import (
    LETHAL,
    TABLE_STEP_M,
    WEIGHT_UNIT,
    inflation_table,
    soften_disc,
    weigh_into,
)
from trolley_planner.paths.search import STEP, UNREACHED, Queue, cost_to_go_into, make_queue
from trolley_planner.people.moving_obstacles import NO_ROBOTS, NOBODY


class LocalCostmapParams(NamedTuple):
    """Cells and costs of the local costmap; all by hand."""

    fine_m: float = 0.03
    """Largest edge of a fine cell where there would be too many of the finest."""
    most_fine_cells: int = 800
    """Most of the finest cells along the edge of the local costmap: enough at 1.5 m/s; each scan
    costs more with more of them."""
    unreached_m: float = 100.0
    """Cost-to-go of places from which no path leads on."""
    edge_rise_m: float = 0.5
    """Rise of the cost-to-go from cell to cell beside the cells that the search reached."""
    edge_cells: int = 3
    """Number of cells beside the reached ones over which the cost-to-go rises."""
    border_cells: float = 0.02
    """Distance from a border within which a point of the path belongs to both cells."""
    escape_m: float = 0.3
    """Radius around the robot within which lethal cells are passable, so that it can leave them."""
    escape_weight: int = 240
    """Weight of lethal cells within `escape_m` of the robot."""
    tight_weight: int = 80
    """Weight of places with less than the usual clearance, where they may be passed at all."""
    narrow_m: float = 0.08
    """Clearance at the robot below which a metre of the path counts `narrow_factor` times."""
    coming_m: float = 0.8
    """Distance from the robot within which a person passes who counts as coming by."""
    coming_s: float = 3.0
    """Time within which they do: what the rollouts look ahead, and some more."""
    narrow_factor: float = 3.0
    """Weight of a metre of the path in narrow places: progress must be worth driving close to
    walls, and backwards."""
    usual_factor: float = 0.88
    """The same elsewhere: less than a metre beside the path, so that the robot returns to it."""


LOCAL = LocalCostmapParams()
LEAST_MPS = 1e-3
"""Slower is standing [m/s]."""
TIGHT_CLEARANCE_M = 0.005
"""Clearance in places that are passed only because there is no other path [m]."""


class InflationTables(NamedTuple):
    """Weights by the distance to the nearest obstacle, in steps of `TABLE_STEP_M`."""

    usual: NDArray[np.uint8]
    tight: NDArray[np.uint8]
    """Used where places with less than the usual clearance may be passed."""


class CoarseCells(NamedTuple):
    """What the cost-to-go is computed in."""

    distance_m: NDArray[np.float32]
    """(rows, cols) the largest distance to an obstacle in each cell."""
    weights: NDArray[np.uint8]
    """(rows, cols)."""
    costs: NDArray[np.int32]
    """(cells,) cost-to-go in units of the search."""
    cost_m: NDArray[np.float32]
    """(rows, cols) the same as metres of free floor, with slopes at its edges."""
    queue: Queue


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
        self.body = footprint.body
        self.known_floor = KnownFloor(costmap, footprint)
        """What the robot may back into."""
        self._tables = _inflation_tables(footprint, config)
        is_small = 2.0 * half_m / FINE.finest_m < LOCAL.most_fine_cells
        edge_m = FINE.finest_m if is_small else LOCAL.fine_m
        needed = footprint.circumscribed_m + config.caution_distance_m + 0.1
        reach_m = max(self._tables.usual.shape[0] * TABLE_STEP_M, needed)
        self.fine_grid = FineGrid(costmap, edge_m, reach_m)
        """What stands around the robot."""
        parts, fine_m = self.fine_grid.parts, self.fine_grid.fine_m
        group = max(1, round(0.05 / fine_m))
        self.coarse_m = group * fine_m
        # A multiple of both kinds of cells.
        unit = math.lcm(parts, group)
        cells = unit * math.ceil(2.0 * half_m / fine_m / unit)
        self._map_cells = cells // parts
        self._coarse = _make_coarse_cells(cells // group)
        self._robot_cell = 0
        self._narrow_m = footprint.inscribed_m + LOCAL.narrow_m
        self._price_of_path = 1.0
        self._moving = NOBODY, NO_ROBOTS

    def update_moving(self, stamp_ns: int) -> None:
        """Predict people and other robots to a moment: now, or when the robot obeys."""
        moving = self._costmap.moving
        self._moving = moving.walkers_at(stamp_ns), moving.robots_at(stamp_ns)

    def leave_people_out(self) -> None:
        """Ignore people until `update_moving`."""
        self._moving = NOBODY, self._moving[1]

    def walkers_now(self) -> NDArray[np.float64]:
        """Return the discs (n, 7) of walking people, see `Field.walkers`; a copy."""
        return self._moving[0].copy()

    def is_anyone_near(self, pose: Pose2D, within_m: float) -> bool:
        """Say whether a person or a robot moves near a place [m]."""
        walkers, robots = self._moving
        moving = np.concatenate([walkers[:, [0, 1, 4]], robots[:, 0]])
        away = np.hypot(moving[:, 0] - pose.x, moving[:, 1] - pose.y) - moving[:, 2]
        return bool((away < within_m).any())

    def is_anyone_coming(self, x: float, y: float) -> bool:
        """Say whether a person who walks on as now soon comes by a robot at a place [m]."""
        walkers = self._moving[0]
        off, velocity = walkers[:, :2] - (x, y), walkers[:, 2:4]
        squared = np.maximum((velocity**2).sum(axis=1), LEAST_MPS**2)
        nearest_s = np.clip(-(off * velocity).sum(axis=1) / squared, 0.0, LOCAL.coming_s)
        away = np.hypot(*(off + nearest_s[:, None] * velocity).T) - walkers[:, 4]
        return bool((away < self.body.circumscribed_m + LOCAL.coming_m).any())

    def update(self, x: float, y: float, is_tight: bool = False) -> None:
        """Centre on a point of `grid` [m] and recompute the distances.

        Args:
            x: of the robot.
            y: of the robot.
            is_tight: whether the path may lead where there is less than the usual clearance.
        """
        resolution, grid, coarse = self._costmap.resolution_m, self.fine_grid, self._coarse
        half = self._map_cells // 2
        first = math.floor(y / resolution) - half, math.floor(x / resolution) - half
        grid.update(first, (self._map_cells, self._map_cells))
        coarsen_into(coarse.distance_m, grid.distance_m, round(self.coarse_m / grid.fine_m))
        table = self._tables.tight if is_tight else self._tables.usual
        weights = coarse.weights
        weigh_into(weights, coarse.distance_m, table, TABLE_STEP_M)
        weights[0] = weights[-1] = LETHAL
        weights[:, 0] = weights[:, -1] = LETHAL
        centre = (x - grid.x) / self.coarse_m, (y - grid.y) / self.coarse_m
        self._robot_cell = math.floor(centre[1]) * len(weights) + math.floor(centre[0])
        room_m = coarse.distance_m.reshape(-1)[self._robot_cell]
        # A robot that stepped aside for somebody is near a wall, too, and in no hurry.
        is_narrow = (is_tight and not self.is_anyone_coming(x, y)) or (
            room_m < self._narrow_m and not self._costmap.moving.people
        )
        # Who makes room for people leaves the path for it.
        usual = 1.0 if self._costmap.moving.people else LOCAL.usual_factor
        self._price_of_path = LOCAL.narrow_factor if is_narrow else usual
        radius = LOCAL.escape_m / self.coarse_m
        soften_disc(weights, coarse.distance_m, centre, radius, LOCAL.escape_weight)

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
        corner = self.fine_grid.x, self.fine_grid.y
        price = self._price_of_path * self.cost_of_metre
        weights, coarse_m = self._coarse.weights, self.coarse_m
        flat = seeds_along(points, remaining_m, price, weights, corner, coarse_m)
        blocked = np.flatnonzero(weights.reshape(-1)[flat[:, 0]] == LETHAL)
        if blocked.size == 0:
            return self._spread(flat)
        if self._spread(flat[blocked[-1] + 1 :]):
            return True
        self._spread(flat[: blocked[0]])
        return False

    def _spread(self, seeds: NDArray[np.int32]) -> bool:
        """Compute the cost-to-go to seeds (cell, cost); say whether the robot can reach one."""
        ordered = np.ascontiguousarray(seeds[np.argsort(seeds[:, 1], kind="stable")])
        coarse = self._coarse
        flat, size = coarse.weights.reshape(-1), len(coarse.weights)
        cost_to_go_into(coarse.costs, flat, coarse.queue, ordered, size, (-1, 0), 16)
        costs_to_metres(coarse.cost_m, coarse.costs, 1.0 / self.cost_of_metre, LOCAL.unreached_m)
        slope_edges(coarse.cost_m, LOCAL.unreached_m, LOCAL.edge_rise_m, LOCAL.edge_cells)
        return bool(coarse.costs[self._robot_cell] != UNREACHED)

    @property
    def cost_of_metre(self) -> float:
        """Units of cost in one metre of free floor."""
        return 2 * STEP * WEIGHT_UNIT / self.coarse_m

    @property
    def field(self) -> Field:
        """What the kernels look up."""
        costmap, grid = self._costmap, self.fine_grid
        limits = costmap.static.speed_limits if costmap.static.has_speed_limits else NO_LIMITS
        return Field(
            grid.distance_m,
            self._coarse.cost_m,
            limits,
            grid.x,
            grid.y,
            grid.fine_m,
            self.coarse_m,
            costmap.resolution_m,
            *self._moving,
        )


def _inflation_tables(footprint: Footprint, config: PlannerConfig) -> InflationTables:
    """Return the inflation by the footprint's inscribed circle."""
    usual = inflation_table(
        footprint.inscribed_m + config.clearance_m,
        config.inflation_falloff_m,
        config.inflation_height,
        TABLE_STEP_M,
        WEIGHT_UNIT,
    )
    near = footprint.inscribed_m + np.array([TIGHT_CLEARANCE_M, config.clearance_m])
    tight = usual.copy()
    first, last = np.ceil(near / TABLE_STEP_M).astype(np.int64)
    tight[first:last] = LOCAL.tight_weight
    return InflationTables(usual, tight)


def _make_coarse_cells(size: int) -> CoarseCells:
    """Return a square of so many cells along its edge."""
    return CoarseCells(
        distance_m=np.zeros((size, size), dtype=np.float32),
        weights=np.zeros((size, size), dtype=np.uint8),
        costs=np.zeros(size**2, dtype=np.int32),
        cost_m=np.zeros((size, size), dtype=np.float32),
        queue=make_queue(size**2),
    )


@kernel
def seeds_along(
    points: NDArray[np.float64],
    remaining_m: NDArray[np.float64],
    price: float,
    weights: NDArray[np.uint8],
    corner: tuple[float, float],
    coarse_m: float,
) -> NDArray[np.int32]:
    """Return flat coarse cells along a path and their costs, (n, 2), without the outermost cells.

    A cell costs what is left of the path from abreast of its centre. A path along the border of two
    rows of cells counts for both.

    Args:
        points: (n, 2) in `grid` [m].
        remaining_m: (n,) cost of the path from each point on [m of free floor].
        price: of one metre.
        weights: (rows, cols) of the cells, as many of both.
        corner: of the cells, in `grid` [m].
        coarse_m: edge of a cell [m].
    """
    size, count, last = weights.shape[0], 0, points.shape[0] - 1
    seeds = np.empty((2 * points.shape[0], 2), np.int32)
    for index in range(points.shape[0]):
        x = (points[index, 0] - corner[0]) / coarse_m
        y = (points[index, 1] - corner[1]) / coarse_m
        before, after = max(index - 1, 0), min(index + 1, last)
        ahead_x = (points[after, 0] - points[before, 0]) / coarse_m
        ahead_y = (points[after, 1] - points[before, 1]) / coarse_m
        squared = ahead_x * ahead_x + ahead_y * ahead_y
        fall_m = remaining_m[before] - remaining_m[after]
        for beside in (-LOCAL.border_cells, LOCAL.border_cells):
            col, row = math.floor(x + beside), math.floor(y + beside)
            if 0 < col < size - 1 and 0 < row < size - 1:
                along = ahead_x * (col + 0.5 - x) + ahead_y * (row + 0.5 - y)
                cost_m = remaining_m[index]
                if squared > 0.0:
                    cost_m -= fall_m * along / squared
                seeds[count, 0] = row * size + col
                seeds[count, 1] = np.rint(max(cost_m, 0.0) * price)
                count += 1
    return seeds[:count]


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
    """Raise values (n,) to others where these are larger; without branches, to vectorize."""
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
    """Let the cost-to-go rise gradually beside the cells that were reached.

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
