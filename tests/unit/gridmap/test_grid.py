import math
import subprocess
import sys

import numpy as np
import pytest

from trolley.geometry import Pose2D
from trolley.gridmap import GridMap


@pytest.fixture
def turned() -> GridMap:
    """Two rows, three columns of 0.5 m, turned a quarter to the left about (1, 2)."""
    cells = np.array([[0, 50, 100], [-1, 64, 65]], dtype=np.int8)
    return GridMap("turned", 0.5, Pose2D(1.0, 2.0, math.pi / 2), cells)


def test_origin_is_the_outer_corner_of_the_first_cell() -> None:
    grid = GridMap("plain", 0.1, Pose2D(-1.0, -2.0, 0.0), np.zeros((4, 5), dtype=np.int8))
    points = np.array([[-0.999, -1.999], [-1.001, -2.0], [-0.55, -1.65]])
    assert grid.world_to_cell(points).tolist() == [[0, 0], [0, -1], [3, 4]]
    assert grid.contains(points).tolist() == [True, False, True]


def test_columns_run_along_the_turned_x_axis(turned: GridMap) -> None:
    cells = np.array([[0, 0], [0, 2], [1, 0]])
    centres = turned.cell_to_world(cells)
    np.testing.assert_allclose(centres, [[0.75, 2.25], [0.75, 3.25], [0.25, 2.25]], atol=1e-12)
    assert turned.world_to_cell(centres).tolist() == cells.tolist()
    assert turned.values_at(centres).tolist() == [0, 100, -1]


def test_corners_run_counter_clockwise(turned: GridMap) -> None:
    np.testing.assert_allclose(turned.corners(), [[1, 2], [1, 3.5], [0, 3.5], [0, 2]], atol=1e-12)
    assert turned.size_m == (1.5, 1.0)


def test_points_off_the_grid_get_the_value_for_outside(turned: GridMap) -> None:
    points = np.array([[50.0, 50.0], [np.nan, 0.0], [np.inf, -np.inf], [1e300, 0.0]])
    assert not turned.contains(points).any()
    assert turned.values_at(points, outside=100).tolist() == [100, 100, 100, 100]


def test_masks_split_at_the_threshold(turned: GridMap) -> None:
    assert turned.occupied_mask().tolist() == [[0, 0, 1], [0, 0, 1]]
    assert turned.occupied_mask(threshold=50).tolist() == [[0, 1, 1], [0, 1, 1]]
    assert turned.free_mask().tolist() == [[1, 1, 0], [0, 1, 0]]
    assert turned.occupied_mask().dtype == np.uint8


@pytest.mark.parametrize(
    ("resolution", "origin", "cells", "sentence"),
    [
        (0.0, Pose2D(0.0, 0.0, 0.0), np.zeros((2, 2), dtype=np.int8), "resolution"),
        (math.nan, Pose2D(0.0, 0.0, 0.0), np.zeros((2, 2), dtype=np.int8), "resolution"),
        (0.1, Pose2D(math.inf, 0.0, 0.0), np.zeros((2, 2), dtype=np.int8), "origin"),
        (0.1, Pose2D(0.0, 0.0, 0.0), np.zeros((2, 0), dtype=np.int8), "non-empty"),
        (0.1, Pose2D(0.0, 0.0, 0.0), np.zeros(4, dtype=np.int8), "rows, cols"),
        (0.1, Pose2D(0.0, 0.0, 0.0), np.zeros((2, 2)), "int8"),
    ],
)
def test_what_is_no_grid_is_refused(
    resolution: float, origin: Pose2D, cells: np.ndarray, sentence: str
) -> None:
    with pytest.raises(ValueError, match=sentence):
        GridMap("bad", resolution, origin, cells)


@pytest.mark.programs
def test_maps_and_poses_do_without_the_compiler() -> None:
    program = (
        "import sys, trolley.geometry, trolley.gridmap; "
        "print(*sorted({'numba', 'PIL', 'yaml', 'zenoh'} & {*sys.modules}))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == ""
