"""The search over poses against trying all, and what a way must keep to."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.all_poses import FOOTPRINTS, AllPoses, random_corridors, random_home
from support.fine_grids import fine_grid

from trolley.geometry import Pose2D
from trolley.gridmap import FREE, GridMap
from trolley_planner.costmap.footprint import Footprint
from trolley_planner.paths.hybrid_astar.motion_primitives import (
    BACKWARDS,
    FORWARDS,
    TURNING,
    Maneuver,
)
from trolley_planner.paths.hybrid_astar.pose_search import PoseSearch, Task

MARGIN_M = 0.03
MAKERS = {"corridors": random_corridors, "home": random_home}
XY_M, YAW_RAD = 0.03, 0.05


def search(
    grid: GridMap, corners: list[tuple[float, float]], start: Pose2D, goal: Pose2D
) -> Maneuver | None:
    footprint = Footprint.from_polygon(corners)
    fine = fine_grid(grid, footprint)
    nothing = np.zeros(fine.mask.shape, dtype=np.uint8)
    task = Task(start, goal, any_heading=False, xy_m=XY_M, yaw_rad=YAW_RAD, wanted_m=MARGIN_M)
    return PoseSearch(footprint, fine.fine_m).find(fine, nothing, nothing, task)


def deepest(grid: GridMap, corners: list[tuple[float, float]], poses: np.ndarray) -> float:
    """How deep the centre of an occupied cell lies in a rectangle at most [m]."""
    rows, cols = np.nonzero(grid.cells != FREE)
    centres = (np.stack([cols, rows], axis=1) + 0.5) * grid.resolution
    low, high = np.min(corners, axis=0), np.max(corners, axis=0)
    worst = -math.inf
    for x, y, yaw in poses:
        near = centres[np.hypot(*(centres - (x, y)).T) < 0.9]
        if len(near):
            local = Pose2D(float(x), float(y), float(yaw)).inverse().transform_points(near)
            worst = max(worst, float(np.minimum(local - low, high - local).min(axis=1).max()))
    return worst


def check(
    way: Maneuver, grid: GridMap, corners: list[tuple[float, float]], start: Pose2D, goal: Pose2D
) -> None:
    """A way begins and ends where it should, moves as it says, and keeps out of walls."""
    poses = way.poses
    assert tuple(poses[0, :2]) == pytest.approx((start.x, start.y))
    assert math.dist(poses[-1, :2], (goal.x, goal.y)) <= XY_M + 1e-6
    assert abs(math.remainder(poses[-1, 2] - goal.yaw, 2.0 * math.pi)) <= YAW_RAD + 1e-6
    steps = np.diff(poses, axis=0)
    lengths = np.hypot(steps[:, 0], steps[:, 1])
    assert lengths.max(initial=0.0) <= 0.04
    # The first step begins between two headings.
    assert np.abs(steps[1:, 2]).max(initial=0.0) <= 0.1
    middle = poses[:-1, 2] + 0.5 * steps[:, 2]
    along = steps[:, 0] * np.cos(middle) + steps[:, 1] * np.sin(middle)
    for motion, length, ahead in zip(way.motions[1:], lengths, along, strict=True):
        if motion == TURNING:
            assert length <= 1e-6
        else:
            assert motion in (FORWARDS, BACKWARDS)
            assert ahead * motion >= 0.99 * length
    assert deepest(grid, corners, poses[1:]) <= 0.0


@pytest.mark.slow
@pytest.mark.parametrize("kind", sorted(MAKERS))
@pytest.mark.parametrize("corners", FOOTPRINTS)
@settings(max_examples=4, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_a_way_is_found_wherever_trying_all_finds_one(kind: str, corners, seed: int) -> None:
    rng = np.random.default_rng(seed)
    grid = MAKERS[kind](rng)
    everything = AllPoses(grid, corners, MARGIN_M)
    free = np.argwhere(everything.free)
    if not len(free):
        return
    start = tuple(free[rng.integers(len(free))])
    reached = np.argwhere(everything.reached(start))
    for _ in range(4):
        goal = everything.pose(tuple(reached[rng.integers(len(reached))]))
        way = search(grid, corners, everything.pose(start), goal)
        assert way is not None
        check(way, grid, corners, everything.pose(start), goal)
