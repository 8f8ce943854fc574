"""Searching the whole map with one scan."""

import math
from dataclasses import replace

import numpy as np
import pytest

from trolley.config.localizer import LocalizerConfig
from trolley.geometry import Pose2D
from trolley.gridmap import OCCUPIED, UNKNOWN, GridMap
from trolley.slices import whole
from trolley_localizer.matching import global_search
from trolley_localizer.matching.global_search import build_pyramid, find_places
from trolley_localizer.matching.likelihood_field import build_field, make_lines
from trolley_localizer.matching.map_matcher import MapMatcher, read_beams

from .conftest import at, make_scan

CONFIG = LocalizerConfig()


@pytest.mark.parametrize(
    ("x", "y", "yaw"), [(5.5, 3.0, 0.4), (1.5, 1.5, 2.0), (2.5, 5.0, -3.0), (7.3, 0.8, 1.5)]
)
def test_the_place_is_the_first_of_those_found(
    flat: GridMap, x: float, y: float, yaw: float
) -> None:
    field = build_field(flat, CONFIG)
    matcher = MapMatcher(field, make_lines(field, []), CONFIG)
    pose = at(flat, x, y, yaw)
    beams = read_beams(make_scan(flat, pose, Pose2D.identity()), 0.05, 60.0)
    places = whole(find_places(field, build_pyramid(field), beams, matcher))
    found = field.to_map(places[0].pose)
    assert found.distance_to(pose) < 0.06
    assert abs((found.inverse() @ pose).yaw) < math.radians(1.0)
    values = [place.support.value for place in places]
    assert values == sorted(values, reverse=True)
    assert len(values) == 1 or values[0] > values[1] + CONFIG.search_margin


@pytest.mark.parametrize("beside", [0, 18])
def test_a_robot_where_furniture_stood_on_the_map_is_found(flat: GridMap, beside: int) -> None:
    """The map knows the outline of a bed and not what is beneath it; the bed has been moved."""
    pose = at(flat, 1.2, 4.6, 0.7)
    row, col = flat.world_to_cell(flat.origin.transform_points(np.array([[1.2, 4.6]])))[0]
    row += beside  # the robot stands in the middle or where the outline was
    cells = flat.cells.copy()
    cells[row - 19 : row + 20, col - 19 : col + 20] = OCCUPIED
    cells[row - 17 : row + 18, col - 17 : col + 18] = UNKNOWN
    field = build_field(replace(flat, cells=cells), CONFIG)
    matcher = MapMatcher(field, make_lines(field, []), CONFIG)
    beams = read_beams(make_scan(flat, pose, Pose2D.identity()), 0.05, 60.0)
    places = whole(find_places(field, build_pyramid(field), beams, matcher))
    found = [field.to_map(place.pose) for place in places]
    assert min(one.distance_to(pose) for one in found) < 0.06
    assert beside > 0 or found[0].distance_to(pose) < 0.06


@pytest.mark.parametrize("shape", [(1, 1), (3, 200), (40, 40)])
def test_maps_that_say_nothing_give_no_place_and_no_error(shape: tuple[int, int]) -> None:
    blank = GridMap("blank", 0.05, Pose2D.identity(), np.full(shape, -1, np.int8))
    field = build_field(blank, CONFIG)
    matcher = MapMatcher(field, make_lines(field, []), CONFIG)
    beams = read_beams(make_scan(blank, Pose2D(0.02, 0.02, 0.0), Pose2D.identity()), 0.05, 60.0)
    assert whole(find_places(field, build_pyramid(field), beams, matcher)) == []


@pytest.mark.parametrize(("shape", "resolution"), [((1000, 1000), 10.0), ((1, 2_000_000), 0.05)])
def test_a_coarse_or_a_long_map_takes_no_more_memory_than_a_large_one(
    shape: tuple[int, int], resolution: float
) -> None:
    cells = np.zeros(shape, np.int8)
    cells[0, ::7] = OCCUPIED
    field = build_field(GridMap("land", resolution, Pose2D.identity(), cells), CONFIG)
    pyramid = build_pyramid(field)
    bytes_per_heading = 4 * int(pyramid.rows[-1] * pyramid.cols[-1])
    assert 480 * bytes_per_heading < 100e6


def test_with_larger_blocks_the_best_place_is_the_same(
    flat: GridMap, monkeypatch: pytest.MonkeyPatch
) -> None:
    field = build_field(flat, CONFIG)
    matcher = MapMatcher(field, make_lines(field, []), CONFIG)
    scan = make_scan(flat, at(flat, 5.5, 3.0, 0.4), Pose2D.identity())
    beams = read_beams(scan, 0.05, 60.0)
    usual = whole(find_places(field, build_pyramid(field), beams, matcher))
    monkeypatch.setattr(global_search, "PARAMS", replace(global_search.PARAMS, most_top_blocks=1))
    pyramid = build_pyramid(field)
    assert (pyramid.rows[-1], pyramid.cols[-1]) == (1, 1)
    found = whole(find_places(field, pyramid, beams, matcher))
    np.testing.assert_allclose(found[0].pose, usual[0].pose, atol=0.1)
