import math

import numpy as np
import pytest

from trolley.geometry import (
    circumscribed_radius,
    footprint_from_box,
    footprint_from_polygon,
    footprint_from_radius,
    inscribed_radius,
    radius_of_gyration,
)


def test_box_lies_along_x() -> None:
    footprint = footprint_from_box(0.4, 0.3)
    assert np.ptp(footprint, axis=0) == pytest.approx([0.4, 0.3])
    assert inscribed_radius(footprint) == pytest.approx(0.15)
    assert circumscribed_radius(footprint) == pytest.approx(0.25)


def test_round_robot_lies_within_its_polygon() -> None:
    footprint = footprint_from_radius(0.2)
    assert inscribed_radius(footprint) == pytest.approx(0.2)
    assert 0.2 < circumscribed_radius(footprint) < 0.2 * 1.02


def test_radii_are_about_base_link_not_the_middle() -> None:
    # Driven wheels at the back: 0.1 m behind the axle, 0.3 m before it.
    footprint = footprint_from_polygon([[-0.1, -0.15], [0.3, -0.15], [0.3, 0.15], [-0.1, 0.15]])
    assert inscribed_radius(footprint) == pytest.approx(0.1)
    assert circumscribed_radius(footprint) == pytest.approx(math.hypot(0.3, 0.15))


def test_mass_far_from_base_link_resists_a_turn() -> None:
    middle = math.hypot(0.4, 0.3) / math.sqrt(12.0)  # of a box
    assert radius_of_gyration(footprint_from_box(0.4, 0.3)) == pytest.approx(middle)
    behind = footprint_from_polygon([[-0.1, -0.15], [0.3, -0.15], [0.3, 0.15], [-0.1, 0.15]])
    assert radius_of_gyration(behind) == pytest.approx(math.hypot(middle, 0.1))  # Steiner


def test_clockwise_outline_is_turned_round() -> None:
    square = [[-0.1, -0.1], [-0.1, 0.1], [0.1, 0.1], [0.1, -0.1]]
    np.testing.assert_array_equal(footprint_from_polygon(square), square[::-1])


@pytest.mark.parametrize("size", [0.0, -0.3, 0.01, 5.1, 400.0, math.nan, math.inf])
def test_sizes_that_are_not_plausible_are_refused(size: float) -> None:
    with pytest.raises(ValueError, match="length_m"):
        footprint_from_box(size, 0.3)
    with pytest.raises(ValueError, match="width_m"):
        footprint_from_box(0.3, size)
    with pytest.raises(ValueError, match="radius_m"):
        footprint_from_radius(size / 2)


@pytest.mark.parametrize(
    ("points", "sentence"),
    [
        ([[0.1, -0.1], [0.3, -0.1], [0.3, 0.1], [0.1, 0.1]], "does not enclose"),
        ([[0.0, -0.1], [0.3, -0.1], [0.3, 0.1], [0.0, 0.1]], "does not enclose"),
        ([[-300, -200], [300, -200], [300, 200], [-300, 200]], "not plausible"),
        ([[-0.1, -0.1], [0.1, 0.1], [0.1, -0.1], [-0.1, 0.1]], "crosses"),
        ([[-0.1, -0.1], [0.1, 0.1]], "at least 3"),
    ],
)
def test_outlines_that_cannot_be_are_refused(points: list[list[float]], sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        footprint_from_polygon(points)
