"""Whether a finished map that is wrong is told from one that is right, by its scans alone."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from bench.harness.houses import free_poses, plan_house
from bench.harness.second_visits import moved
from numpy.typing import NDArray

from trolley.config.mapper import MapperConfig
from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley.scan_matching.sweep import read_sweep
from trolley.slices import whole
from trolley_mapper.slam import sentences
from trolley_mapper.slam.finishing import FinishJob
from trolley_mapper.slam.keyframe import Keyframe
from trolley_mapper.slam.keyframe_store import KeyframeStore
from trolley_mapper.slam.map_check import compare_passes, contradictions, explained_shares
from trolley_mapper.slam.mapper import Mapper
from trolley_mapper.slam.pose_graph import ODOMETRY, Edge, between, compose

from .conftest import Drive

LAP = np.array([[5.0, 1.0], [7.0, 1.0], [7.0, 4.0], [5.0, 4.0], [5.0, 1.0]])
STEP_M = 0.5


def laps(count: int) -> NDArray[np.float64]:
    """Poses (n, 3) round the right half of the flat; a lap is 10 m long."""
    poses: list[tuple[float, float, float]] = []
    for one, other in [*pairwise(LAP)] * count:
        step = other - one
        along = np.arange(0.0, float(np.hypot(*step)), STEP_M)[:, None]
        points = one + along * step / np.hypot(*step)
        poses += [(x, y, math.atan2(step[1], step[0])) for x, y in points.tolist()]
    return np.array(poses)


def drive(grid: GridMap, true: NDArray[np.float64]) -> KeyframeStore:
    """Keyframes taken at poses (n, 3), which lie there on the map, too."""
    robot, store = Drive(grid, Mapper(MapperConfig())), KeyframeStore()
    for number, pose in enumerate(true):
        robot.pose = Pose2D.from_array(pose)
        sweep = read_sweep(robot.make_scan(), MapperConfig().max_range_m)
        edges = [Edge(number - 1, number, between(true[number - 1], pose), np.eye(3), ODOMETRY)]
        store.add(Keyframe.of(number, number, sweep), pose, edges if number else [])
    return store


def lay_second_lap(store: KeyframeStore, off: tuple[float, float, float]) -> None:
    """Lay the second half of a drive where it does not belong."""
    half = len(store) // 2
    store.poses[half:] = compose(np.array(off), store.poses[half:])


def test_a_map_on_which_everything_lies_where_it_is_is_not_doubted(flat: GridMap) -> None:
    store = drive(flat, laps(3))
    assert whole(contradictions(store)) == []


def rounds(house: GridMap, seed: int) -> NDArray[np.float64]:
    """Poses (n, 3) all over a house, each the nearest to the one before."""
    left = free_poses(house, 0.3, 30, np.random.default_rng(seed))
    poses = [left.pop()]
    while left:
        poses.append(left.pop(int(np.argmin([poses[-1].distance_to(one) for one in left]))))
    return np.array([one.as_array() for one in poses])


@pytest.mark.parametrize("seed", [1, 3])
def test_furniture_that_was_moved_between_two_visits_is_no_reason_to_doubt_the_map(
    seed: int,
) -> None:
    plan = plan_house(6.0, seed)
    before = plan.built()
    start = free_poses(before, 0.35, 1, np.random.default_rng(seed))[0]
    after = moved(plan, start, np.random.default_rng(seed)).built()
    assert np.count_nonzero(before.cells != after.cells) > 100
    both = replace(before, cells=np.maximum(before.cells, after.cells))
    true = np.vstack([rounds(both, seed), rounds(both, seed + 1)])
    store, half = drive(before, true), len(true) // 2
    for number, one in enumerate(drive(after, true).keyframes[half:], half):
        store.keyframes[number] = one
    assert min(share for share, _ in explained_shares(whole(compare_passes(store)))) > 0.7
    assert whole(contradictions(store)) == []


@pytest.mark.parametrize("off", [(0.5, 0.0, 0.0), (0.0, 0.4, 0.0), (0.0, 0.0, 0.15)])
def test_walls_drawn_twice_are_told(flat: GridMap, off: tuple[float, float, float]) -> None:
    store = drive(flat, laps(3))
    lay_second_lap(store, off)
    places = whole(contradictions(store))
    assert places
    away = [np.hypot(*(store.poses[:, :2] - place).T).min() for place in places]
    assert max(away) < 0.01  # where it drove


def test_a_place_that_was_seen_once_is_not_doubted(flat: GridMap) -> None:
    store = drive(flat, laps(1))
    lay_second_lap(store, (0.5, 0.0, 0.0))
    assert whole(contradictions(store)) == []


def test_somebody_beside_the_robot_is_no_reason_to_doubt_the_map(flat: GridMap) -> None:
    store = drive(flat, laps(3))
    beside = np.column_stack([np.full(200, 0.6), np.linspace(-0.5, 0.5, 200)]).astype(np.float32)
    for number in (30, 45):
        one = store.keyframes[number]
        store.keyframes[number] = Keyframe(
            one.number, one.stamp_ns, beside, np.zeros_like(beside), one.laser
        )
    assert whole(contradictions(store)) == []


def test_what_hangs_loose_is_on_no_map_and_contradicts_none(flat: GridMap) -> None:
    store = drive(flat, laps(3))
    half = len(store) // 2
    lay_second_lap(store, (0.5, 0.0, 0.0))
    store.cut([one for one in store.edges if one.second == half])
    assert whole(contradictions(store)) == []


def test_a_map_that_is_ready_to_be_saved_says_where_on_it_it_may_be_wrong(flat: GridMap) -> None:
    store = drive(flat, laps(3))
    grid = GridMap("flat", flat.resolution, Pose2D.identity(), flat.cells)
    right = FinishJob(store.copy(), MapperConfig(), None, grid).run()
    lay_second_lap(store, (0.5, 0.0, 0.0))
    wrong = FinishJob(store.copy(), MapperConfig(), None, grid).run()
    assert right.doubtful == []
    assert wrong.doubtful


def test_it_is_said_in_one_sentence() -> None:
    assert sentences.doubtful([]) == ""
    assert sentences.doubtful([(1.04, -2.0)]).startswith("At (1.0, -2.0) scans")
    assert "and in 1 other place scans" in sentences.doubtful([(1.0, 2.0)] * 2)
    assert "and in 2 other places scans" in sentences.doubtful([(1.0, 2.0)] * 3)
