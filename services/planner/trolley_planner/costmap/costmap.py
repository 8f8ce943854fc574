"""The costmap: map, zones and what the lidar sees, inflated."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D, wrap_angle
from trolley.geometry.polygon import distance_to_outline
from trolley.gridmap import GridMap
from trolley.messages import OccupancyGrid, Zone
from trolley_planner.costmap.closed_layer import ClosedLayer
from trolley_planner.costmap.cost_layer import CostLayer
from trolley_planner.costmap.distance_field import DistanceField
from trolley_planner.costmap.footprint import Footprint
from trolley_planner.costmap.inflation import (
    LETHAL,
    TABLE_STEP_M,
    UNKNOWN,
    WEIGHT_UNIT,
    CostmapLayers,
    inflation_table,
    weigh_boxes,
)
from trolley_planner.costmap.obstacle_layer import ObstacleLayer
from trolley_planner.costmap.social_layer import SocialLayer
from trolley_planner.costmap.static_layer import StaticLayer, close_border
from trolley_planner.people.moving_obstacles import MovingObstacles
from trolley_planner.people.tracker import TrackedPerson, person_discs
from trolley_planner.sensing.beams import Sweep


@dataclass(frozen=True, slots=True)
class CostmapParams:
    """How the layers become weights; all by hand."""

    padding_m: float = 0.02
    """Added to the inscribed radius: cells round an obstacle's place to half their edge."""
    tight_cells: float = 0.3
    """Most that a seen obstacle lies farther away than the centre of its cell."""
    squeeze_weight: int = 60 * WEIGHT_UNIT
    """Weight of cells where the robot fits only if all lies well in its cells."""
    aligned: float = 1e-3
    """Part of a cell, or angle [rad], by which aligned cells may lie off each other."""
    beside_m: float = 0.15
    """A person nearer to the robot's outline than this is an obstacle as well."""


COSTMAP = CostmapParams()
NO_POINTS = np.empty((0, 2))


class Costmap:
    """One grid of all obstacles.

    All arrays have the shape (rows, cols) and lie in frame `grid`; `frame_T_grid` places them in
    the frame of the goals, `grid_T_frame` is its inverse. Two sets of weights are kept: of the
    map and its zones alone, and with what the lidar has seen, the latter brought up to date by
    `refresh` only where something changed.

    Args:
        grid: the map; its origin is `frame_T_grid`.
        footprint: of the robot.
        config: ranges, tolerances and costs.
        unknown_is_free: whether cells that nobody has seen may be passed.
    """

    def __init__(
        self, grid: GridMap, footprint: Footprint, config: PlannerConfig, unknown_is_free: bool
    ) -> None:
        self.resolution_m = grid.resolution
        self.frame_T_grid = grid.origin
        self.grid_T_frame = grid.origin.inverse()
        self.footprint = footprint
        self.unknown_is_free = unknown_is_free
        self.shape = grid.rows, grid.cols
        self._table = inflation_table(
            footprint.inscribed_m + COSTMAP.padding_m + 0.5 * grid.resolution,
            config.inflation_falloff_m,
            config.inflation_height,
            TABLE_STEP_M,
            WEIGHT_UNIT,
        )
        self.static = StaticLayer(grid, self._table, unknown_is_free)
        """Map and zones."""
        self.obstacle_layer = ObstacleLayer(self.shape, grid.resolution, config)
        self._social_layer = SocialLayer(self.shape, grid.resolution, footprint.inscribed_m)
        self._cost_layer = CostLayer(self.shape, grid.resolution)
        self.moving = MovingObstacles()
        """People and other robots: they are not in the distances, but in the local costmap."""
        self._closed_layer = ClosedLayer(self.shape, grid.resolution)
        reach_m = self._table.shape[0] * TABLE_STEP_M
        self._distances = DistanceField(self.shape, grid.resolution, reach_m, not unknown_is_free)
        self.tight_m = footprint.inscribed_m - COSTMAP.tight_cells * grid.resolution
        """Cells nearer than this to an obstacle cannot hold the footprint's centre."""
        self.recompute()

    @property
    def distance_m(self) -> NDArray[np.float32]:
        """(rows, cols) to the nearest obstacle, up to the inflation's reach [m]."""
        return self._distances.values_m

    def set_zones(self, zones: Sequence[Zone]) -> None:
        """Replace the zones (points in the frame of the goals)."""
        self.static.set_zones(zones)
        self.recompute()

    def set_suspects(self, lines: Sequence[Sequence[tuple[float, float]]]) -> None:
        """Replace the lines on which mirrors are suspected: nothing seen behind them counts.

        They lie on walls of the map and close no path that the map leaves open.

        Args:
            lines: points of each in the frame of the goals [m].
        """
        self.static.set_suspects(lines)

    def set_costs(self, costs: Mapping[str, OccupancyGrid]) -> None:
        """Take over the costs that programs publish, in the frame of the goals, step by step."""
        self._cost_layer.update(costs, self.frame_T_grid, self.obstacle_layer.grid)

    def set_position(self, x: float, y: float) -> None:
        """Update where the robot is: a keep-out zone around it may be crossed until it has left.

        Args:
            x: in the frame of the goals [m].
            y: in the frame of the goals [m].
        """
        if self.static.set_position(x, y):
            self.recompute()

    def add_scan(self, sweep: Sweep, now_ns: int, further: NDArray[np.float64] = NO_POINTS) -> None:
        """Clear and mark by one scan, whose poses are in the frame of the goals.

        Args:
            sweep: the scan.
            now_ns: its robot time.
            further: (n, 2) echoes of extra sensors [m], which only mark.
        """
        grid_T_frame = self.grid_T_frame
        in_grid = Sweep(
            sweep.ranges_m,
            sweep.shape,
            grid_T_frame @ sweep.start,
            grid_T_frame @ sweep.end,
            sweep.body_laser,
        )
        static = self.static
        lines, walls, walls_m = static.reflecting, static.walls, static.wall_distance_m
        in_cells = grid_T_frame.transform_points(further)
        self.obstacle_layer.update(in_grid, walls, walls_m, lines, now_ns, in_cells)
        self.moving.update(now_ns, self.obstacle_layer.beams, walls_m, self.resolution_m)
        people = self.moving.people
        outline = in_grid.end.transform_points(sweep.body_laser)
        self.obstacle_layer.remove_people(
            person_discs([one for one in people if _may_lift(one, outline)])
        )
        self._social_layer.update(people, self.obstacle_layer.grid)

    def take_over(self, other: "Costmap") -> None:
        """Copy what was seen from another costmap in the same frame, if its cells are aligned."""
        corner, edge_m = self.to_grid(other.frame_T_grid), self.resolution_m
        rows, cols = round(corner.y / edge_m), round(corner.x / edge_m)
        off_m = math.hypot(corner.x - cols * edge_m, corner.y - rows * edge_m)
        turn = abs(wrap_angle(corner.yaw))
        if other.resolution_m != edge_m or max(off_m / edge_m, turn) > COSTMAP.aligned:
            return
        self.obstacle_layer.take_over(other.obstacle_layer, rows, cols)

    def forget_old(self, now_ns: int) -> None:
        """Forget what has been out of sight for too long, and open what was closed long ago."""
        self.obstacle_layer.forget_old(now_ns)
        if self._closed_layer.is_over(now_ns):
            self.reopen()

    def forget_all(self) -> None:
        """Forget everything that was seen or closed, as after a jump of the pose."""
        self.moving.forget_people()
        self.obstacle_layer.forget_all()
        self._social_layer.update([], self.obstacle_layer.grid)
        self.reopen()

    def close(self, x_grid: float, y_grid: float, radius_m: float, now_ns: int) -> None:
        """Close a circle [m] where the robot did not get through, though nothing is seen there."""
        self._closed_layer.close((x_grid, y_grid), radius_m, now_ns)
        self.obstacle_layer.mark_all_dirty()

    def reopen(self) -> None:
        """Reopen all closed places."""
        if self._closed_layer.reopen():
            self.obstacle_layer.mark_all_dirty()

    def refresh(self) -> bool:
        """Bring distances and weights up to date where the lidar saw a change; True if it did."""
        dirty = self.obstacle_layer.pop_dirty()
        if dirty is None:
            return False
        around = self._distances.update(self._layers(), dirty)
        boxes = self._social_layer.pop_changed() + self._cost_layer.pop_changed()
        if boxes:
            around = np.concatenate([np.array(boxes), around])
        self._weigh(around)
        return len(around) > 0

    def recompute(self) -> None:
        """Compute distances and weights with what the lidar has seen, whatever has changed."""
        self.obstacle_layer.pop_dirty()
        self._social_layer.pop_changed()
        self._cost_layer.pop_changed()
        self._distances.recompute(self._layers())
        self.weights = np.full(self.shape, LETHAL, dtype=np.uint8)
        """Weights by that distance, where people walk, and by the costs that programs publish; the
        outermost cells are lethal."""
        self._weigh(np.array([(0, self.shape[0], 0, self.shape[1])]))

    def _weigh(self, boxes: NDArray[np.int64]) -> None:
        """Bring the weights up to date in boxes (n, 4): first and end row, first and end column."""
        weigh_boxes(self.weights, self.distance_m, self._table, TABLE_STEP_M, boxes)
        least: list[NDArray[np.uint8]] = []
        if self._social_layer.is_anyone_walking:
            least.append(self._social_layer.weights)
        if self._cost_layer.has_costs:
            least.append(self._cost_layer.weights)
        for layer in least:
            for row, end_row, col, end_col in boxes.tolist():
                part = np.s_[row:end_row, col:end_col]
                weights = self.weights[part]
                np.maximum(weights, layer[part], out=weights, where=weights != LETHAL)

    def squeeze_weights(
        self, weights: NDArray[np.uint8], distance_m: NDArray[np.float32]
    ) -> NDArray[np.uint8]:
        """Return weights: expensive instead of lethal where the robot may just fit.

        Args:
            weights: (rows, cols).
            distance_m: (rows, cols) that belongs to them.
        """
        may_fit = (weights == LETHAL) & (distance_m >= self.tight_m)
        squeeze_weights = np.where(may_fit, np.uint8(COSTMAP.squeeze_weight), weights)
        close_border(squeeze_weights)
        return squeeze_weights

    def costs(self) -> NDArray[np.int8]:
        """Return (rows, cols) as on the wire.

        100 something stands there, 99 too near for the centre, 0 to 98 falling with the
        distance, -1 unknown.
        """
        extra = (np.arange(256, dtype=np.float32) / WEIGHT_UNIT - 1.0).clip(0.0)
        highest = max(float(self._table.max()) / WEIGHT_UNIT - 1.0, 1e-6)
        costs_by_weight = np.rint(98.0 * np.minimum(extra / highest, 1.0)).astype(np.int8)
        costs = costs_by_weight[self.weights]
        costs[(self.static.kinds == UNKNOWN) & (self.obstacle_layer.grid.observed == 0)] = -1
        costs[self.weights == LETHAL] = 99
        costs[self.distance_m == 0.0] = 100
        return costs

    def to_grid(self, pose: Pose2D) -> Pose2D:
        """Return a pose of the frame of the goals in frame `grid`."""
        return self.grid_T_frame @ pose

    def contains(self, x_grid: float, y_grid: float) -> bool:
        """Say whether a point of `grid` [m] lies on the costmap and not on its outermost cells."""
        rows, cols = self.shape
        edge = self.resolution_m
        return edge <= x_grid < edge * (cols - 1) and edge <= y_grid < edge * (rows - 1)

    def _layers(self) -> CostmapLayers:
        grid = self.obstacle_layer.grid
        static = self.static
        return CostmapLayers(
            static.kinds, static.keepout, self._closed_layer.mask, grid.evidence, grid.observed
        )


def _may_lift(person: TrackedPerson, outline: NDArray[np.float64]) -> bool:
    """Say whether a person is no obstacle: it is seen, and the robot does not turn into it."""
    gap_m = float(distance_to_outline(outline, person.points).min())
    return person.is_seen and gap_m > COSTMAP.beside_m
