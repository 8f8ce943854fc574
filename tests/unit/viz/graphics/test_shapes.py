"""Geometry for drawing."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trolley_viz.graphics.shapes import (
    boxes,
    meet_floor,
    particle_segments,
    prism,
    triangulate,
    wall_rectangles,
)

L_SHAPE = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)]


def area(points: np.ndarray, faces: np.ndarray) -> float:
    a, b, c = (points[faces[:, i]] for i in range(3))
    cross = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    assert (cross > 0).all()  # counter-clockwise, so that the upper side is seen
    return float(0.5 * cross.sum())


@pytest.mark.parametrize("polygon", [L_SHAPE, L_SHAPE[::-1]])
def test_triangles_cover_the_polygon_whatever_its_sense(polygon: list[tuple[float, float]]) -> None:
    faces = triangulate(polygon)
    assert len(faces) == 4
    assert area(np.array(polygon, float), faces) == pytest.approx(3.0)


def test_degenerate_polygons_give_no_triangles_and_no_error() -> None:
    assert len(triangulate([(0, 0), (1, 0)])) == 0
    assert len(triangulate([(0, 0), (1, 0), (2, 0)])) == 0
    assert len(triangulate(np.zeros((10_000, 2)))) == 0


@given(st.integers(3, 24), st.randoms(use_true_random=False))
def test_triangles_of_a_star_have_its_area(n: int, random: object) -> None:
    angles = 2 * np.pi * np.arange(n) / n
    radii = np.array([0.5 + random.random() for _ in range(n)])  # type: ignore[attr-defined]
    points = radii[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    x, y = points.T
    expected = 0.5 * abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))
    assert area(points, triangulate(points)) == pytest.approx(expected)


def test_a_prism_is_closed_on_top_and_faces_outwards() -> None:
    vertices, faces = prism([(0, 0), (0, 1), (1, 1), (1, 0)], 0.0, 0.5)
    assert len(faces) == 8 + 2
    centre = np.array([0.5, 0.5, 0.25])
    a, b, c = (vertices[faces[:, i]].astype(float) for i in range(3))
    outward = ((a + b + c) / 3 - centre) * np.cross(b - a, c - a)
    assert (outward.sum(axis=1) > 0).all()


@given(
    st.integers(1, 12).flatmap(
        lambda cols: st.lists(
            st.lists(st.booleans(), min_size=cols, max_size=cols), min_size=1, max_size=12
        )
    )
)
def test_rectangles_cover_exactly_the_walls(cells: list[list[bool]]) -> None:
    mask = np.array(cells, np.bool_)
    rectangles = wall_rectangles(mask)
    assert rectangles is not None
    covered = np.zeros(mask.shape, int)
    for row0, row1, col0, col1 in rectangles:
        covered[row0:row1, col0:col1] += 1
    np.testing.assert_array_equal(covered, mask.astype(int))


def test_a_ragged_grid_has_no_walls_rather_than_too_many() -> None:
    ragged = np.indices((400, 400)).sum(axis=0) % 2 == 0
    assert wall_rectangles(ragged) is None


def test_boxes_stand_where_the_cells_are() -> None:
    vertices, faces = boxes(np.array([[1, 3, 2, 5]]), 0.1, 0.2)
    assert vertices.min(axis=0) == pytest.approx([0.2, 0.1, 0.0])
    assert vertices.max(axis=0) == pytest.approx([0.5, 0.3, 0.2])
    assert faces.max() == 7


def test_particles_point_where_they_look() -> None:
    segments = particle_segments(np.array([[1.0, 2.0, np.pi / 2]]), 0.1, 0.05)
    assert segments.shape == (1, 2, 3)
    np.testing.assert_allclose(segments[0], [[1.0, 2.0, 0.05], [1.0, 2.1, 0.05]], atol=1e-6)


def test_a_ray_meets_the_floor() -> None:
    assert meet_floor((0, 0, 2), (1, 0, -1)) == pytest.approx((2.0, 0.0))
    assert meet_floor((0, 0, 2), (1, 0, 1)) is None  # into the sky
    assert meet_floor((0, 0, 2), (1, 0, 0)) is None  # along the horizon
    assert meet_floor((0, 0, 2), (0, 0, 0)) is None
    assert meet_floor((0, 0, float("nan")), (0, 0, -1)) is None
