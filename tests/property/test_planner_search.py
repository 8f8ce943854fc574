"""The bucket queue against the textbook, and paths that touch nothing."""

import heapq
import itertools
import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from support.cases import cases
from support.flatland import empty_room

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley_planner.costmap.costmap import Costmap
from trolley_planner.costmap.footprint import Footprint
from trolley_planner.costmap.inflation import LETHAL
from trolley_planner.paths.global_planner import GlobalPlanner
from trolley_planner.paths.search import (
    DIAGONAL,
    KNIGHT,
    STEP,
    UNREACHED,
    cost_to_go_into,
    descend_into,
    make_queue,
    price_of_step,
)

FOOTPRINT = Footprint.from_polygon([(0.15, 0.12), (-0.15, 0.12), (-0.15, -0.12), (0.15, -0.12)])


def naive_price(flat: np.ndarray, cell: int, dr: int, dc: int, cols: int) -> int | None:
    """Price of a step to another cell, None where it is none or passes something."""
    if (dr, dc) == (0, 0) or (max(abs(dr), abs(dc)) == 2 and min(abs(dr), abs(dc)) != 1):
        return None
    passed = [cell, cell + dr * cols + dc]
    length = DIAGONAL if dr and dc else STEP
    beside: list[int] = []
    if abs(dr) == 2:
        length, beside = KNIGHT, [cell + dr // 2 * cols, cell + dr // 2 * cols + dc]
    elif abs(dc) == 2:
        length, beside = KNIGHT, [cell + dc // 2, cell + dr * cols + dc // 2]
    elif dr and dc and not (flat[cell + dr * cols] and flat[cell + dc]):
        return None
    if not all(flat[other] for other in beside) or not all(flat[other] for other in passed):
        return None
    return length * int(sum(flat[other] for other in [*passed, *beside]))


def naive_costs(
    weights: np.ndarray, seeds: list[tuple[int, int]], directions: int = 8
) -> np.ndarray:
    """Dijkstra with a heap (1959), cell by cell."""
    rows, cols = weights.shape
    cost = np.full(rows * cols, UNREACHED, dtype=np.int64)
    flat = weights.reshape(-1).astype(int)
    heap = [(price, cell) for cell, price in seeds if flat[cell]]
    reach = range(-1, 2) if directions == 8 else range(-2, 3)
    for price, cell in heap:
        cost[cell] = min(cost[cell], price)
    heapq.heapify(heap)
    while heap:
        price, cell = heapq.heappop(heap)
        if price > cost[cell]:
            continue
        for dr, dc in itertools.product(reach, reach):
            step = naive_price(flat, cell, dr, dc, cols)
            other = cell + dr * cols + dc
            if step is not None and price + step < cost[other]:
                cost[other] = price + step
                heapq.heappush(heap, (price + step, other))
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
    flat, queue = weights.reshape(-1), make_queue(rows * cols)
    cost_to_go_into(cost, flat, queue, seeds, cols, (-1, 0), 8)
    pairs = [(int(cell), int(price)) for cell, price in seeds]
    by_eight = naive_costs(weights, pairs)
    np.testing.assert_array_equal(cost, by_eight)
    # Along 16 directions some dear moves are left out where weights differ by much.
    cost_to_go_into(cost, flat, queue, seeds, cols, (-1, 0), 16)
    assert (cost <= by_eight).all()
    assert (cost >= naive_costs(weights, pairs, 16)).all()


@given(st.integers(0, 10_000), st.integers(3, 24), st.integers(3, 24), st.floats(0.0, 0.6))
def test_over_free_floor_16_directions_are_those_of_dijkstra(seed, rows, cols, share) -> None:
    weights = np.minimum(random_weights(seed, rows, cols, share), np.uint8(4))
    goal = int(np.random.default_rng(seed).integers(rows * cols))
    cost = np.empty(rows * cols, dtype=np.int32)
    seeds = np.array([[goal, 0]], dtype=np.int32)
    queue = make_queue(rows * cols)
    cost_to_go_into(cost, weights.reshape(-1), queue, seeds, cols, (-1, 0), 16)
    np.testing.assert_array_equal(cost, naive_costs(weights, [(goal, 0)], 16))


@given(st.integers(0, 10_000), st.integers(-2, 2), st.integers(-2, 2))
def test_a_step_costs_what_the_cells_under_it_do(seed, dr, dc) -> None:
    weights = random_weights(seed, 7, 9, 0.3)
    flat = weights.reshape(-1)
    cell = 3 * 9 + 4
    flat[cell] = 4
    expected = naive_price(flat.astype(int), cell, dr, dc, 9)
    assert price_of_step(flat, cell, dr, dc, 9) == (expected or 0)


@given(st.integers(0, 10_000), st.floats(0.0, 0.5), st.sampled_from([8, 16]))
def test_the_descent_leads_downhill_to_the_goal(seed, share, directions) -> None:
    rows, cols = 20, 30
    weights = random_weights(seed, rows, cols, share)
    goal, start = 1 * cols + 1, (rows - 2) * cols + cols - 2
    weights.reshape(-1)[[goal, start]] = 4
    cost = np.empty(rows * cols, dtype=np.int32)
    seeds = np.array([[goal, 0]], dtype=np.int32)
    flat = weights.reshape(-1)
    cost_to_go_into(cost, flat, make_queue(rows * cols), seeds, cols, (start, 0), directions)
    if cost[start] == UNREACHED:
        return
    found = np.empty(rows * cols, dtype=np.int32)
    way = found[: descend_into(found, cost, flat, start, cols, directions)]
    assert way[0] == start
    assert way[-1] == goal
    assert (np.diff(cost[way]) < 0).all()
    assert (flat[way] != LETHAL).all()


@settings(max_examples=cases(40))
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
        # Beside the room's walls the floor is dearer, and the path keeps off them a little.
        is_in_the_open = all(0.8 < y < 5.2 for _, y in (start, goal))
        assert path.length_m <= 1.005 * math.dist(start, goal) + (0.05 if is_in_the_open else 0.15)
