import numpy as np
import pytest

from trolley.geometry import (
    check_polygon,
    distance_to_outline,
    distance_to_segments,
    polygon_contains,
    segments_meet,
)

SQUARE = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]])
U_SHAPE = np.array(
    [[0.0, 0.0], [3.0, 0.0], [3.0, 3.0], [2.0, 3.0], [2.0, 1.0], [1.0, 1.0], [1.0, 3.0], [0.0, 3.0]]
)


def test_clockwise_corners_are_turned_round() -> None:
    np.testing.assert_array_equal(check_polygon(SQUARE[::-1]), SQUARE)


def test_repeated_corners_are_dropped() -> None:
    closed = np.vstack([SQUARE, SQUARE[:1]])
    assert len(check_polygon(closed)) == 4
    assert len(check_polygon(np.repeat(SQUARE, 2, axis=0))) == 4


def test_corners_on_a_straight_edge_are_allowed() -> None:
    assert len(check_polygon([[0, 0], [1, 0], [2, 0], [2, 2], [0, 2]])) == 5


def test_input_is_left_alone() -> None:
    corners = SQUARE[::-1].copy()
    check_polygon(corners)
    np.testing.assert_array_equal(corners, SQUARE[::-1])


@pytest.mark.parametrize(
    ("points", "sentence"),
    [
        ([], "list of corners"),
        ([[0, 0], [1, 0]], "at least 3"),
        ([[0, 0], [1, 0], [1, 0], [0, 0]], "at least 3"),
        ([[0, 0], [1, 1], [1, 0], [0, 1]], "crosses or touches"),
        ([[0, 0], [1, 0], [2, 0]], "crosses or touches|no area"),
        ([[0, 0], [2, 0], [1, 0], [1, 1]], "crosses or touches"),
        ([[0, 0], [4, 0], [4, 2], [2, 0], [0, 2]], "crosses or touches"),
        ([[0, 0], [1, 0], [float("nan"), 1]], "finite"),
        ([[0, 0, 0], [1, 0, 0], [1, 1, 0]], "list of corners"),
        ([[0, 0], [1], [1, 1]], "list of corners"),
        ("text", "list of corners"),
        ([[i, i * i] for i in range(501)], "may have 500"),
        ([[0, 0], [1e-5, 0], [0, 1e-5]], "no area"),
    ],
)
def test_what_is_no_polygon_is_refused(points: list[list[float]], sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        check_polygon(points)


def test_inside_of_a_hollow_shape() -> None:
    points = np.array([[0.5, 2.0], [1.5, 2.0], [2.5, 2.0], [1.5, 0.5], [-1.0, 0.5], [np.nan, 0.5]])
    inside = polygon_contains(U_SHAPE, points)
    assert inside.tolist() == [True, False, True, True, False, False]


@pytest.mark.parametrize(
    ("b", "meets"),
    [
        ([[1.0, -1.0], [1.0, 1.0]], True),
        ([[1.0, 0.0], [1.0, 1.0]], True),
        ([[2.0, 0.0], [3.0, 0.0]], True),
        ([[2.1, 0.0], [3.0, 0.0]], False),
        ([[0.0, 0.1], [2.0, 0.1]], False),
        ([[3.0, -1.0], [3.0, 1.0]], False),
        ([[0.5, 0.0], [1.5, 0.0]], True),
    ],
)
def test_segments_that_touch_meet(b: list[list[float]], meets: bool) -> None:
    start, end = np.array([0.0, 0.0]), np.array([2.0, 0.0])
    first, second = np.array(b)
    assert bool(segments_meet(start, end, first, second)) is meets
    assert bool(segments_meet(first, second, end, start)) is meets


def test_distance_to_the_outline_counts_inside_and_outside() -> None:
    points = np.array([[1.0, 1.0], [1.0, 0.25], [3.0, 1.0], [3.0, 3.0]])
    expected = [1.0, 0.25, 1.0, np.sqrt(2.0)]
    np.testing.assert_allclose(distance_to_outline(SQUARE, points), expected)


def test_distance_to_a_segment_without_length_is_that_to_its_point() -> None:
    point = np.array([[3.0, 4.0]])
    origin = np.zeros((1, 2))
    assert distance_to_segments(point, origin, origin).tolist() == [5.0]
