"""A whole map in fine cells, as the search over poses looks it up."""

from trolley.config import PlannerConfig
from trolley.gridmap import GridMap
from trolley_planner.costmap.costmap import Costmap
from trolley_planner.costmap.fine_grid import FINE, FineGrid
from trolley_planner.costmap.footprint import Footprint


def fine_grid(grid: GridMap, footprint: Footprint) -> FineGrid:
    """What stands on a map, and how far away that is, up to a metre."""
    costmap = Costmap(grid, footprint, PlannerConfig(), False)
    fine = FineGrid(costmap, FINE.finest_m, 1.0)
    fine.update((0, 0), costmap.shape)
    return fine
