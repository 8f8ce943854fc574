"""Polygons against slow, obvious twins."""

import math

import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st

from trolley.geometry import (
    Pose2D,
    check_polygon,
    circumscribed_radius,
    distance_to_outline,
    footprint_from_box,
    footprint_from_polygon,
    footprint_from_radius,
    inscribed_radius,
    polygon_contains,
)
from trolley.geometry.polygon import signed_area

poses = st.builds(
    Pose2D, st.floats(-20.0, 20.0), st.floats(-20.0, 20.0), st.floats(-math.pi, math.pi)
)
coordinates = st.floats(-4.0, 4.0)
points = st.tuples(coordinates, coordinates)


@st.composite
def stars(draw: st.DrawFn) -> np.ndarray:
    """A star-shaped polygon about the origin, counter-clockwise, (n, 2) [m]."""
    radii = draw(st.lists(st.floats(0.3, 2.0), min_size=3, max_size=12))
    angles = 2 * math.pi * np.arange(len(radii)) / len(radii)
    return np.array(radii)[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def winding_number(polygon: np.ndarray, point: tuple[float, float]) -> int:
    """How often the outline runs round a point: the sum of the angles that its edges span."""
    offsets = polygon - np.array(point)
    headings = np.arctan2(offsets[:, 1], offsets[:, 0])
    turns = np.roll(headings, -1) - headings
    turns = (turns + math.pi) % (2 * math.pi) - math.pi
    return round(float(turns.sum()) / (2 * math.pi))


def edges_cross(polygon: np.ndarray) -> bool:
    """Whether two edges that are no neighbours cross properly, by solving for the crossing."""
    count = len(polygon)
    for i in range(count):
        for j in range(i + 2, count):
            if i == 0 and j == count - 1:
                continue
            a, b = polygon[i], polygon[(i + 1) % count]
            c, d = polygon[j], polygon[(j + 1) % count]
            matrix = np.stack([b - a, c - d], axis=1)
            if abs(np.linalg.det(matrix)) > 1e-9:
                along = np.linalg.solve(matrix, c - a)
                if ((along > 1e-6) & (along < 1.0 - 1e-6)).all():
                    return True
    return False


@given(stars(), points)
def test_inside_is_where_the_outline_runs_round(
    polygon: np.ndarray, point: tuple[float, float]
) -> None:
    assume(distance_to_outline(polygon, np.array([point]))[0] > 1e-6)
    inside = bool(polygon_contains(polygon, np.array([point]))[0])
    assert inside == (winding_number(polygon, point) != 0)


@given(stars(), poses)
def test_star_passes_wherever_it_lies(polygon: np.ndarray, pose: Pose2D) -> None:
    moved = pose.transform_points(polygon)
    np.testing.assert_allclose(check_polygon(moved), moved)
    np.testing.assert_allclose(check_polygon(moved[::-1]), moved)
    assert math.isclose(signed_area(moved), signed_area(polygon), rel_tol=1e-6)


@given(st.lists(points, min_size=4, max_size=8, unique=True))
def test_polygons_that_pass_do_not_cross_themselves(corners: list[tuple[float, float]]) -> None:
    try:
        polygon = check_polygon(corners)
    except ValueError:
        return
    assert not edges_cross(polygon)
    assert signed_area(polygon) > 0.0


@given(st.lists(points, min_size=4, max_size=8, unique=True))
def test_polygons_that_cross_themselves_do_not_pass(corners: list[tuple[float, float]]) -> None:
    assume(edges_cross(np.array(corners)))
    try:
        check_polygon(corners)
    except ValueError:
        return
    raise AssertionError("it passed")


@given(stars(), st.lists(points, min_size=1, max_size=20))
def test_footprint_lies_between_its_circles(
    polygon: np.ndarray, samples: list[tuple[float, float]]
) -> None:
    footprint = footprint_from_polygon(polygon)
    inner, outer = inscribed_radius(footprint), circumscribed_radius(footprint)
    assert 0.0 < inner <= outer
    radii = np.hypot(*np.array(samples).T)
    inside = polygon_contains(footprint, np.array(samples))
    assert inside[radii < inner - 1e-9].all()
    assert not inside[radii > outer + 1e-9].any()


@given(st.floats(0.02, 5.0), st.floats(0.02, 5.0))
def test_every_plausible_size_is_a_footprint(length: float, width: float) -> None:
    for footprint in (footprint_from_box(length, width), footprint_from_radius(width / 2)):
        np.testing.assert_allclose(check_polygon(footprint), footprint)
        assert inscribed_radius(footprint) > 0.0
