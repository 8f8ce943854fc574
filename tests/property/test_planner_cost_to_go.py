"""The kept cost-to-go: never a wrong refusal, never a stale cost, about as good as the best."""

import itertools
import math

import numpy as np
from bench.planner.best_paths import grid_cost, taut_length
from hypothesis import given, settings
from hypothesis import strategies as st
from support.cases import cases

from trolley_planner.control.local_costmap import LOCAL, seeds_along
from trolley_planner.costmap.inflation import LETHAL
from trolley_planner.paths.corridor import TILE, Corridor, Terrain, open_path, reload, rewind
from trolley_planner.paths.cost_to_go import CostToGo
from trolley_planner.paths.path import polyline_cost, straighten
from trolley_planner.paths.search import (
    COSTLIEST_STEP,
    STEP,
    UNREACHED,
    cost_to_go_into,
    grow,
    make_queue,
    price_of_step,
)
from trolley_planner.paths.tiles import Coarse, retile, retile_changes

ROWS, COLS = 37, 50
PRICE = 240


def blocks(rng: np.random.Generator, thin: bool) -> np.ndarray:
    """Walls of one cell with gaps, or blocks, over weights that vary."""
    weights = rng.integers(4, 30, (ROWS, COLS)).astype(np.uint8)
    if rng.random() < 0.5:
        weights[:] = 4
    for _ in range(rng.integers(0, 14)):
        row, col = rng.integers(0, ROWS), rng.integers(0, COLS)
        size = rng.integers(1, 20, 2)
        if thin:
            size[rng.integers(2)] = 1
        weights[row : row + size[0], col : col + size[1]] = LETHAL
    weights[0] = weights[-1] = weights[:, 0] = weights[:, -1] = LETHAL
    return weights


def terrain(weights: np.ndarray, start: int, goal: int, radius: float = 0.0) -> Terrain:
    places = [(cell % COLS + 0.5, cell // COLS + 0.5, radius) for cell in (start, goal)]
    # Something stands in every other lethal cell.
    distance = np.where((weights == LETHAL) & (np.indices(weights.shape).sum(0) % 2 == 0), 0, 1)
    return Terrain(weights, distance.astype(np.float32), np.array(places), PRICE)


def effective(land: Terrain) -> np.ndarray:
    """The weights with the discs, cell by cell."""
    weights = land.weights.copy()
    for row in range(1, ROWS - 1):
        for col in range(1, COLS - 1):
            near = any(
                math.hypot(col + 0.5 - x, row + 0.5 - y) <= radius for x, y, radius in land.discs
            )
            if near and weights[row, col] == LETHAL and land.distance_m[row, col] > 0.0:
                weights[row, col] = PRICE
    return weights


def check(field: CostToGo, land: Terrain, start: int, goal: int) -> None:
    weights = effective(land)
    found = field.cheapest_path(start, land)
    best = math.inf
    if weights.reshape(-1)[[start, goal]].all():
        best = grid_cost(weights, start, goal)
    assert (found is None) == math.isinf(best)
    if found is None:
        return
    cells, cost = found
    assert (int(cells[0]), int(cells[-1])) == (start, goal)
    flat = weights.reshape(-1)
    total = 0
    for one, other in itertools.pairwise(cells):
        row_step, col_step = other // COLS - one // COLS, other % COLS - one % COLS
        price = price_of_step(flat, int(one), int(row_step), int(col_step), COLS)
        assert price > 0
        total += price
    assert total <= cost
    if land.discs[0, 2] == 0.0:
        # By how much a tile's weight exceeds its best line, and a few cells for its size.
        allowed = 1.01 if set(flat.tolist()) <= {LETHAL, 4} else 1.5
        assert total / (2 * STEP) <= allowed * best + 6.0 * 4


@settings(max_examples=cases(80))
@given(st.integers(0, 10_000), st.booleans(), st.sampled_from([0.0, 3.0, 8.0]))
def test_changes_of_the_map_leave_no_stale_cost(seed, thin, radius) -> None:
    rng = np.random.default_rng(seed)
    weights = blocks(rng, thin)
    free = np.flatnonzero(weights)
    if free.size < 2:
        return
    start, goal = (int(cell) for cell in rng.choice(free, 2))
    field = CostToGo((ROWS, COLS))
    for _ in range(6):
        check(field, terrain(weights, start, goal, radius), start, goal)
        weights = weights.copy()
        row, col = rng.integers(1, ROWS - 4), rng.integers(1, COLS - 4)
        size = rng.integers(1, 8, 2)
        part = weights[1:-1, 1:-1][row : row + size[0], col : col + size[1]]
        part[:] = rng.choice([LETHAL, 4, 30] if weights.max() > 4 else [LETHAL, 4])
        if rng.random() < 0.5:
            start = int(rng.choice(free))


@given(st.integers(0, 10_000))
def test_where_the_way_is_not_touched_nothing_is_looked_for_anew(seed) -> None:
    rng = np.random.default_rng(seed)
    weights = np.full((ROWS, COLS), 4, np.uint8)
    weights[0] = weights[-1] = weights[:, 0] = weights[:, -1] = LETHAL
    wall = np.s_[20:30, int(rng.integers(5, 40))]
    weights[wall] = LETHAL
    start, goal = 3 * COLS + 3, 3 * COLS + 45
    field = CostToGo((ROWS, COLS))
    assert field.cheapest_path(start, terrain(weights, start, goal)) is not None
    weights = weights.copy()
    weights[20:30, 42] = LETHAL  # A wall that comes far away makes no way better.
    check(field, terrain(weights, start + 4, goal), start + 4, goal)
    assert field.searches == 1
    weights[wall] = 4  # One that goes may.
    check(field, terrain(weights, start + 4, goal), start + 4, goal)
    assert field.searches == 2


NO_SEEDS = np.empty((0, 2), np.int32)


@settings(max_examples=cases(60), deadline=None)
@given(st.integers(0, 10_000), st.booleans(), st.sampled_from([8, 16]))
def test_costs_repaired_after_changes_are_those_computed_anew(seed, thin, directions) -> None:
    rng = np.random.default_rng(seed)
    weights = blocks(rng, thin)
    if not weights.any():
        return
    target = int(rng.choice(np.flatnonzero(weights)))
    tiles = (-(-ROWS // TILE) + 2, -(-COLS // TILE) + 2)
    inner = np.arange(math.prod(tiles), dtype=np.int32).reshape(tiles)[1:-1, 1:-1].reshape(-1)
    corridor = Corridor(
        np.zeros(math.prod(tiles), np.int32),
        np.zeros(tiles, np.uint8),
        np.zeros((ROWS, COLS), np.uint8),
        np.full((ROWS, COLS), UNREACHED, np.int32),
    )
    target_tile = (target // COLS // TILE + 1) * tiles[1] + target % COLS // TILE + 1
    queue, cost = make_queue(ROWS * COLS), corridor.cost.reshape(-1)
    chosen = np.concatenate([[target_tile], rng.choice(inner, 60)]).astype(np.int32)
    count = open_path(corridor, 0, weights, chosen, 1)
    rewind(corridor, count, queue, -1)
    flat, seeds = corridor.weights.reshape(-1), np.array([[target, 0]], np.int32)
    grow(cost, flat, queue, seeds, COLS, 0, (-1, 0), directions)
    compare(corridor, target, directions)
    for _ in range(6):
        weights = weights.copy()
        row, col = rng.integers(1, ROWS - 4), rng.integers(1, COLS - 4)
        weights[1:-1, 1:-1][row : row + 3, col : col + 3] = rng.choice([LETHAL, 4, 30])
        if weights.reshape(-1)[target] == LETHAL:
            return
        until = reload(corridor, count, terrain(weights, target, target))
        until = min(until, UNREACHED - COSTLIEST_STEP)
        if until == 0:  # Beside the target nothing known is left.
            return
        rewind(corridor, count, queue, until)
        grow(cost, flat, queue, NO_SEEDS, COLS, max(0, until - COSTLIEST_STEP), (-1, 0), directions)
        compare(corridor, target, directions)


def compare(corridor: Corridor, target: int, directions: int) -> None:
    """The costs in a corridor beside those of a search anew in it."""
    flat = corridor.weights.reshape(-1)
    anew = np.empty(flat.size, np.int32)
    seeds, queue = np.array([[target, 0]], np.int32), make_queue(flat.size)
    cost_to_go_into(anew, flat, queue, seeds, COLS, (-1, 0), directions)
    inside = flat != LETHAL
    if directions == 8 or set(flat.tolist()) <= {LETHAL, 4}:
        np.testing.assert_array_equal(corridor.cost.reshape(-1)[inside], anew[inside])
    else:  # Which moves of a knight are tried depends on the order where weights differ by much.
        np.testing.assert_allclose(corridor.cost.reshape(-1)[inside], anew[inside], rtol=0.02)


@settings(max_examples=cases(40), deadline=None)
@given(st.integers(0, 10_000))
def test_over_free_floor_paths_are_as_short_as_can_be(seed) -> None:
    rng = np.random.default_rng(seed)
    weights = blocks(rng, False)
    weights[weights != LETHAL] = 4
    start, goal = (int(cell) for cell in rng.choice(np.flatnonzero(weights), 2))
    found = CostToGo((ROWS, COLS)).cheapest_path(start, terrain(weights, start, goal))
    if found is None or len(found[0]) < 20:
        return
    points = np.stack([found[0] % COLS, found[0] // COLS], axis=1).astype(np.float64) + 0.5
    path = straighten(points, weights, 20.0)
    assert math.isfinite(polyline_cost(weights, path, math.inf))
    length = np.hypot(*np.diff(path, axis=0).T).sum()
    best = taut_length(weights, tuple(points[0]), tuple(points[-1]))
    # It keeps off the corners by up to half a cell.
    assert best - 1e-3 <= length <= 1.02 * best + 2.5


@given(st.integers(0, 10_000), st.integers(3, 30), st.integers(3, 30), st.floats(0.0, 1.0))
def test_a_tile_is_as_passable_as_its_best_line(seed, rows, cols, share) -> None:
    rng = np.random.default_rng(seed)
    weights = rng.integers(4, 256, (rows, cols)).astype(np.uint8)
    weights[rng.random((rows, cols)) < share] = LETHAL
    shape = -(-rows // TILE) + 2, -(-cols // TILE) + 2
    tiles = Coarse(
        np.zeros(shape, np.uint8),
        np.zeros(math.prod(shape), np.int32),
        make_queue(math.prod(shape)),
        np.zeros((rows, cols), np.uint8),
        np.ones(shape[0], np.uint8),
    )
    retile_changes(tiles, weights)
    coarse = tiles.weights.copy()
    whole = np.zeros((TILE * coarse.shape[0], TILE * coarse.shape[1]), np.uint8)
    whole[TILE : TILE + rows, TILE : TILE + cols] = weights
    for row in range(coarse.shape[0]):
        for col in range(coarse.shape[1]):
            tile = whole[TILE * row : TILE * (row + 1), TILE * col : TILE * (col + 1)].astype(int)
            lines = [sum(line) for line in [*tile, *tile.T] if all(line)]
            expected = (min(lines) + TILE // 2) // TILE if lines else LETHAL
            if not lines and tile.any():
                expected = tile[tile > 0].min()
            assert coarse[row, col] == expected
    # What is written for a few tiles is the same.
    corridor = Corridor(
        np.arange(coarse.size, dtype=np.int32).reshape(coarse.shape)[1:-1, 1:-1].flatten(),
        np.ones(coarse.shape, np.uint8),
        weights,
        np.zeros((rows, cols), np.int32),
    )
    tiles.weights[1:-1, 1:-1] = 99
    retile(tiles, corridor, len(corridor.tiles))
    np.testing.assert_array_equal(tiles.weights[1:-1, 1:-1], coarse[1:-1, 1:-1])
    # And it is made anew from the cells afterwards, as after any change of theirs.
    retile_changes(tiles, weights)
    np.testing.assert_array_equal(tiles.weights, coarse)
    changed = weights.copy()
    changed[rng.integers(rows), rng.integers(cols)] = 7
    retile_changes(tiles, changed)
    tiles.is_stale[:] = 1
    kept = tiles.weights.copy()
    retile_changes(tiles, changed)
    np.testing.assert_array_equal(tiles.weights, kept)


@given(st.integers(0, 2**32 - 1), st.booleans())
def test_a_path_along_a_border_of_cells_counts_for_both_rows(seed: int, on_borders: bool) -> None:
    rng = np.random.default_rng(seed)
    size, edge_m, price = int(rng.integers(3, 40)), 0.05, 2720.0
    corner = float(rng.uniform(-3.0, 3.0)), float(rng.uniform(-3.0, 3.0))
    cells = rng.uniform(-3.0, size + 3.0, (int(rng.integers(0, 60)), 2))
    points = (np.round(cells) if on_borders else cells) * edge_m + corner
    remaining_m = rng.uniform(0.0, 9.0, len(points))
    weights = np.ones((size, size), np.uint8)
    found = seeds_along(points, remaining_m, price, weights, corner, edge_m)
    plain: list[int] = []
    for x, y in ((points - corner) / edge_m).tolist():
        for beside in (-LOCAL.border_cells, LOCAL.border_cells):
            col, row = math.floor(x + beside), math.floor(y + beside)
            if 1 <= col <= size - 2 and 1 <= row <= size - 2:
                plain.append(row * size + col)
    assert found[:, 0].tolist() == plain


@given(st.floats(-math.pi, math.pi), st.floats(0.02, 0.1), st.floats(0.5, 4.0))
def test_cells_of_a_straight_path_cost_what_is_left_from_abreast_of_their_centres(
    yaw: float, step_m: float, dearness: float
) -> None:
    size, edge_m, price = 80, 0.05, 2720.0
    ahead, start = np.array([math.cos(yaw), math.sin(yaw)]), np.array([2.01, 1.97])
    along_m = np.arange(0.0, 1.9, step_m)
    points = start + along_m[:, None] * ahead
    weights = np.ones((size, size), np.uint8)
    remaining_m = dearness * (along_m[-1] - along_m)
    found = seeds_along(points, remaining_m, price, weights, (0.0, 0.0), edge_m)
    centres = (np.stack([found[:, 0] % size, found[:, 0] // size], axis=1) + 0.5) * edge_m
    left_m = np.maximum(along_m[-1] - (centres - start) @ ahead, 0.0)
    np.testing.assert_allclose(found[:, 1], price * dearness * left_m, atol=1.0)
