"""The bucket queue against the textbook, and paths that touch nothing."""

import heapq
import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from support.flatland import empty_room

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley_planner.costmap import Costmap
from trolley_planner.footprint import Footprint
from trolley_planner.global_planner import GlobalPlanner
from trolley_planner.kernels.layers import LETHAL
from trolley_planner.kernels.search import (
    DIAGONAL,
    STEP,
    UNREACHED,
    cost_to_go_into,
    descend_into,
    make_queue,
)

FOOTPRINT = Footprint.from_polygon([(0.15, 0.12), (-0.15, 0.12), (-0.15, -0.12), (0.15, -0.12)])


def naive_costs(weights: np.ndarray, seeds: list[tuple[int, int]]) -> np.ndarray:
    """Dijkstra with a heap (1959), cell by cell."""
    rows, cols = weights.shape
    cost = np.full(rows * cols, UNREACHED, dtype=np.int64)
    flat = weights.reshape(-1).astype(int)
    heap = [(price, cell) for cell, price in seeds if flat[cell]]
    for price, cell in heap:
        cost[cell] = min(cost[cell], price)
    heapq.heapify(heap)
    while heap:
        price, cell = heapq.heappop(heap)
        if price > cost[cell]:
            continue
        for dr in (-1, 0, 1):
            for dc in (-1, 0, 1):
                other = cell + dr * cols + dc
                if (dr, dc) == (0, 0) or not flat[other]:
                    continue
                if dr and dc and not (flat[cell + dr * cols] and flat[cell + dc]):
                    continue
                length = DIAGONAL if dr and dc else STEP
                through = price + length * (flat[cell] + flat[other])
                if through < cost[other]:
                    cost[other] = through
                    heapq.heappush(heap, (through, other))
    return cost


def random_weights(seed: int, rows: int, cols: int, share: float) -> np.ndarray:
    rng = np.random.default_rng(seed)
    weights = rng.integers(4, 256, (rows, cols)).astype(np.uint8)
    weights[rng.random((rows, cols)) < share] = LETHAL
    weights[0] = weights[-1] = weights[:, 0] = weights[:, -1] = LETHAL
    return weights


@given(
    st.integers(0, 10_000),
    st.integers(3, 24),
    st.integers(3, 24),
    st.floats(0.0, 0.6),
    st.integers(1, 6),
)
def test_costs_are_those_of_dijkstra(seed, rows, cols, share, num_seeds) -> None:
    weights = random_weights(seed, rows, cols, share)
    rng = np.random.default_rng(seed + 1)
    cells = rng.integers(0, rows * cols, num_seeds)
    prices = np.sort(rng.integers(0, 20_000, num_seeds))
    seeds = np.stack([cells, prices], axis=1).astype(np.int32)
    cost = np.empty(rows * cols, dtype=np.int32)
    cost_to_go_into(cost, weights.reshape(-1), make_queue(rows * cols), seeds, cols, (-1, 0))
    pairs = [(int(cell), int(price)) for cell, price in seeds]
    np.testing.assert_array_equal(cost, naive_costs(weights, pairs))


@given(st.integers(0, 10_000), st.floats(0.0, 0.5))
def test_the_descent_leads_downhill_to_the_goal(seed, share) -> None:
    rows, cols = 20, 30
    weights = random_weights(seed, rows, cols, share)
    goal, start = 1 * cols + 1, (rows - 2) * cols + cols - 2
    weights.reshape(-1)[[goal, start]] = 4
    cost = np.empty(rows * cols, dtype=np.int32)
    seeds = np.array([[goal, 0]], dtype=np.int32)
    flat = weights.reshape(-1)
    cost_to_go_into(cost, flat, make_queue(rows * cols), seeds, cols, (start, 0))
    if cost[start] == UNREACHED:
        return
    found = np.empty(rows * cols, dtype=np.int32)
    way = found[: descend_into(found, cost, flat, start, cols)]
    assert way[0] == start
    assert way[-1] == goal
    assert (np.diff(cost[way]) < 0).all()
    assert (flat[way] != LETHAL).all()


@settings(max_examples=40)
@given(st.integers(0, 10_000))
def test_paths_touch_nothing_and_are_short(seed) -> None:
    rng = np.random.default_rng(seed)
    room = empty_room()
    cells = room.cells.copy()
    for _ in range(rng.integers(0, 12)):
        row, col = rng.integers(5, 110), rng.integers(20, 135)
        cells[row : row + rng.integers(2, 20), col : col + rng.integers(2, 8)] = 100
    grid = GridMap("m", room.resolution, Pose2D.identity(), cells)
    costmap = Costmap(grid, FOOTPRINT, PlannerConfig(), unknown_is_free=False)
    start, goal = (0.5, rng.uniform(0.5, 5.5)), (7.5, rng.uniform(0.5, 5.5))
    path = GlobalPlanner(costmap).plan(start, [goal], costmap.weights, costmap.distance_m)
    if path is None:
        return
    on = np.floor(path.points / grid.resolution).astype(int)
    assert (costmap.weights[on[:, 1], on[:, 0]] != LETHAL).all()
    np.testing.assert_allclose(path.points[[0, -1]], [start, goal])
    steps = np.hypot(*np.diff(path.points, axis=0).T)
    assert steps.max() <= 0.0501
    # An octile way along cells is at most 8 % longer than a straight one; detours cost more.
    assert path.length_m <= 1.01 * path.cost + 0.1
    if not (cells[5:115, 20:143] == 100).any():
        assert path.length_m <= 1.005 * math.dist(start, goal) + 0.05
