"""Edits of maps: what they touch, what they leave, and what they refuse."""

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy import ndimage
from support.cases import cases

from trolley import codes
from trolley.codes import Refused
from trolley.geometry import Pose2D
from trolley.geometry.polygon import distance_to_outline, polygon_contains
from trolley.gridmap import MAX_CELLS, OCCUPIED, UNKNOWN, GridMap
from trolley.map_editing import angle_to_straighten, apply, merge
from trolley.messages.editing import Crop, DrawWall, EraseArea, EraseStroke, Merge, Turn

shapes = st.tuples(st.integers(3, 24), st.integers(3, 24))
origins = st.builds(
    Pose2D, st.floats(-20.0, 20.0), st.floats(-20.0, 20.0), st.floats(-math.pi, math.pi)
)
angles = st.floats(-math.pi, math.pi)
RESOLUTION = 0.05


@st.composite
def grids(draw: st.DrawFn) -> GridMap:
    cells = draw(
        hnp.arrays(np.int8, draw(shapes), elements=st.sampled_from([0, 0, 0, 100, -1, 40]))
    )
    cells[0, 0] = 0  # something is known
    cells.setflags(write=False)
    return GridMap("flat", RESOLUTION, draw(origins), cells)


def centres(grid: GridMap) -> np.ndarray:
    return grid.cell_to_world(np.argwhere(np.ones(grid.cells.shape)))


def at(grid: GridMap, share_x: float, share_y: float) -> tuple[float, float]:
    """A point of the map by its shares of width and height."""
    width, height = grid.size_m
    x, y = grid.origin.transform_points(np.array([[share_x * width, share_y * height]]))[0].tolist()
    return x, y


places = st.tuples(st.floats(0.05, 0.95), st.floats(0.05, 0.95))


@settings(max_examples=cases(40))
@given(grids(), st.tuples(places, places, places), st.sampled_from(["free", "unknown"]))
def test_erasing_an_area_changes_all_inside_and_nothing_else(
    grid: GridMap, corners: tuple[tuple[float, float], ...], to: str
) -> None:
    points = [at(grid, *corner) for corner in corners]
    inside = polygon_contains(np.array(points), centres(grid)).reshape(grid.cells.shape)
    clear = distance_to_outline(np.array(points), centres(grid)).reshape(grid.cells.shape) > 1e-9
    try:
        erased, _ = apply(grid, EraseArea(points=points, to=to))  # type: ignore[arg-type]
    except Refused:
        assert not (inside & clear).any()
        return
    inside, outside = inside & clear, ~inside & clear
    assert (erased.cells[inside] == (0 if to == "free" else UNKNOWN)).all()
    np.testing.assert_array_equal(erased.cells[outside], grid.cells[outside])


@settings(max_examples=cases(40))
@given(grids(), st.lists(places, min_size=1, max_size=5), st.floats(0.01, 0.5))
def test_a_brush_touches_what_is_near_its_way(
    grid: GridMap, way: list[tuple[float, float]], width: float
) -> None:
    points = [at(grid, *place) for place in way]
    erased, _ = apply(grid, EraseStroke(points=points, width=width))
    a = np.array(points)
    b = np.roll(a, -1, axis=0)[:-1] if len(a) > 1 else a
    a = a[:-1] if len(a) > 1 else a
    fine = np.concatenate([a + (b - a) * t for t in np.linspace(0.0, 1.0, 101)])
    gaps = np.linalg.norm(centres(grid)[:, None] - fine, axis=2).min(axis=1)
    gaps = gaps.reshape(grid.cells.shape)
    half = 0.5 * max(width, math.sqrt(2.0) * RESOLUTION)
    assert (erased.cells[gaps < half - 1e-6] == 0).all()
    far = gaps > half + 0.02
    np.testing.assert_array_equal(erased.cells[far], grid.cells[far])


@settings(max_examples=cases(40))
@given(origins, places, places)
def test_no_way_leads_through_a_wall_that_was_drawn(
    origin: Pose2D, a: tuple[float, float], b: tuple[float, float]
) -> None:
    empty = GridMap("flat", RESOLUTION, origin, np.zeros((30, 40), np.int8))
    ends = (-0.2, a[1]), (1.2, b[1])  # from beyond one side to beyond the other
    walled, _ = apply(empty, DrawWall(points=[at(empty, *end) for end in ends], width=0.01))
    _, pieces = ndimage.label(walled.cells == 0, structure=np.ones((3, 3)))
    assert pieces == 2
    assert (walled.cells == OCCUPIED).sum() < 3 * 70


@settings(max_examples=cases(40))
@given(grids(), places, places)
def test_cropping_keeps_the_cells_inside_where_they_are(
    grid: GridMap, a: tuple[float, float], b: tuple[float, float]
) -> None:
    corners = at(grid, *a), at(grid, *b)
    points = centres(grid)
    low, high = np.min(corners, axis=0), np.max(corners, axis=0)
    inside = ((points >= low) & (points <= high)).all(axis=1)
    try:
        cropped, old_T_new = apply(grid, Crop(corners=corners))
    except Refused:
        assert (grid.values_at(points[inside]) == UNKNOWN).all()
        return
    assert old_T_new == Pose2D.identity()
    np.testing.assert_array_equal(cropped.values_at(points[inside]), grid.values_at(points[inside]))
    assert (cropped.values_at(points[~inside]) == UNKNOWN).all()
    assert cropped.cells.size <= grid.cells.size


@settings(max_examples=cases(40))
@given(grids(), angles, st.floats(-5.0, 5.0))
def test_turning_there_and_back_keeps_walls_within_a_cell(
    grid: GridMap, angle: float, x: float
) -> None:
    there, old_T_new = apply(grid, Turn(angle=angle, about=(x, 1.0)))
    back, new_T_back = apply(there, Turn(angle=-angle, about=(x, 1.0)))
    assert there.origin.yaw == back.origin.yaw == 0.0
    whole = old_T_new @ new_T_back
    assert abs(whole.x) + abs(whole.y) + abs(whole.yaw) < 1e-9
    walls = grid.cell_to_world(np.argwhere(grid.cells >= 65))
    for turned, old_T_turned in ((there, old_T_new), (back, Pose2D.identity())):
        found = old_T_turned.transform_points(turned.cell_to_world(np.argwhere(turned.cells >= 65)))
        if not len(walls):
            assert not len(found)
            continue
        gaps = np.linalg.norm(walls[:, None] - found, axis=2)
        reach = RESOLUTION * (1.0 if turned is there else 1.9)
        assert gaps.min(axis=1).max() < reach  # no wall is lost
        assert gaps.min(axis=0).max() < reach  # and none is made up


@settings(max_examples=cases(40))
@given(origins, angles)
def test_thin_walls_stay_closed_when_they_are_turned(origin: Pose2D, angle: float) -> None:
    cells = np.zeros((30, 30), np.int8)
    cells[15, 5:15] = 100
    for i in range(10):
        cells[15 + i, 15 + i] = 100  # one that holds together by its corners only
    turned, _ = apply(GridMap("flat", RESOLUTION, origin, cells), Turn(angle=angle))
    _, pieces = ndimage.label(turned.cells >= 65, structure=np.ones((3, 3)))
    assert pieces == 1
    assert 20 <= (turned.cells >= 65).sum() <= 60


@settings(max_examples=cases(40))
@given(grids(), st.integers(-3, 3))
def test_quarter_turns_lose_nothing(grid: GridMap, quarters: int) -> None:
    straight = GridMap("flat", RESOLUTION, Pose2D(1.0, 2.0, 0.0), grid.cells)
    turned, _ = apply(straight, Turn(angle=quarters * math.pi / 2))
    wanted = np.rot90(grid.cells, -quarters)  # row 0 is at the bottom
    known = np.argwhere(wanted != UNKNOWN)
    (row0, col0), (row1, col1) = known.min(axis=0), known.max(axis=0) + 1
    np.testing.assert_array_equal(turned.cells, wanted[row0:row1, col0:col1])


@settings(max_examples=cases(40))
@given(grids(), grids(), origins, st.sampled_from([0.5, 1.0, 2.0]))
def test_a_merged_map_keeps_what_was_known_and_gains_the_rest(
    grid: GridMap, other: GridMap, pose: Pose2D, scale: float
) -> None:
    other = GridMap("other", RESOLUTION * scale, other.origin, other.cells)
    merged = merge(grid, other, pose)
    points = centres(grid)
    before = grid.values_at(points)
    known = before != UNKNOWN
    np.testing.assert_array_equal(merged.values_at(points)[known], before[known])
    walls = pose.transform_points(other.cell_to_world(np.argwhere(other.cells >= 65)))
    if len(walls):
        free = walls[grid.values_at(walls) == UNKNOWN]
        found = merged.cell_to_world(np.argwhere(merged.cells >= 65))
        reach = 0.75 * RESOLUTION * (1.0 + scale)
        if len(free):
            gaps = np.linalg.norm(free[:, None] - found, axis=2).min(axis=1)
            known_near = grid.cell_to_world(np.argwhere(grid.cells != UNKNOWN))
            near = np.linalg.norm(free[:, None] - known_near, axis=2).min(axis=1)
            assert (gaps[near > 2.0 * reach] < reach).all()


@settings(max_examples=cases(40))
@given(angles, origins)
@example(0.7796553332365121, Pose2D.identity())
@example(math.radians(1.0), Pose2D.identity())  # steps of a cell here and there, as it lies
def test_the_walls_of_a_crooked_map_are_made_straight(angle: float, origin: Pose2D) -> None:
    cells = np.zeros((80, 120), np.int8)
    cells[[5, 40, 74], 5:110] = 100
    cells[5:75, [5, 60, 109]] = 100
    flat = GridMap("flat", RESOLUTION, origin, cells)
    crooked, _ = apply(flat, Turn(angle=angle))
    by = angle_to_straighten(crooked)
    assert abs(by) <= math.pi / 4 + 1e-9
    left = math.remainder(origin.yaw + angle + by, math.pi / 2)
    # Nothing in the cells tells a turn of less than a cell over the longest wall.
    assert abs(left) < math.atan2(1, 105)


LARGE = GridMap("flat", 0.05, Pose2D.identity(), np.zeros((3, MAX_CELLS // 3), np.int8))
SMALL = GridMap("flat", 0.05, Pose2D.identity(), np.zeros((20, 20), np.int8))


@pytest.mark.parametrize(
    ("op", "code"),
    [
        (EraseArea(points=[(0.0, 0.0), (1.0, 0.0), (float("nan"), 1.0)]), codes.BAD_REQUEST),
        (EraseArea(points=[(0.0, 0.0), (1.0, 0.0)]), codes.BAD_REQUEST),
        (EraseArea(points=[(0.0, 0.0), (1.0, 1.0), (1.0, 0.0), (0.0, 1.0)]), codes.BAD_REQUEST),
        (EraseArea(points=[(5.0, 5.0), (6.0, 5.0), (5.0, 6.0)]), codes.OUTSIDE_MAP),
        (EraseStroke(points=[], width=0.1), codes.TOO_LARGE),
        (EraseStroke(points=[(0.0, 0.0)] * 1_000_000, width=0.1), codes.TOO_LARGE),
        (EraseStroke(points=[(50.0, 0.0)], width=0.1), codes.OUTSIDE_MAP),
        (DrawWall(points=[(0.0, 0.0), (1e300, 0.0)]), codes.OUTSIDE_MAP),
        (DrawWall(points=[(-4e3, 0.0), (4e3, 0.0)] * 20), codes.TOO_LARGE),
        (DrawWall(points=[(0.0, float("inf"))]), codes.BAD_REQUEST),
        (Turn(angle=float("nan")), codes.BAD_REQUEST),
        (Turn(angle=1e300), codes.BAD_REQUEST),
        (Turn(angle=90.0), codes.BAD_REQUEST),
        (Crop(corners=((5.0, 5.0), (6.0, 6.0))), codes.OUTSIDE_MAP),
        (Crop(corners=((0.0, 0.0), (float("nan"), 1.0))), codes.BAD_REQUEST),
        (Merge(name="other"), codes.BAD_REQUEST),
    ],
)
def test_what_makes_no_sense_is_refused(op: object, code: str) -> None:
    with pytest.raises(Refused) as refused:
        apply(SMALL, op)  # type: ignore[arg-type]
    assert refused.value.code == code


def test_an_angle_in_degrees_is_told_to_be_in_radians() -> None:
    with pytest.raises(Refused, match="angles are in radians"):
        apply(SMALL, Turn(angle=90.0))
    with pytest.raises(Refused, match="angles are in radians"):
        merge(SMALL, SMALL, Pose2D(0.0, 0.0, 90.0))


def test_a_map_that_would_grow_too_large_is_refused_before_it_is_made() -> None:
    with pytest.raises(Refused) as refused:
        apply(LARGE, Turn(angle=0.3))
    assert refused.value.code == codes.TOO_LARGE
    with pytest.raises(Refused) as refused:
        merge(SMALL, SMALL, Pose2D(1e5, 1e5, 0.0))
    assert refused.value.code == codes.TOO_LARGE


def test_erasing_everything_leaves_a_map_that_cannot_be_cropped() -> None:
    nothing, _ = apply(SMALL, EraseStroke(points=[(0.5, 0.5)], width=5.0, to="unknown"))
    for op in (Crop(corners=((0.0, 0.0), (1.0, 1.0))), Turn(angle=1.0)):
        with pytest.raises(Refused, match="Nothing of the map"):
            apply(nothing, op)
