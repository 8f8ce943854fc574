"""The kernels on grids that services share, against slow, obvious twins."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from trolley.gridmap.kernels import (
    begin_march,
    disc_box,
    first_occupied,
    interpolate,
    is_in_disc,
    next_cell,
)

sizes = st.integers(2, 20)
points = st.floats(-3.0, 23.0)
angles = st.floats(-7.0, 7.0).map(lambda angle: round(angle, 9))
values = hnp.arrays(np.float32, st.tuples(sizes, sizes), elements=st.floats(-5.0, 5.0, width=32))


@given(st.floats(0.1, 9.9), st.floats(0.1, 9.9), angles)
def test_a_march_passes_the_cells_of_its_ray_in_order(x: float, y: float, angle: float) -> None:
    dx, dy = math.cos(angle), math.sin(angle)
    at = begin_march((x, y), (dx, dy), (math.floor(y), math.floor(x)), 0.0)
    for _ in range(30):
        after = next_cell(at)
        assert after.travelled >= at.travelled
        assert abs(after.row - at.row) + abs(after.col - at.col) == 1
        middle = 0.5 * (at.travelled + after.travelled)
        assert abs(x + middle * dx - (at.col + 0.5)) <= 0.5 + 1e-6
        assert abs(y + middle * dy - (at.row + 0.5)) <= 0.5 + 1e-6
        at = after


@given(points, points, angles, st.floats(0.5, 30.0))
def test_what_a_ray_meets_first_lies_on_the_border_of_an_occupied_cell(
    x: float, y: float, angle: float, reach: float
) -> None:
    occupied = np.zeros((20, 20), np.uint8)
    occupied[3:5, 7] = occupied[15, 2:18] = 1
    dx, dy = math.cos(angle), math.sin(angle)
    met = first_occupied(occupied, x, y, dx, dy, reach)
    steps = np.arange(0.0, reach, 0.01)
    cols, rows = np.floor(x + steps * dx).astype(int), np.floor(y + steps * dy).astype(int)
    inside = (cols >= 0) & (cols < 20) & (rows >= 0) & (rows < 20)
    hits = np.zeros(steps.size, bool)
    hits[inside] = occupied[rows[inside], cols[inside]] != 0
    if hits.any():
        assert met <= steps[hits.argmax()] + 1e-9
    if met < math.inf:
        at = np.array([x + met * dx, y + met * dy])
        cells = np.argwhere(occupied)[:, ::-1]
        assert (np.abs(at - (cells + 0.5)).max(axis=1) <= 0.5 + 1e-6).any()


@given(values, points, points)
def test_a_value_between_cells_lies_between_theirs(grid: np.ndarray, x: float, y: float) -> None:
    rows, cols = grid.shape
    got = interpolate(grid, x, y)
    u, v = min(max(x, 0.0), cols - 1.001), min(max(y, 0.0), rows - 1.001)
    four = grid[int(v) : int(v) + 2, int(u) : int(u) + 2]
    assert four.min() - 1e-4 <= got <= four.max() + 1e-4
    if 0 <= x < cols - 1 and x == int(x) and 0 <= y < rows - 1 and y == int(y):
        assert abs(got - grid[int(y), int(x)]) < 1e-5


@given(points, points, st.floats(0.0, 8.0), sizes, sizes)
def test_the_box_of_a_disc_holds_all_its_cells(
    x: float, y: float, radius: float, rows: int, cols: int
) -> None:
    top, left, bottom, right = disc_box(x, y, radius, rows, cols)
    within = {
        (row, col)
        for row in range(rows)
        for col in range(cols)
        if math.hypot(col + 0.5 - x, row + 0.5 - y) <= radius
    }
    found = {
        (row, col)
        for row in range(top, bottom)
        for col in range(left, right)
        if is_in_disc(row, col, x, y, radius)
    }
    assert found == within
