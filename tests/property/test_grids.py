"""Coordinates, distances and rays of grids against slow, obvious twins."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from trolley.geometry import Pose2D
from trolley.gridmap import GridMap, cast_rays, distance_transform

shapes = st.tuples(st.integers(1, 24), st.integers(1, 24))
resolutions = st.sampled_from([0.01, 0.025, 0.03, 0.05, 0.1, 1.0])
poses = st.builds(
    Pose2D, st.floats(-50.0, 50.0), st.floats(-50.0, 50.0), st.floats(-math.pi, math.pi)
)
masks = hnp.arrays(np.uint8, shapes, elements=st.sampled_from([0, 0, 0, 0, 0, 1]), fill=st.just(0))


@given(shapes, resolutions, poses)
def test_cells_and_their_centres_are_inverse(
    shape: tuple[int, int], resolution: float, origin: Pose2D
) -> None:
    grid = GridMap("any", resolution, origin, np.zeros(shape, dtype=np.int8))
    cells = np.argwhere(np.ones(shape))
    centres = grid.cell_to_world(cells)
    np.testing.assert_array_equal(grid.world_to_cell(centres), cells)
    assert grid.contains(centres).all()


@given(shapes, resolutions, poses, st.floats(-30.0, 30.0), st.floats(-30.0, 30.0))
def test_a_point_lies_within_its_cell(
    shape: tuple[int, int], resolution: float, origin: Pose2D, x: float, y: float
) -> None:
    grid = GridMap("any", resolution, origin, np.zeros(shape, dtype=np.int8))
    points = np.array([[x, y]])
    centre = grid.cell_to_world(grid.world_to_cell(points))
    offset = grid.world_to_grid(points) - grid.world_to_grid(centre)
    assert np.abs(offset).max() <= resolution / 2 + 1e-9


def naive_distances(mask: np.ndarray, resolution: float, limit: float) -> np.ndarray:
    """The distance of each cell to each set cell, and the smallest of them."""
    rows, cols = np.indices(mask.shape)
    nearest = np.full(mask.shape, np.inf)
    for row, col in np.argwhere(mask):
        nearest = np.minimum(nearest, (rows - row) ** 2 + (cols - col) ** 2)
    return np.minimum(resolution * np.sqrt(nearest), limit)


@given(masks, resolutions, st.sampled_from([math.inf, 0.07, 0.5, 3.0]))
def test_distances_are_those_to_the_nearest_set_cell(
    mask: np.ndarray, resolution: float, limit: float
) -> None:
    distance = distance_transform(mask, resolution, limit)
    np.testing.assert_allclose(distance, naive_distances(mask, resolution, limit), rtol=1e-6)


def naive_ray(mask: np.ndarray, start: tuple[float, float], angle: float, margin: float) -> float:
    """Distance [cells] at which a ray enters the nearest set cell, grown by a margin [cells]."""
    nearest = math.inf
    step = (math.cos(angle), math.sin(angle))
    for row, col in np.argwhere(mask):
        enter, leave = 0.0, math.inf
        for position, speed, low in zip(start, step, (col, row), strict=True):
            near, far = low - margin - position, low + 1 + margin - position
            if speed == 0.0:
                leave = leave if near <= 0.0 <= far else -1.0
                continue
            near, far = sorted((near / speed, far / speed))
            enter, leave = max(enter, near), min(leave, far)
        if enter <= leave:
            nearest = min(nearest, enter)
    return nearest


# In steps of 1e-9: nearer to an axis the slower twin divides by next to nothing.
ANGLES = st.floats(-7.0, 7.0).map(lambda angle: round(angle, 9))


@given(
    masks,
    st.tuples(st.floats(-5.0, 30.0), st.floats(-5.0, 30.0)),
    st.one_of(ANGLES, st.sampled_from([k * math.pi / 4 for k in range(-4, 5)])),
    st.one_of(st.just(math.inf), st.floats(0.1, 40.0)),
)
def test_rays_end_at_the_nearest_cell(
    mask: np.ndarray, start: tuple[float, float], angle: float, reach: float
) -> None:
    (hit,) = cast_rays(mask, 1.0, start, np.array([angle]), reach)
    # A ray that runs along the border of cells may take either side, so the cells are once
    # grown and once shrunk by a hair: the true answer lies between.
    soonest = naive_ray(mask, start, angle, 1e-6)
    latest = naive_ray(mask, start, angle, -1e-6)
    slack = 1e-4 + 1e-5 / max(1e-3, min(abs(math.cos(angle)), abs(math.sin(angle)), 1.0))
    if math.isinf(hit):
        assert latest >= reach - slack
    else:
        assert soonest - slack <= hit <= min(latest, reach) + slack
