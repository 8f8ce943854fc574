"""A robot that stands right beside a wall pulls out so gently that no corner swings into it."""

import math

import numpy as np
import pytest
from bench.planner.situations import HOBBY, REAR, SQUARE, Body, Scene, room
from bench.planner.visit import Setting, drive
from support.fine_grids import fine_grid
from support.flatland import empty_room, two_rooms, with_block

from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley_planner.costmap.footprint import Footprint
from trolley_planner.paths.hybrid_astar.motion_primitives import BACKWARDS, FORWARDS, Maneuver
from trolley_planner.paths.hybrid_astar.pull_out import free_side, pull_out
from trolley_planner.paths.hybrid_astar.search_space import IN_SIGHT, NEVER_SEEN

WALL_M = 0.1
"""Thickness of the walls of the empty room."""
GAP_M = 0.004
"""Between robot and wall; by the cells of the map alone it looks like a centimetre more."""
ROBOTS = {"hobby": HOBBY, "axle at the rear": REAR, "square": SQUARE}


def pulled(grid: GridMap, body: Body, start: Pose2D, known: int = IN_SIGHT) -> Maneuver | None:
    footprint = Footprint.from_polygon(list(body.corners))
    fine = fine_grid(grid, footprint)
    unseen = np.full(fine.mask.shape, known, np.uint8)
    return pull_out(start, fine, unseen, footprint.body)


def beside_wall(body: Body, gap_m: float, yaw: float = 0.0) -> Pose2D:
    """In the middle of the lower wall, along it."""
    return Pose2D(4.0, WALL_M + gap_m + max(y for _, y in body.corners), yaw)


@pytest.mark.parametrize("yaw", [0.0, math.pi])
@pytest.mark.parametrize("name", ROBOTS)
def test_no_corner_comes_more_than_some_millimetres_nearer(name: str, yaw: float) -> None:
    body = ROBOTS[name]
    found = pulled(empty_room(), body, beside_wall(body, GAP_M, yaw))
    assert found is not None
    lowest = [
        Pose2D(x, y, turned).transform_points(body.array)[:, 1].min() - WALL_M
        for x, y, turned in found.poses.tolist()
    ]
    assert min(lowest) > GAP_M - 0.004
    assert lowest[-1] > 0.03
    assert len(set(found.motions.tolist())) == 1
    assert found.kept == len(found.poses)


def test_it_backs_out_where_something_stands_ahead() -> None:
    ahead = with_block(empty_room(), 4.4, 0.1, 0.3, 0.6)
    start = beside_wall(HOBBY, GAP_M)
    found = pulled(ahead, HOBBY, start)
    assert found is not None
    assert set(found.motions.tolist()) == {BACKWARDS}
    assert pulled(ahead, HOBBY, start, NEVER_SEEN) is None
    free = pulled(empty_room(), HOBBY, start)
    assert free is not None
    assert set(free.motions.tolist()) == {FORWARDS}


def test_it_does_so_right_beside_one_thing_only() -> None:
    footprint = Footprint.from_polygon(list(HOBBY.corners))
    fine = fine_grid(empty_room(), footprint)
    layers = fine.distance_m, np.zeros(fine.mask.shape, np.uint8), fine.fine_m

    def side(start: Pose2D) -> int:
        return free_side(start, layers, footprint.body)

    assert side(beside_wall(HOBBY, GAP_M)) == 1
    assert side(beside_wall(HOBBY, GAP_M, math.pi)) == -1
    assert side(beside_wall(HOBBY, 0.04)) == 0
    assert side(Pose2D(WALL_M + 0.175 + GAP_M, 3.0, math.pi)) == 0  # before a wall
    door = Pose2D(4.0, 2.965, 0.0)
    assert pulled(two_rooms(0.35), HOBBY, door) is None


@pytest.mark.drives
@pytest.mark.parametrize("has_field", [True, pytest.param(False, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "body", [REAR, *(pytest.param(one, marks=pytest.mark.slow) for one in (HOBBY, SQUARE))]
)
def test_a_robot_parked_along_a_wall_drives_away(body: Body, has_field: bool) -> None:
    half_m = max(y for _, y in body.corners)
    start, goal = Pose2D(2.0, 0.015 + half_m, 0.0), Pose2D(2.0, 2.5, 1.0)
    scene = Scene("parked", room((0.0, 0.0), (4.0, 4.0)), start, (goal,), body)
    visit = drive(scene, 1, Setting("360", has_field))
    assert visit.is_success
    assert visit.seconds < 30.0
