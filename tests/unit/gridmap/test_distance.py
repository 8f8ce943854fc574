import math

import numpy as np
import pytest

from trolley.gridmap import cast_rays, distance_transform


def test_distances_from_one_cell() -> None:
    mask = np.zeros((3, 4), dtype=np.uint8)
    mask[0, 0] = 1
    distance = distance_transform(mask, 0.5)
    rows, cols = np.mgrid[:3, :4]
    np.testing.assert_allclose(distance, 0.5 * np.hypot(rows, cols), rtol=1e-6)
    assert distance.dtype == np.float32


def test_nothing_set_is_infinitely_far() -> None:
    empty = np.zeros((3, 4), dtype=np.bool_)
    assert np.isinf(distance_transform(empty, 0.1)).all()
    assert (distance_transform(empty, 0.1, max_distance=2.0) == 2.0).all()


def test_everything_set_is_no_distance() -> None:
    assert (distance_transform(np.ones((5, 3), dtype=np.uint8), 0.1) == 0.0).all()


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (7, 1)])
def test_single_rows_and_columns(shape: tuple[int, int]) -> None:
    mask = np.zeros(shape, dtype=np.uint8)
    mask.flat[0] = 1
    expected = np.arange(mask.size, dtype=np.float32).reshape(shape)
    np.testing.assert_array_equal(distance_transform(mask, 1.0), expected)


def test_any_kind_of_mask_is_taken_and_left_alone() -> None:
    plain = np.zeros((6, 8), dtype=np.uint8)
    plain[2, 3] = 255
    read_only = np.frombuffer(plain.tobytes(), dtype=np.uint8).reshape(plain.shape)
    expected = distance_transform(plain, 0.1)
    for mask in (plain != 0, read_only, np.asfortranarray(plain), np.repeat(plain, 2, 1)[:, ::2]):
        before = mask.copy()
        np.testing.assert_array_equal(distance_transform(mask, 0.1), expected)
        np.testing.assert_array_equal(mask, before)


@pytest.mark.parametrize(("resolution", "limit"), [(0.0, 1.0), (math.nan, 1.0), (0.1, 0.0)])
def test_lengths_must_be_positive(resolution: float, limit: float) -> None:
    with pytest.raises(ValueError, match="positive"):
        distance_transform(np.ones((2, 2), dtype=np.uint8), resolution, limit)
    with pytest.raises(ValueError, match="positive"):
        cast_rays(np.ones((2, 2), dtype=np.uint8), resolution, (0.0, 0.0), np.zeros(1), limit)


def test_empty_grid_is_refused() -> None:
    with pytest.raises(ValueError, match="rows and columns"):
        distance_transform(np.zeros((0, 3), dtype=np.uint8), 0.1)


@pytest.fixture
def room() -> np.ndarray:
    """A closed room of 10 x 8 cells, walls one cell thick."""
    occupied = np.ones((8, 10), dtype=np.uint8)
    occupied[1:-1, 1:-1] = 0
    return occupied


def test_rays_stop_at_the_inner_side_of_the_walls(room: np.ndarray) -> None:
    angles = np.array([0.0, math.pi / 2, math.pi, -math.pi / 2, math.pi / 4])
    ranges = cast_rays(room, 0.5, (2.0, 1.5), angles, 100.0)
    np.testing.assert_allclose(ranges, [2.5, 2.0, 1.5, 1.0, 2.0 * math.sqrt(2.0)], rtol=1e-6)


def test_start_in_a_wall_is_no_distance(room: np.ndarray) -> None:
    assert cast_rays(room, 0.5, (0.2, 0.2), np.array([0.3, 2.0]), 10.0).tolist() == [0.0, 0.0]


def test_start_outside_sees_the_outer_side(room: np.ndarray) -> None:
    angles = np.array([0.0, math.pi, 1.2])
    ranges = cast_rays(room, 0.5, (-1.0, 2.0), angles, 100.0)
    assert ranges.tolist() == [1.0, math.inf, math.inf]


def test_far_walls_do_not_count(room: np.ndarray) -> None:
    assert cast_rays(room, 0.5, (2.0, 1.5), np.zeros(1), 2.4).tolist() == [math.inf]
    assert cast_rays(room, 0.5, (2.0, 1.5), np.zeros(1), 2.6).tolist() == [2.5]


def test_empty_world_ends_at_its_edge() -> None:
    ranges = cast_rays(np.zeros((4, 4), dtype=np.uint8), 0.5, (1.0, 1.0), np.arange(6.0), math.inf)
    assert np.isinf(ranges).all()


@pytest.mark.parametrize("start", [(math.nan, 1.0), (math.inf, 1.0), (1e300, -1e300)])
def test_start_that_is_nowhere_hits_nothing(room: np.ndarray, start: tuple[float, float]) -> None:
    angles = np.array([0.0, 1.0, math.nan, math.inf])
    assert np.isinf(cast_rays(room, 0.5, start, angles, math.inf)).all()
