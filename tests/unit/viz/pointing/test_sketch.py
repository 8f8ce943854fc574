"""Zones as they are drawn: corners, walls that draw them, dashes, names."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trolley.geometry import Pose2D
from trolley.messages import OccupancyGrid, Zone
from trolley.zones import check_zone
from trolley_viz.features.zones.editor import as_zone
from trolley_viz.features.zones.suspected_mirrors import dashes, is_same
from trolley_viz.pointing.sketch import SNAP_M, Sketch, free_name, snap_to_wall, zone_at

SQUARE = Sketch("keepout", ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)))
COORDINATE = st.floats(-20.0, 20.0).map(lambda value: round(value, 3))
POINT = st.tuples(COORDINATE, COORDINATE)


def room(origin: Pose2D, walls: np.ndarray | None = None) -> OccupancyGrid:
    """6 m x 4 m with a wall along its lower edge."""
    cells = np.zeros((40, 60), np.int8)
    cells[0] = 100
    if walls is not None:
        cells[walls[:, 0], walls[:, 1]] = 100
    return OccupancyGrid(
        stamp_ns=0,
        name="room",
        frame="map",
        resolution=0.1,
        width=60,
        height=40,
        origin=origin,
        cells=memoryview(cells.tobytes()),
    )


@given(st.lists(POINT, min_size=1, max_size=8), st.sampled_from(["mirror", "keepout", "speed"]))
def test_what_is_fine_here_is_fine_for_the_localizer(
    points: list[tuple[float, float]], kind: str
) -> None:
    sketch = Sketch(kind, tuple(points))  # type: ignore[arg-type]
    if sketch.problem():
        return
    zone = as_zone(sketch, "one", 0.2)
    assert check_zone(zone, "one") == zone


@given(st.lists(POINT, min_size=4, max_size=7))
def test_a_crossing_outline_is_never_fine(points: list[tuple[float, float]]) -> None:
    sketch = Sketch("keepout", tuple(points))
    assert not (sketch.crosses() and not sketch.problem())


def test_a_bow_tie_crosses_and_a_square_does_not() -> None:
    bow = Sketch("speed", ((0.0, 0.0), (1.0, 1.0), (1.0, 0.0), (0.0, 1.0)))
    assert bow.crosses()
    assert bow.problem() == "The outline crosses itself."
    assert not SQUARE.crosses()
    assert SQUARE.problem() == ""


def test_too_little_is_said_in_words() -> None:
    assert Sketch("mirror", ((0.0, 0.0),)).problem() == "A line needs at least two corners."
    assert Sketch("mirror", ((0.0, 0.0), (0.0, 0.0))).problem() == "This line is too short."
    assert Sketch("speed", SQUARE.points[:2]).problem() == "An area needs at least three corners."
    flat = Sketch("speed", ((0.0, 0.0), (1.0, 0.0), (2.0, 0.0)))
    assert flat.problem()


@given(st.lists(POINT, min_size=1, max_size=6), st.data())
def test_moving_forth_and_back_changes_nothing(
    points: list[tuple[float, float]], data: st.DataObject
) -> None:
    sketch = Sketch("glass", tuple(points))
    index = data.draw(st.integers(0, len(points) - 1))
    to = data.draw(POINT)
    moved = sketch.moved_corner(index, to)
    assert moved.points[index] == to
    assert moved.moved_corner(index, points[index]) == sketch
    assert sketch.add(to).take_back() == sketch
    np.testing.assert_allclose(
        sketch.moved(*to).moved(-to[0], -to[1]).points, sketch.points, atol=1e-9
    )


def test_a_drawing_ends_at_its_last_corner_and_an_area_at_its_first() -> None:
    assert SQUARE.closes_at((0.05, 0.0), 0.1)
    assert SQUARE.closes_at((0.0, 1.05), 0.1)
    assert not SQUARE.closes_at((1.0, 1.0), 0.1)
    line = Sketch("mirror", SQUARE.points)
    assert not line.closes_at((0.05, 0.0), 0.1)
    assert not Sketch("mirror").closes_at((0.0, 0.0), 0.1)


@given(
    st.floats(-math.pi, math.pi),
    st.floats(0.5, 5.5),
    st.floats(-0.4, 0.6),
)
def test_a_wall_draws_a_corner_to_its_face(yaw: float, along: float, off: float) -> None:
    grid = room(Pose2D(3.0, -2.0, yaw))
    x, y = grid.origin.transform_points(np.array([[along, 0.1 + off]]))[0].tolist()
    snapped = snap_to_wall(grid, (x, y))
    moved = math.dist(snapped, (x, y))
    local = grid.origin.inverse().transform_points(np.array([snapped]))[0]
    if abs(off) < SNAP_M - 1e-6:
        # The wall's other side is the edge of the map, which is no face.
        assert moved == pytest.approx(abs(off), abs=1e-6)
        assert local == pytest.approx([along, 0.1], abs=1e-6)
    elif abs(off) > SNAP_M + 1e-6:
        assert snapped == (x, y)


def test_far_from_the_map_nothing_draws_a_corner() -> None:
    grid = room(Pose2D(0.0, 0.0, 0.0))
    for point in ((900.0, -900.0), (1e300, 0.0), (math.nan, 0.0)):
        assert snap_to_wall(grid, point) is point


def test_the_nearest_line_is_meant_before_the_smallest_area() -> None:
    zones = [
        as_zone(SQUARE.moved(-2.0, -2.0), "small", None),
        Zone(name="all", kind="speed", points=[(-9, -9), (9, -9), (9, 9), (-9, 9)], speed=0.1),
        Zone(name="mirror", kind="mirror", points=[(-1.5, -1.2), (5.0, -1.2)]),
    ]

    def found(x: float, y: float) -> str | None:
        zone = zone_at(zones, (x, y), 0.1)
        return None if zone is None else zone.name

    assert found(-1.3, -1.25) == "mirror"
    assert found(-1.5, -1.7) == "small"
    assert found(5.0, 5.0) == "all"
    assert found(20.0, 0.0) is None


def test_a_new_zone_gets_the_first_free_number() -> None:
    assert free_name("mirror", set()) == "mirror 1"
    assert free_name("keepout", {"no-go area 1", "no-go area 3"}) == "no-go area 2"


@given(st.floats(0.05, 8.0))
def test_dashes_begin_and_end_with_the_line(length: float) -> None:
    line = np.array([[0.0, 0.0], [length, 0.0], [length, length]])
    found = dashes(line, 0.12, 0.08, 0.2)
    assert found[0, 0].tolist() == pytest.approx([0.0, 0.0, 0.2])
    assert found[-1, 1].tolist() == pytest.approx([length, length, 0.2], rel=1e-5)
    drawn = float(np.abs(found[:, 1] - found[:, 0]).sum())
    assert drawn <= 2.0 * length + 1e-3


def test_a_suspect_is_the_same_from_either_end() -> None:
    line = [(0.0, 0.0), (0.5, 0.1), (1.0, 0.0)]
    assert is_same(line, [(1.1, 0.1), (0.1, 0.0)])
    assert not is_same(line, [(0.0, 0.0), (0.0, 1.0)])
