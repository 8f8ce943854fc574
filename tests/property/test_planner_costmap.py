"""The costmap's compiled loops beside slow plain ones."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.gridmap.distance import distance_transform
from trolley_planner.costmap.cost_layer import raise_weights
from trolley_planner.costmap.inflation import (
    UNKNOWN,
    WALL,
    WEIGHT_UNIT,
    CostmapLayers,
    compose_into,
    replace_mask,
    update_distances,
)
from trolley_planner.costmap.obstacle_grid import (
    OBSTACLES,
    ObstacleGrid,
    clear_inside_robot,
    lift_cells,
    lift_echoes,
    seen_lately,
    trace_ray,
)
from trolley_planner.costmap.social_layer import spread_walk

ROWS, COLS = 14, 17
EDGE_M = 0.05
SEEDS = st.integers(0, 2**32 - 1)
PLACES = st.floats(-4.0, 20.0)
ANGLES = st.floats(-math.pi, math.pi)


def full_layer(seed: int) -> ObstacleGrid:
    """A layer whose every cell holds something, seen at a random place in it."""
    rng = np.random.default_rng(seed)
    shape = (ROWS, COLS)
    corners = np.stack(np.meshgrid(np.arange(COLS), np.arange(ROWS)), axis=-1)
    points = 0.1 * (corners + rng.uniform(0.05, 0.95, (*shape, 2)))
    return ObstacleGrid(
        evidence=rng.integers(1, 13, shape).astype(np.uint8),
        hits=rng.integers(1, 256, shape).astype(np.uint8),
        seen_ticks=np.zeros(shape, dtype=np.int32),
        points=points.astype(np.float32),
        observed=np.zeros(shape, dtype=np.int32),
        stood_ticks=np.zeros(shape, dtype=np.int32),
        touched=np.zeros((*shape, 2), dtype=np.int32),
        dirty=np.array([99, -1, 99, -1], dtype=np.int64),
    )


@given(SEEDS, st.booleans())
def test_a_cell_is_blocked_by_any_layer(seed: int, unknown_blocks: bool) -> None:
    rng = np.random.default_rng(seed)
    kinds = rng.integers(0, 3, (ROWS, COLS)).astype(np.uint8)
    keepout, closed, evidence, observed = (
        (rng.random((ROWS, COLS)) < 0.3).astype(np.uint8) for _ in range(4)
    )
    layers = CostmapLayers(kinds, keepout, closed, evidence, observed.astype(np.int32))
    first_row, first_col = int(rng.integers(0, 5)), int(rng.integers(0, 5))
    mask = np.full((ROWS - first_row - 1, COLS - first_col - 2), 7, dtype=np.uint8)
    compose_into(mask, layers, (first_row, first_col), unknown_blocks)
    expected = (kinds == WALL) | (keepout > 0) | (closed > 0) | (evidence > 0)
    if unknown_blocks:
        expected |= (kinds == UNKNOWN) & (observed == 0)
    box = expected[first_row : first_row + mask.shape[0], first_col : first_col + mask.shape[1]]
    np.testing.assert_array_equal(mask, box)


@given(SEEDS, st.floats(0.0, 0.3), st.integers(0, 6), st.sampled_from([0.31, 0.5, 4.0]))
def test_distances_after_a_few_changes_are_those_computed_anew(seed, share, count, limit_m) -> None:
    rng = np.random.default_rng(seed)
    mask = (rng.random((30, 41)) < share).astype(np.uint8)
    distance_m = distance_transform(mask, 0.1, limit_m)
    for _ in range(3):
        first = int(rng.integers(0, 10)), int(rng.integers(0, 10))
        before, box = mask.copy(), mask[first[0] : 25, first[1] : 38].copy()
        for _ in range(count):
            box[rng.integers(box.shape[0]), rng.integers(box.shape[1])] ^= 1
        flipped = replace_mask(mask, box, first)
        np.testing.assert_array_equal(flipped, np.argwhere(mask != before))
        np.testing.assert_array_equal(mask[first[0] : 25, first[1] : 38], box)
        old_m = distance_m.copy()
        boxes = update_distances(distance_m, mask, flipped, 0.1, limit_m)
        np.testing.assert_array_equal(distance_m, distance_transform(mask, 0.1, limit_m))
        for row, end, col, end_col in boxes:
            old_m[row:end, col:end_col] = distance_m[row:end, col:end_col]
        np.testing.assert_array_equal(distance_m, old_m)


def cells_along(x: float, y: float, angle: float, start: float, end: float) -> set[tuple[int, int]]:
    """The cells that a dense row of points on a ray lies in."""
    along = np.arange(start, end, 0.002)
    rows = np.floor(y + along * math.sin(angle)).astype(int)
    cols = np.floor(x + along * math.cos(angle)).astype(int)
    inside = (rows >= 0) & (rows < ROWS) & (cols >= 0) & (cols < COLS)
    return set(zip(rows[inside].tolist(), cols[inside].tolist(), strict=True))


def places(cells: int) -> st.SearchStrategy[float]:
    """Coordinates off the borders of cells: along a border the ray may go on either side."""
    return st.integers(0, 100 * cells - 1).map(lambda number: (number + 0.5) / 100.0)


@given(
    places(COLS),
    places(ROWS),
    ANGLES,
    st.floats(0.0, 5.0),
    st.floats(0.1, 25.0),
)
def test_a_ray_clears_the_cells_it_passes(
    x: float, y: float, angle: float, start: float, length: float
) -> None:
    layer, walls = full_layer(1), np.zeros((ROWS, COLS), dtype=np.uint8)
    ray, stretch = (x, y, math.cos(angle), math.sin(angle)), (start, start + length)
    assert trace_ray(layer, walls, ray, stretch, 1) == math.inf
    passed = set(zip(*(index.tolist() for index in np.nonzero(layer.observed)), strict=True))
    on_the_way = cells_along(x, y, angle, start, start + length)
    # A corner that the dense points miss may count, and the first cell where it enters later.
    entered_before = cells_along(x, y, angle, max(start - 1.5, 0.0), start + 0.005)
    assert on_the_way - entered_before <= passed
    near = {(row + a, col + b) for row, col in on_the_way for a in (-1, 0, 1) for b in (-1, 0, 1)}
    assert passed <= near


@given(ANGLES, st.integers(0, COLS - 1), st.integers(0, ROWS - 1))
def test_a_ray_ends_at_a_wall(angle: float, col: int, row: int) -> None:
    walls = np.zeros((ROWS, COLS), dtype=np.uint8)
    walls[row, col] = 1
    layer = full_layer(2)
    x, y = 8.31, 7.17
    ran = trace_ray(layer, walls, (x, y, math.cos(angle), math.sin(angle)), (0.0, 30.0), 1)
    if ran == math.inf:
        along = cells_along(x, y, angle, 0.0, 30.0)
        assert (row, col) not in along
    else:
        end = x + (ran + 1e-6) * math.cos(angle), y + (ran + 1e-6) * math.sin(angle)
        assert (math.floor(end[1]), math.floor(end[0])) == (row, col)
        assert not layer.observed[row, col]


def inside(polygon: NDArray[np.float64], x: float, y: float) -> bool:
    """Whether a point lies in a convex polygon, counter-clockwise."""
    ahead = np.roll(polygon, -1, axis=0) - polygon
    offset = np.array([x, y]) - polygon
    return bool((ahead[:, 0] * offset[:, 1] - ahead[:, 1] * offset[:, 0] > 0.0).all())


@given(SEEDS, PLACES, PLACES, ANGLES)
def test_what_was_seen_inside_the_outline_is_forgotten(
    seed: int, x: float, y: float, yaw: float
) -> None:
    layer = full_layer(seed)
    corners = np.array([(3.0, 2.0), (-3.0, 2.0), (-3.0, -2.0), (3.0, -2.0)])
    turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
    polygon = corners @ turn.T + (x, y)
    clear_inside_robot(layer, polygon, 0.1, (1, 1))
    for row in range(ROWS):
        for col in range(COLS):
            point = layer.points[row, col].astype(np.float64) / 0.1
            kept = layer.evidence[row, col] > 0
            assert kept != inside(polygon, float(point[0]), float(point[1]))
            assert kept == (layer.hits[row, col] > 0)


def walkers_of(seed: int, count: int) -> NDArray[np.float64]:
    """Discs of people about the layer."""
    rng = np.random.default_rng(seed)
    places, velocities = rng.uniform(-0.3, 1.8, (count, 2)), rng.uniform(-1.5, 1.5, (count, 2))
    return np.column_stack([places, velocities, rng.uniform(0.1, 0.4, count)])


@given(SEEDS, st.integers(0, 3))
def test_who_walks_is_taken_out_and_what_is_seen_beside_their_way_stays(
    seed: int, count: int
) -> None:
    layer, walkers = full_layer(seed), walkers_of(seed, count)
    layer.touched[:, : COLS // 2, 1] = 7
    lift_cells(layer, walkers, 0.1, 7)
    for row in range(ROWS):
        for col in range(COLS):
            x, y = layer.points[row, col].astype(np.float64)
            ago = np.linspace(0.0, 0.0 if col < COLS // 2 else OBSTACLES.trail_s, 101)[:, None]
            where = walkers[:, None, :2] - ago * walkers[:, None, 2:4]
            gaps = np.hypot(where[..., 0] - x, where[..., 1] - y) - walkers[:, 4:5]
            nearest = float(gaps.min(initial=math.inf))
            if abs(nearest - OBSTACLES.person_margin_m) > 1e-3:
                assert (layer.evidence[row, col] == 0) == (nearest < OBSTACLES.person_margin_m)
            assert (layer.evidence[row, col] > 0) == (layer.hits[row, col] > 0)
    if (layer.evidence == 0).any():
        first_row, last_row, first_col, last_col = layer.dirty.tolist()
        rows, cols = np.nonzero(layer.evidence == 0)
        assert (first_row, last_row) == (rows.min(), rows.max())
        assert (first_col, last_col) == (cols.min(), cols.max())


@given(SEEDS, st.integers(0, 3))
def test_echoes_of_who_walks_are_theirs(seed: int, count: int) -> None:
    rng, walkers = np.random.default_rng(seed), walkers_of(seed, count)
    angles, ranges = rng.uniform(-math.pi, math.pi, 40), rng.uniform(0.0, 2.0, 40)
    ranges[::5] = 0.0
    beams = np.column_stack(
        [*np.full((2, 40), 0.7), np.cos(angles), np.sin(angles), ranges, ranges]
    )
    lift_echoes(beams, walkers)
    points = 0.7 + ranges[:, None] * beams[:, 2:4]
    gaps = np.hypot(*np.moveaxis(points[:, None] - walkers[:, :2], -1, 0)) - walkers[:, 4]
    expected = np.where((gaps < OBSTACLES.person_margin_m).any(axis=1), 0.0, ranges)
    np.testing.assert_array_equal(beams[:, 5], expected)
    np.testing.assert_array_equal(beams[:, 4], ranges)


@given(PLACES, PLACES, ANGLES, st.floats(1.0, 12.0), st.floats(0.5, 6.0))
def test_the_way_of_who_walks_is_dear(
    x: float, y: float, angle: float, length: float, reach: float
) -> None:
    dx, dy = length * math.cos(angle), length * math.sin(angle)
    weights = np.full((ROWS, COLS), 5, dtype=np.uint8)
    box = spread_walk(weights, (x, y, x + dx, y + dy), reach, 44.0)
    for row in range(ROWS):
        for col in range(COLS):
            px, py = col + 0.5 - x, row + 0.5 - y
            squared = dx * dx + dy * dy
            along = min(max((px * dx + py * dy) / squared, 0.0), 1.0) if squared > 0.0 else 0.0
            away = math.hypot(px - along * dx, py - along * dy)
            price = 44.0 * (1.0 - 0.7 * along) * (1.0 - away / reach)
            assert abs(int(weights[row, col]) - max(5.0, price)) <= 1.0
            if weights[row, col] > 5:
                assert box[0] <= row <= box[1]
                assert box[2] <= col <= box[3]


@given(SEEDS, ANGLES, st.floats(0.02, 0.4), st.integers(1, 3))
def test_costs_of_programs_lie_where_they_were_put(
    seed: int, angle: float, edge_m: float, samples: int
) -> None:
    rng = np.random.default_rng(seed)
    costs = rng.integers(-1, 128, (4, 6)).astype(np.int8)
    costs_T_grid = Pose2D(rng.uniform(-0.5, 0.5), rng.uniform(-0.5, 0.5), angle)
    weights = rng.integers(0, 8, (ROWS, COLS)).astype(np.uint8)
    expected, scale = weights.copy(), EDGE_M / edge_m
    placed = (
        scale * math.cos(angle),
        scale * math.sin(angle),
        costs_T_grid.x / edge_m,
        costs_T_grid.y / edge_m,
    )
    raise_weights(weights, (0, ROWS, 0, COLS), costs, placed, samples)
    parts = (np.arange(samples) + 0.5) / samples
    for row in range(ROWS):
        for col in range(COLS):
            points = [(EDGE_M * (col + x), EDGE_M * (row + y)) for x in parts for y in parts]
            there = np.floor(costs_T_grid.transform_points(np.array(points)) / edge_m).astype(int)
            found = [int(costs[y, x]) for x, y in there.tolist() if 0 <= x < 6 and 0 <= y < 4]
            highest = min(max(found, default=0), 100)
            if highest > 0:
                weight = math.floor(WEIGHT_UNIT * (1.0 + highest / 10))
                expected[row, col] = max(expected[row, col], weight)
    # A point on the border of two cells may fall into either.
    assert (weights != expected).sum() <= 1


@given(st.integers(0, 2**32 - 1), st.integers(1, 40), st.floats(-50.0, 900.0))
def test_floor_beside_what_stands_is_known_by_a_cell_beside_it(
    seed: int, first_scan: int, first_ticks: float
) -> None:
    rng = np.random.default_rng(seed)
    shape = int(rng.integers(1, 12)), int(rng.integers(1, 12))
    layer = full_layer(seed)._replace(
        observed=rng.integers(0, 41, shape).astype(np.int32),
        evidence=(rng.random(shape) < 0.1).astype(np.uint8),
        stood_ticks=(rng.integers(0, 900, shape) * (rng.random(shape) < 0.1)).astype(np.int32),
    )
    walls = (rng.random(shape) < 0.1).astype(np.uint8)
    rows, cols = (rng.integers(0, size, 20) for size in shape)
    found = seen_lately(layer, walls, rows, cols, (first_scan, first_ticks))
    fresh = (layer.observed >= first_scan) | (layer.stood_ticks > max(first_ticks, 0.0))
    stands = (layer.evidence != 0) | (walls != 0)
    for row, col, known in zip(rows, cols, found, strict=True):
        near = np.s_[max(row - 1, 0) : row + 2, max(col - 1, 0) : col + 2]
        assert known == (fresh[row, col] or (fresh[near].any() and stands[near].any()))
