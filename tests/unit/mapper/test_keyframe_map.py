"""What the map keeps of the scans of hours on the same floor."""

import math
import tracemalloc
from collections.abc import Set

import numpy as np

from trolley.config.mapper import MapperConfig
from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley_mapper.slam.keyframe import Keyframe
from trolley_mapper.slam.keyframe_map import PARAMS, KeyframeMap
from trolley_mapper.slam.occupancy_grid import LogOddsGrid
from trolley_mapper.slam.pose_graph import ODOMETRY, SCAN_MATCH, Edge, between

SIDE_M = 1.5
INFORMATION = np.diag([2500.0, 2500.0, 2500.0])


def add_at(made: KeyframeMap, pose: np.ndarray, spared: Set[int] = frozenset()) -> None:
    """Add a keyframe with exact edges to the newest and to the three nearest ones."""
    number, store = made.next_number, made.store
    edges: list[Edge] = []
    if len(store):
        away = np.hypot(*(store.poses[:, :2] - pose[:2]).T)
        nearest = {store.keyframes[row].number for row in np.argsort(away)[:3].tolist()}
        for first in sorted(nearest | {store.newest.number}):
            kind = ODOMETRY if first == store.newest.number else SCAN_MATCH
            edges.append(Edge(first, number, between(store.pose(first), pose), INFORMATION, kind))
    points = np.array([[1.0, 0.0], [0.0, 1.0]], np.float32)
    made.add(Keyframe(number, number, points, points, np.zeros(2, np.float32)), pose, edges, spared)


def test_hours_of_driving_about_in_one_room_keep_a_bounded_number_of_scans() -> None:
    made, rng = KeyframeMap(MapperConfig()), np.random.default_rng(1)
    kept: list[int] = []
    for _ in range(3):
        for _ in range(80):
            place = rng.uniform(0.0, SIDE_M, 2)
            add_at(made, np.array([*place, rng.uniform(-math.pi, math.pi)]))
        kept.append(len(made.store))
    store = made.store
    # Three places at most lie farther apart than the area that is counted.
    assert kept[-1] <= 3 * PARAMS.per_area
    assert kept[-1] <= 1.2 * kept[1]
    # The oldest and the newest stay, and hang together.
    numbers = [one.number for one in store.keyframes]
    assert numbers[0] == 0
    assert numbers[-5:] == [235, 236, 237, 238, 239]
    assert not store.loose.any()
    # What the edges say is as true as it was.
    for edge in store.edges:
        miss = between(edge.step, between(store.pose(edge.first), store.pose(edge.second)))
        assert np.abs(miss).max() < 1e-6


def test_what_is_kept_of_a_room_lies_all_over_it() -> None:
    made, rng = KeyframeMap(MapperConfig()), np.random.default_rng(2)
    for _ in range(160):
        # Nine of ten scans are taken in one corner.
        side_m = SIDE_M if rng.random() < 0.1 else 0.5
        add_at(made, np.array([*rng.uniform(0.0, side_m, 2), rng.uniform(-math.pi, math.pi)]))
    elsewhere = (made.store.poses[:, :2] > 1.0).any(axis=1)
    assert elsewhere.mean() > 0.2


def test_a_drive_to_and_fro_keeps_every_scan() -> None:
    made = KeyframeMap(MapperConfig())
    for x in np.arange(0.0, 9.0, 0.3):
        add_at(made, np.array([x, 0.0, 0.0]))
    for x in np.arange(8.7, 0.0, -0.3):
        add_at(made, np.array([x, 0.0, math.pi]))
    assert len(made.store) == made.next_number


def test_the_scan_that_a_part_begins_with_stays_until_it_is_known_how_the_part_lies() -> None:
    made, rng = KeyframeMap(MapperConfig()), np.random.default_rng(3)
    begin = 20
    for _ in range(120):
        # All in one place, in which the middle one goes each time.
        pose = np.array([*rng.uniform(0.0, 0.1, 2), rng.uniform(0.0, 0.1)])
        add_at(made, pose, {begin})
    assert begin in made.store.rows
    assert len(made.store) < begin


def test_to_draw_a_large_earlier_map_takes_little_more_memory_than_to_keep_it() -> None:
    cells = np.random.default_rng(3).choice(np.array([-1, 0, 100], np.int8), (1500, 1000))
    prior = GridMap("flat", 0.05, Pose2D(-3.0, 7.0, 0.0), cells)
    tracemalloc.start()
    drawn = LogOddsGrid(0.05, prior)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 5 * drawn.num_bytes
    again = drawn.grid()
    known = prior.cells >= 0
    rows, cols = np.flatnonzero(known.any(axis=1)), np.flatnonzero(known.any(axis=0))
    assert (rows[0], cols[0]) == (0, 0)
    assert again.origin == prior.origin
    assert np.array_equal(again.cells, prior.cells[: rows[-1] + 1, : cols[-1] + 1])
