"""Which names of places can be read beside one another."""

import numpy as np
import pytest
import viser
from hypothesis import given
from hypothesis import strategies as st

from trolley_viz.scene.place_labels import (
    HEIGHT_PX,
    MAX_LETTERS,
    Eye,
    PlaceLabels,
    PlaceName,
    clear_of_others,
)

DOWN = np.array([0.0, 1.0, 0.0, 0.0])
"""Looks straight down, with up +y."""


def eye(height_m: float = 10.0, size: tuple[float, float] = (390.0, 844.0)) -> Eye:
    return Eye(np.array([0.0, 0.0, height_m]), DOWN, 0.7, size)


def test_names_that_lie_over_an_earlier_one_are_left_out() -> None:
    names = [
        PlaceName("kitchen", 0.0, 0.0),
        PlaceName("sink", 0.2, 0.0),
        PlaceName("sofa", 0.0, 1.0),
    ]
    assert clear_of_others(names, eye()) == [True, False, True]


def test_who_comes_near_sees_all_of_them() -> None:
    names = [PlaceName("kitchen", 0.0, 0.0), PlaceName("sink", 0.2, 0.0)]
    assert clear_of_others(names, eye(height_m=2.0)) == [True, True]


def test_what_is_behind_the_camera_or_beside_the_picture_is_left_out() -> None:
    upwards = Eye(np.array([0.0, 0.0, 10.0]), np.array([1.0, 0.0, 0.0, 0.0]), 0.7, (390.0, 844.0))
    assert clear_of_others([PlaceName("here", 0.0, 0.0)], upwards) == [False]
    assert clear_of_others([PlaceName("far", 50.0, 0.0), PlaceName("here", 0.0, 0.0)], eye()) == [
        False,
        True,
    ]


def test_one_that_is_left_out_hides_nothing() -> None:
    row = [PlaceName("aaaaaa", 0.3 * i, 0.0) for i in range(3)]
    assert clear_of_others(row, eye(height_m=8.0)) == [True, False, True]


@given(st.lists(st.tuples(st.floats(-5, 5), st.floats(-5, 5)), max_size=60))
def test_no_two_that_are_shown_lie_over_one_another(spots: list[tuple[float, float]]) -> None:
    names = [PlaceName("wardrobe", x, y) for x, y in spots]
    shown = [
        one for one, is_clear in zip(names, clear_of_others(names, eye()), strict=True) if is_clear
    ]
    pixels_per_m = 0.5 * 844.0 / np.tan(0.35) / 9.8
    for i, one in enumerate(shown):
        for other in shown[:i]:
            is_beside = abs(one.x - other.x) * pixels_per_m > 60.0
            assert is_beside or abs(one.y - other.y) * pixels_per_m > HEIGHT_PX - 1e-6


def shown_by(names: PlaceLabels) -> dict[str, bool]:
    return {label.text: label.visible for label in names._labels}


def test_where_it_is_going_is_named_first(server: viser.ViserServer) -> None:
    names = PlaceLabels(server.scene)
    both = [PlaceName("kitchen", 0.0, 0.0), PlaceName("sink", 0.2, 0.0)]
    names.show(both, "", eye())
    assert shown_by(names) == {"kitchen": True, "sink": False}
    names.show(both, "sink", eye())
    assert shown_by(names) == {"kitchen": False, "sink": True}
    before = names._labels
    names.show(both, "sink", eye(height_m=2.0))
    assert names._labels is before
    assert all(one.visible for one in before)
    names.show([], "", eye())
    assert names._labels == []


def test_a_very_long_name_does_not_lie_across_the_map(server: viser.ViserServer) -> None:
    names = PlaceLabels(server.scene)
    names.show([PlaceName("W" * 64, 0.0, 0.0)], "W" * 64, eye())
    assert shown_by(names) == {"W" * (MAX_LETTERS - 1) + "…": True}


@pytest.mark.parametrize("size", [(1.0, 1.0), (100_000.0, 1.0)])
def test_odd_pictures_do_no_harm(size: tuple[float, float]) -> None:
    assert len(clear_of_others([PlaceName("here", 0.0, 0.0)], eye(size=size))) == 1
