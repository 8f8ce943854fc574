"""Costs that programs publish, as weights."""

import numpy as np

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley.gridmap.wire import map_message
from trolley.messages import OccupancyGrid
from trolley_planner.costmap.cost_layer import CostLayer
from trolley_planner.costmap.obstacle_layer import ObstacleLayer

SHAPE, EDGE_M = (20, 30), 0.1
FRAME_T_GRID = Pose2D(1.0, 2.0, 0.0)


def square(cost: int, x: float, y: float) -> OccupancyGrid:
    """A cell of 0.2 m at a place of the frame."""
    cells = np.full((1, 1), cost, dtype=np.int8)
    return map_message(0, GridMap("home", 0.2, Pose2D(x, y, 0.0), cells))


def test_the_highest_cost_counts_and_what_is_gone_is_taken_back() -> None:
    layer = CostLayer(SHAPE, EDGE_M)
    seen = ObstacleLayer(SHAPE, EDGE_M, PlannerConfig())
    seen.pop_dirty()
    costs = {"a": square(10, 1.0, 2.0), "b": square(100, 1.1, 2.0)}
    for _ in costs:
        layer.update(costs, FRAME_T_GRID, seen.grid)
    assert layer.weights[0, :4].tolist() == [8, 44, 44, 0]
    assert layer.weights.sum() == 2 * (8 + 44 + 44)
    assert layer.pop_changed() == [(0, 2, 0, 2), (0, 2, 1, 3)]
    assert seen.pop_dirty() == (0, 1, 0, 2)
    layer.update({"a": costs["a"]}, FRAME_T_GRID, seen.grid)
    assert layer.weights[0, :4].tolist() == [8, 8, 0, 0]
    layer.update({}, FRAME_T_GRID, seen.grid)
    assert not layer.weights.any()
    assert not layer.has_costs


def test_a_program_that_publishes_all_the_time_keeps_nobody_else_waiting() -> None:
    layer = CostLayer(SHAPE, EDGE_M)
    seen = ObstacleLayer(SHAPE, EDGE_M, PlannerConfig())
    once = square(50, 2.0, 3.0)
    for _ in range(2):
        layer.update({"often": square(50, 1.0, 2.0), "once": once}, FRAME_T_GRID, seen.grid)
    assert layer.weights[0, 0] == layer.weights[10, 10] == 24
    later = square(60, 2.0, 3.0)
    for _ in range(2):
        layer.update({"often": square(50, 1.0, 2.0), "once": later}, FRAME_T_GRID, seen.grid)
    assert layer.weights[10, 10] == 28
