"""Ways with headings through small places."""

import math

import numpy as np
import pytest
from support.all_poses import box
from support.fine_grids import fine_grid
from support.flatland import Flatland, empty_room, two_rooms, with_block

from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley_planner.costmap.footprint import NO_LIMITS, Field, Footprint
from trolley_planner.paths.footprint_check import least_clearance
from trolley_planner.paths.hybrid_astar import pose_search
from trolley_planner.paths.hybrid_astar.heuristic import Heuristic, Query
from trolley_planner.paths.hybrid_astar.motion_primitives import BACKWARDS, FORWARDS, Maneuver
from trolley_planner.paths.hybrid_astar.open_list import USABLE, Memory
from trolley_planner.paths.hybrid_astar.pose_search import POSE_SEARCH, PoseSearch, Task
from trolley_planner.paths.hybrid_astar.search import search_poses
from trolley_planner.paths.hybrid_astar.search_space import (
    IN_SIGHT,
    NEVER_SEEN,
    OUT_OF_SIGHT,
    SearchSpace,
)

HOBBY = box(0.35, 0.30, 0.175)
REAR = box(0.60, 0.42, 0.10)
LONG = box(0.80, 0.45, 0.15)


def search(
    grid: GridMap,
    corners: list[tuple[float, float]],
    ends: tuple[Pose2D, Pose2D],
    known: int = IN_SIGHT,
    most: int = USABLE,
    counts: list[int] | None = None,
    else_any: bool = False,
) -> Maneuver | None:
    """The way; how many states it took is put into `counts`."""
    footprint = Footprint.from_polygon(corners)
    fine = fine_grid(grid, footprint)
    shape = fine.mask.shape
    task = Task(*ends, False, xy_m=0.03, yaw_rad=0.05, wanted_m=0.05, else_any=else_any)
    nowhere, behind = np.zeros(shape, np.uint8), np.full(shape, known, dtype=np.uint8)
    made = PoseSearch(footprint, fine.fine_m)
    found = made.find(fine, behind, nowhere, task, most)
    if counts is not None:
        counts.append(made.num_states)
    return found


def lane(width_m: float) -> GridMap:
    """A room, and a dead end to its right along y = 3."""
    return lane_from(3.0 - width_m / 2.0, width_m)


def lane_from(low_m: float, width_m: float) -> GridMap:
    """The same above y = `low_m`."""
    high_m = low_m + width_m
    below = with_block(empty_room(), 4.0, 0.1, 3.9, low_m - 0.1)
    return with_block(below, 4.0, high_m, 3.9, 5.9 - high_m)


def test_a_door_is_passed_in_its_middle_without_a_stop() -> None:
    way = search(two_rooms(0.4), HOBBY, (Pose2D(2.5, 2.4, 0.6), Pose2D(5.5, 3.4, 0.0)))
    assert way is not None
    assert set(way.motions[way.poses[:, 0] < 4.5].tolist()) == {FORWARDS}
    in_door = way.poses[np.abs(way.poses[:, 0] - 4.0) < 0.05]
    assert np.abs(in_door[:, 1] - 3.0).max() < 0.03


def test_a_door_narrower_than_the_robot_is_proved_to_be() -> None:
    assert search(two_rooms(0.25), HOBBY, (Pose2D(3.0, 3.0, 0.0), Pose2D(5.0, 3.0, 0.0))) is None


def test_another_heading_is_tried_only_where_the_place_may_be_reached() -> None:
    ends = Pose2D(3.0, 3.0, 0.0), Pose2D(5.0, 3.0, 0.0)
    counts: list[int] = []
    for else_any in (False, True):
        assert search(two_rooms(0.25), HOBBY, ends, counts=counts, else_any=else_any) is None
    assert counts[0] == counts[1] > 0


@pytest.mark.parametrize("turn", [0.5 * math.pi, 0.8])
def test_another_heading_will_do_where_that_of_the_goal_cannot_be_had(turn: float) -> None:
    ends = Pose2D(2.5, 3.0, 0.0), Pose2D(4.0, 3.0, turn)  # In a door, across it or askew.
    assert search(two_rooms(0.34), HOBBY, ends) is None
    way = search(two_rooms(0.34), HOBBY, ends, else_any=True)
    assert way is not None
    assert math.dist(way.poses[-1, :2], (4.0, 3.0)) < 0.03


def test_a_dead_end_that_the_robot_cannot_back_into_is_entered_forwards() -> None:
    ends = Pose2D(2.5, 3.0, 0.0), Pose2D(5.0, 3.0, math.pi)
    assert search(lane(0.4), HOBBY, ends, known=NEVER_SEEN) is None
    way = search(lane(0.4), HOBBY, ends, known=NEVER_SEEN, else_any=True)
    assert way is not None
    assert abs(way.poses[-1, 2]) < 0.3


@pytest.mark.parametrize("y", [2.8, 2.92])
def test_where_the_robot_does_not_fit_at_its_goal_nothing_is_searched(y: float) -> None:
    ends = Pose2D(2.5, 2.4, 0.6), Pose2D(4.0, y, 0.5 * math.pi)
    counts: list[int] = []
    assert search(two_rooms(0.3), HOBBY, ends, counts=counts) is None
    assert counts == [0]


def test_a_lane_with_room_for_one_row_of_cells_is_driven_to_a_goal_on_their_edges() -> None:
    exact = [(0.175, 0.1875), (-0.175, 0.1875), (-0.175, -0.175), (0.175, -0.175)]
    ends = Pose2D(3.0, 4.61875, 0.0), Pose2D(5.0, 4.625, 0.0)
    assert search(lane_from(4.45, 0.35), exact, ends) is not None


def test_a_robot_that_stands_at_its_goal_too_near_to_a_wall_need_not_move() -> None:
    here = Pose2D(3.0, 0.3352, math.radians(14.3))  # 7 mm
    way = search(empty_room(), REAR, (here, here))
    assert way is not None
    assert len(way.poses) == 1


@pytest.mark.parametrize(("y", "yaw_deg"), [(3.07, -18.0), (3.08, -18.5)])
def test_a_robot_that_stands_askew_in_a_door_gets_out(y: float, yaw_deg: float) -> None:
    askew = Pose2D(3.7, y, math.radians(yaw_deg))
    assert search(two_rooms(0.45), REAR, (askew, Pose2D(2.5, 2.4, -2.23))) is not None


def test_nothing_is_searched_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    """The robot's own heading and the goal's may be the same one."""
    searches: list[object] = []

    def search_once(
        memory: Memory, space: SearchSpace, query: Query, to_go: Heuristic, most: int
    ) -> tuple[int, int]:
        searches.append((query, space.footprint.phase, int(space.blocking), to_go.greed))
        return search_poses(memory, space, query, to_go, most)

    monkeypatch.setattr(pose_search, "search_poses", search_once)
    ends = Pose2D(3.68, 3.08, 1.09), Pose2D(5.3, 2.9, 1.09 - math.pi)
    assert search(two_rooms(0.42), REAR, ends, most=POSE_SEARCH.driving_states) is None
    assert len(searches) == len(set(searches))


@pytest.mark.parametrize(
    "start", [Pose2D(3.35, 3.1, 0.0), Pose2D(3.2, 3.0, 1.0), Pose2D(3.45, 2.9, -2.5)]
)
def test_a_robot_right_before_a_tight_door_soon_knows_how_to_get_in(start: Pose2D) -> None:
    ends = start, Pose2D(4.9, 3.0, 0.0)
    assert search(two_rooms(0.45), REAR, ends, most=POSE_SEARCH.driving_states) is not None


def test_between_its_poses_a_long_robot_comes_no_nearer_to_a_post_than_at_them() -> None:
    """From heading to heading a corner that is 0.7 m away moves by 7 cm."""
    rng, grid = np.random.default_rng(7), two_rooms(0.5)
    footprint = Footprint.from_polygon(LONG)
    fine, num_found = fine_grid(grid, footprint), 0
    field = Field(fine.distance_m, fine.distance_m, NO_LIMITS, 0.0, 0.0, fine.fine_m, 1.0, 1.0)
    for _ in range(14):
        x, y, yaw = rng.uniform((2.4, 2.2, -1.0), (3.3, 3.8, 1.0)).tolist()
        way = search(grid, LONG, (Pose2D(x, y, yaw), Pose2D(5.2, 3.0, 0.0)))
        if way is None:
            continue
        num_found += 1
        index = np.arange(len(way.poses))
        between = np.linspace(0.0, index[-1], 8 * len(index))
        poses = np.column_stack([np.interp(between, index, column) for column in way.poses.T])
        least_m = least_clearance(field, footprint.body, way.poses, 0.1)
        assert least_clearance(field, footprint.body, poses, 0.1) > least_m - fine.fine_m
    assert num_found > 6


def test_a_dead_end_too_narrow_to_turn_in_is_left_backwards() -> None:
    ends = Pose2D(6.5, 3.0, 0.0), Pose2D(2.5, 3.0, math.pi)
    way = search(lane(0.4), HOBBY, ends)
    assert way is not None
    assert set(way.motions[way.poses[:, 0] > 4.2].tolist()) == {BACKWARDS}


def test_nobody_backs_into_what_was_not_seen() -> None:
    ends = Pose2D(6.5, 3.0, 0.0), Pose2D(2.5, 3.0, math.pi)
    assert search(lane(0.4), HOBBY, ends, NEVER_SEEN) is None


def test_behind_a_lidar_that_looks_ahead_it_turns_rather_than_creep_backwards_far() -> None:
    ends = Pose2D(6.0, 3.0, 0.0), Pose2D(2.8, 3.0, 0.0)
    seen, unseen = (search(lane(0.6), HOBBY, ends, known) for known in (IN_SIGHT, OUT_OF_SIGHT))
    assert seen is not None
    assert unseen is not None
    assert set(seen.motions.tolist()) == {BACKWARDS}
    assert np.count_nonzero(unseen.motions == BACKWARDS) < 5


def test_a_goal_outside_what_is_searched_is_not_reached() -> None:
    assert search(empty_room(), HOBBY, (Pose2D(1.0, 1.0, 0.0), Pose2D(9.0, 1.0, 0.0))) is None


@pytest.mark.drives
@pytest.mark.parametrize("door_m", [0.35, 0.45])
def test_a_door_little_wider_than_the_robot_is_driven_at_the_first_try(ride, door_m) -> None:
    drive = ride(Flatland(two_rooms(door_m), Pose2D(2.5, 2.2, 0.8), footprint=HOBBY))
    drive.send(Pose2D(5.5, 3.6, 0.0))
    status = drive.until_over(40.0)
    assert status.state == "arrived"
    assert status.recoveries == 0
    assert drive.world.touches == 0


@pytest.mark.drives
def test_a_goal_two_centimetres_beside_a_wall_is_reached_along_it(ride) -> None:
    goal = Pose2D(5.0, 0.1 + 0.15 + 0.02, 0.0)
    drive = ride(Flatland(empty_room(), Pose2D(3.5, 1.2, 0.0), footprint=HOBBY))
    drive.send(goal, xy_tolerance=0.05)
    assert drive.until_over(40.0).state == "arrived"
    assert drive.world.pose.distance_to(goal) <= 0.06
    assert drive.world.touches == 0


@pytest.mark.parametrize("turns", [-1, 0, 1])
def test_a_way_ends_at_its_goal_however_its_heading_is_counted(turns: int) -> None:
    for index in range(12):
        goal = Pose2D(5.0, 3.6, 0.5 * index + 2.0 * math.pi * turns)
        way = search(two_rooms(0.5), HOBBY, (Pose2D(2.6, 2.3, 3.0 - index), goal))
        assert way is not None
        assert math.dist(way.poses[-1, :2], (goal.x, goal.y)) <= 0.03
        assert abs(math.remainder(way.poses[-1, 2] - goal.yaw, 2.0 * math.pi)) <= 0.051
