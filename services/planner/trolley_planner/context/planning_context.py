"""What one robot needs to plan on one map: costmaps, global planner, controller."""

import numpy as np

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D
from trolley.gridmap import UNKNOWN, GridMap
from trolley_planner.control.controller import Controller
from trolley_planner.control.local_costmap import LocalCostmap
from trolley_planner.control.mppi import Mppi
from trolley_planner.control.pure_pursuit import PurePursuit
from trolley_planner.costmap.costmap import Costmap
from trolley_planner.costmap.footprint import NO_LIMITS, Field, Footprint, clearance_at
from trolley_planner.paths.global_planner import GlobalPlanner

WINDOW_MARGIN_M = 0.4


class PlanningContext:
    """The parts that belong together and are made anew when the map or the robot changes.

    Args:
        grid: the map, or an empty one around the robot.
        footprint: of the robot.
        config: of the planner.
        max_speed: highest speed that the robot may have [m/s].
    """

    def __init__(
        self, grid: GridMap, footprint: Footprint, config: PlannerConfig, max_speed: float
    ) -> None:
        free = config.unknown_is_free or config.frame == "odom"
        self.grid = grid
        self.footprint = footprint
        self.costmap = Costmap(grid, footprint, config, free)
        self.planner = GlobalPlanner(self.costmap)
        half = max(1.5, max_speed * config.horizon_s + footprint.circumscribed_m + WINDOW_MARGIN_M)
        self.local_costmap = LocalCostmap(self.costmap, footprint, config, half)
        self.half_m = half
        self.controller: Controller = (
            PurePursuit(config) if config.controller == "pursuit" else Mppi(config)
        )

    def map_clearance(self, pose_grid: Pose2D, enough_m: float) -> float:
        """Return how far the footprint at a pose is from map and zones [m], at most `enough_m`."""
        costmap = self.costmap
        edge = costmap.resolution_m
        field = Field(costmap.static_distance_m, NO_LIMITS, NO_LIMITS, 0.0, 0.0, edge, edge, edge)
        return clearance_at(
            field, self.local_costmap.body, pose_grid.x, pose_grid.y, pose_grid.yaw, enough_m
        )

    def seen_clearance(self, pose_grid: Pose2D, enough_m: float) -> float:
        """Return the same from all obstacles in the local costmap, in which it must lie."""
        return clearance_at(
            self.local_costmap.field,
            self.local_costmap.body,
            pose_grid.x,
            pose_grid.y,
            pose_grid.yaw,
            enough_m,
        )


def empty_grid(centre: Pose2D, size_m: float, resolution_m: float) -> GridMap:
    """Return a square map of which nothing is known, around a place.

    Its axes are those of the frame; its corner lies on a whole number of cells.
    """
    count = round(size_m / resolution_m)
    x = round(centre.x / resolution_m) - count // 2
    y = round(centre.y / resolution_m) - count // 2
    cells = np.full((count, count), UNKNOWN, dtype=np.int8)
    return GridMap("odom", resolution_m, Pose2D(x * resolution_m, y * resolution_m, 0.0), cells)
