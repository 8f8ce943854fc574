"""Ways for the footprint, and not just for the circle in it."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.cases import cases
from support.flatland import BEAMS, Flatland, empty_room, two_rooms, with_block

from trolley.config import PlannerConfig
from trolley.geometry import Pose2D
from trolley.gridmap import FREE, OCCUPIED, GridMap
from trolley_planner.costmap.costmap import Costmap
from trolley_planner.costmap.footprint import Footprint
from trolley_planner.paths.global_planner import PLANNING, GlobalPlanner
from trolley_planner.paths.path import PlannedPath

LONG = [(0.3, 0.15), (-0.3, 0.15), (-0.3, -0.15), (0.3, -0.15)]
WIDE = [(0.23, 0.21), (-0.23, 0.21), (-0.23, -0.21), (0.23, -0.21)]
HOOK = [(0.5, 0.15), (-0.1, 0.15), (-0.1, -0.15), (0.5, -0.15)]
REAR = [(0.5, 0.21), (-0.1, 0.21), (-0.1, -0.21), (0.5, -0.21)]


pytestmark = pytest.mark.drives


def corner(width_m: float, second_way: bool = False) -> GridMap:
    """Two rooms, and a passage between them that turns at a right angle."""
    cells = np.full((120, 120), OCCUPIED, dtype=np.int8)
    width = round(width_m / 0.05)
    cells[10:50, 10:50] = FREE
    cells[30 : 30 + width, 50:90] = FREE
    cells[30:80, 90 - width : 90] = FREE
    cells[80:110, 60:110] = FREE
    if second_way:
        cells[50:110, 20:40] = FREE
        cells[90:110, 40:60] = FREE
    return GridMap("corner", 0.05, Pose2D.identity(), cells)


def plan(
    grid: GridMap, corners: list[tuple[float, float]], way: tuple[tuple[float, float], ...]
) -> tuple[PlannedPath | None, list[tuple[float, float]]]:
    costmap = Costmap(grid, Footprint.from_polygon(corners), PlannerConfig(), False)
    planner = GlobalPlanner(costmap)
    args = way[0], list(way[1:]), costmap.weights, costmap.distance_m
    path = planner.plan(*args)
    return path, [] if path is not None else planner.too_narrow(*args)


def worst_overlap(grid: GridMap, corners: list[tuple[float, float]], path: PlannedPath) -> float:
    """How deep the centre of an occupied cell lies in the outline at most, ends left out [m].

    The outline looks along the path, give or take a sixth of a radian.
    """
    rows, cols = np.nonzero(grid.cells != FREE)
    centres = (np.stack([cols, rows], axis=1) + 0.5) * grid.resolution
    outline = np.array(corners)
    low, high = outline.min(axis=0), outline.max(axis=0)  # A rectangle along the axes.
    worst = -math.inf
    points = path.points
    along = path.length_m - path.remaining_m
    for index in np.flatnonzero((along > 0.5) & (path.remaining_m > 0.5)):
        ahead = points[min(index + 2, len(points) - 1)] - points[index - 2]
        near = centres[np.hypot(*(centres - points[index]).T) < 0.8]
        if not near.size or math.hypot(*ahead) == 0.0:
            continue
        depths = []
        for turn in (-0.16, 0.0, 0.16):
            yaw = math.atan2(ahead[1], ahead[0]) + turn
            pose = Pose2D(float(points[index][0]), float(points[index][1]), yaw)
            local = pose.inverse().transform_points(near)
            depths.append(float(np.minimum(local - low, high - local).min(axis=1).max()))
        worst = max(worst, min(depths))
    return worst


def test_a_plan_among_legs_of_chairs_searches_no_more_poses_than_it_may() -> None:
    grid = empty_room()
    for row, col in np.ndindex(10, 5):
        grid = with_block(grid, 3.0 + 0.6 * col, 0.1 + 0.6 * row, 0.05, 0.05)
    corners = [(0.3, 0.3), (-0.3, 0.3), (-0.3, -0.3), (0.3, -0.3)]
    costmap = Costmap(grid, Footprint.from_polygon(corners), PlannerConfig(), False)
    searched = []
    for most_poses in (PLANNING.most_poses, 1):
        planner = GlobalPlanner(costmap)
        layers = costmap.weights, costmap.distance_m
        planner.plan((1.5, 3.0), [(7.0, 3.0)], *layers, most_poses=most_poses)
        searched.append(planner.pose_search.num_states)
    assert 0 < searched[1] < 0.5 * searched[0]


def test_a_long_robot_passes_a_narrow_door_lengthways() -> None:
    for way in (((1.0, 3.0), (6.0, 3.0)), ((1.0, 1.0), (6.0, 5.0)), ((3.4, 0.6), (4.6, 5.4))):
        path, _ = plan(two_rooms(0.45), LONG, way)
        assert path is not None
        assert worst_overlap(two_rooms(0.45), LONG, path) <= 0.0


def test_a_door_narrower_than_the_robot_is_named() -> None:
    path, narrow = plan(two_rooms(0.25), LONG, ((1.0, 1.0), (6.0, 5.0)))
    assert path is None
    assert len(narrow) == 1
    assert math.dist(narrow[0], (4.0, 3.0)) < 0.15


def test_a_door_that_leaves_little_is_passed_where_there_is_no_other_way() -> None:
    way = (1.0, 1.0), (6.0, 5.0)
    for width_m, is_tight in ((0.45, True), (0.5, True), (0.7, False)):
        path, _ = plan(two_rooms(width_m), WIDE, way)
        assert path is not None
        assert path.is_tight is is_tight
    path, narrow = plan(two_rooms(0.4), WIDE, way)
    assert path is None
    assert math.dist(narrow[0], (4.0, 3.0)) < 0.15


def test_who_has_another_way_does_not_squeeze() -> None:
    cells = two_rooms(0.5).cells.copy()
    cells[96:114, 79:81] = FREE
    path, _ = plan(GridMap("doors", 0.05, Pose2D.identity(), cells), WIDE, ((3.0, 3.0), (5.0, 3.0)))
    assert path is not None
    assert not path.is_tight
    assert path.points[:, 1].max() > 4.8


class Noisy(Flatland):
    """A lidar that errs by a centimetre."""

    def ranges(self):
        rng = np.random.default_rng(round(1e6 * self.pose.x) % 2**31)
        return (super().ranges() + rng.normal(0.0, 0.01, BEAMS)).astype(np.float32)


def test_it_backs_out_of_a_dead_end_as_narrow_as_itself(ride) -> None:
    # 6 cm on each side, where it cannot turn; and it must not wait or try long.
    lane = with_block(with_block(empty_room(), 4.0, 0.1, 3.9, 2.65), 4.0, 3.3, 3.9, 2.6)
    drive = ride(Noisy(lane, Pose2D(5.5, 3.025, 0.0), footprint=WIDE))
    drive.send(Pose2D(2.0, 4.0, 0.0))
    assert drive.until_over(40.0).state == "arrived"
    assert drive.world.touches == 0


def test_it_drives_through_a_door_that_leaves_four_centimetres(ride) -> None:
    drive = ride(Noisy(two_rooms(0.5), Pose2D(2.0, 2.5, 0.0), footprint=WIDE))
    drive.send(Pose2D(6.0, 3.5, 0.0))
    assert drive.until_over(60.0).state == "arrived"
    assert drive.world.touches == 0


def test_a_wall_without_a_door_names_no_place() -> None:
    walled = with_block(empty_room(), 3.95, 0.0, 0.1, 6.0)
    assert plan(walled, LONG, ((1.0, 1.0), (6.0, 5.0))) == (None, [])


@pytest.mark.parametrize("width_m", [0.5, 0.55, 0.6, 0.7, 0.9])
def test_a_corner_is_turned_where_the_robot_fits(width_m: float) -> None:
    path, _ = plan(corner(width_m), LONG, ((1.5, 1.5), (4.2, 4.8)))
    assert path is not None
    assert worst_overlap(corner(width_m), LONG, path) <= 0.03


@pytest.mark.parametrize(
    ("width_m", "corners"), [(0.4, LONG), pytest.param(0.4, HOOK, marks=pytest.mark.slow)]
)
def test_a_corner_too_tight_to_turn_in_is_named(width_m: float, corners) -> None:
    path, narrow = plan(corner(width_m), corners, ((1.5, 1.5), (4.2, 4.8)))
    assert path is None
    assert all(math.dist(place, (4.5 - width_m / 2, 1.5 + width_m / 2)) < 0.6 for place in narrow)
    assert narrow


def test_a_corner_that_takes_several_moves_is_turned() -> None:
    path, _ = plan(corner(0.5), HOOK, ((1.5, 1.5), (4.2, 4.8)))
    assert path is not None


def test_another_way_is_taken_round_a_corner_too_tight_to_turn_in() -> None:
    path, _ = plan(corner(0.4, second_way=True), LONG, ((1.5, 1.5), (4.2, 4.8)))
    assert path is not None
    assert (path.points[:, 0] < 2.2).any()
    assert worst_overlap(corner(0.4, second_way=True), LONG, path) <= 0.0


def test_nothing_is_squeezed_through_where_there_is_another_way() -> None:
    small = [(0.15, 0.12), (-0.15, 0.12), (-0.15, -0.12), (0.15, -0.12)]
    # Right before the robot a gap of 0.25 m, too narrow for it; far to the side the wall ends.
    wall = with_block(empty_room(), 3.95, 0.0, 0.1, 2.9)
    way = ((3.7, 3.0), (4.4, 3.0))
    closed = with_block(wall, 3.95, 3.15, 0.1, 2.85)
    assert plan(closed, small, way)[0] is not None  # As the robot stands there, it may try.
    path, _ = plan(with_block(wall, 3.95, 3.15, 0.1, 1.5), small, way)
    assert path is not None
    assert path.points[:, 1].max() > 4.65


def test_a_robot_too_near_to_a_wall_finds_the_way_out() -> None:
    small = [(0.15, 0.12), (-0.15, 0.12), (-0.15, -0.12), (0.15, -0.12)]
    path, _ = plan(empty_room(), small, ((0.16, 3.0), (4.0, 3.0)))
    assert path is not None
    assert path.length_m < 3.9


@settings(max_examples=cases(25), deadline=None)
@given(st.integers(0, 10_000))
def test_the_outline_fits_along_every_way(seed: int) -> None:
    rng = np.random.default_rng(seed)
    grid = empty_room()
    for _ in range(rng.integers(4, 16)):
        x, y = rng.uniform(1.2, 6.0), rng.uniform(0.2, 5.0)
        grid = with_block(grid, x, y, *rng.uniform(0.1, 1.2, 2))
    path, _ = plan(grid, LONG, ((0.6, rng.uniform(0.6, 5.4)), (7.4, rng.uniform(0.6, 5.4))))
    if path is not None:
        assert worst_overlap(grid, LONG, path) <= 0.03


def test_a_way_among_many_things_is_not_searched_for_seconds() -> None:
    grid = two_rooms(0.4)
    for x in np.arange(0.7, 7.6, 0.65):
        for y in np.arange(0.5, 5.7, 0.65):
            if abs(x - 4.0) > 0.4:
                grid = with_block(grid, x, y, 0.1, 0.1)
    costmap = Costmap(grid, Footprint.from_polygon(REAR), PlannerConfig(), False)
    planner = GlobalPlanner(costmap)
    way, yaws = ((0.4, 3.0), [(7.4, 3.2)]), (0.0, 0.0)
    assert planner.plan(*way, costmap.weights, costmap.distance_m, yaws) is None
    assert planner.narrow
    assert planner.pose_search.num_states < 2_000_000  # else 4 million, 6 s of a PC
