"""Laying one map over another: it is found where it lies, or refused."""

import math

import numpy as np
import pytest

from trolley import codes
from trolley.codes import Refused
from trolley.geometry import Pose2D, angle_difference
from trolley.gridmap import UNKNOWN, GridMap, load_map
from trolley.map_editing import apply
from trolley.map_editing.apply import crop
from trolley.messages.editing import Turn
from trolley.worlds import folder
from trolley_mapper.edit.map_alignment import align_maps

pytestmark = pytest.mark.drives

FLAT = load_map(folder() / "apartment.yaml")


def half(grid: GridMap, *, is_left: bool, overlap: float) -> GridMap:
    """One half of a map and a little more."""
    low, high = grid.corners().min(axis=0), grid.corners().max(axis=0)
    middle = 0.5 * (low[0] + high[0]) + (overlap if is_left else -overlap)
    a, b = ((low[0], low[1]), (middle, high[1])) if is_left else ((middle, low[1]), tuple(high))
    return crop(grid, a, (float(b[0]), float(b[1])))


@pytest.mark.parametrize("angle", [0.0, 2.2])
def test_a_map_that_was_turned_is_found_where_it_lies(angle: float) -> None:
    right = half(FLAT, is_left=False, overlap=1.0)
    turned, old_T_new = apply(right, Turn(angle=angle, about=(2.0, 1.0)))
    found = align_maps(half(FLAT, is_left=True, overlap=1.0), turned)
    assert found.this_T_other.distance_to(old_T_new) < 0.05
    assert abs(angle_difference(found.this_T_other.yaw, old_T_new.yaw)) < math.radians(0.4)
    assert found.agreeing_m > 3.0


def test_rooms_that_look_the_same_from_all_sides_are_ambiguous() -> None:
    cells = np.full((80, 80), UNKNOWN, np.int8)
    cells[10:70, 10:70] = 100
    cells[12:68, 12:68] = 0
    square = GridMap("square", 0.05, Pose2D.identity(), cells)
    with pytest.raises(Refused) as refused:
        align_maps(square, square)
    assert refused.value.code == codes.AMBIGUOUS


def test_another_house_does_not_fit() -> None:
    rng = np.random.default_rng(5)
    cells = np.zeros((100, 100), np.int8)
    for _ in range(25):
        row, col = rng.integers(5, 90, 2)
        cells[row : row + 2, col : col + int(rng.integers(3, 10))] = 100
    odd = GridMap("odd", 0.05, Pose2D.identity(), cells)
    with pytest.raises(Refused) as refused:
        align_maps(FLAT, odd)
    assert refused.value.code in (codes.NO_MATCH, codes.AMBIGUOUS)


def test_a_map_without_walls_is_refused() -> None:
    empty = GridMap("empty", 0.05, Pose2D.identity(), np.zeros((9, 9), np.int8))
    with pytest.raises(Refused, match="empty has no walls"):
        align_maps(FLAT, empty)
