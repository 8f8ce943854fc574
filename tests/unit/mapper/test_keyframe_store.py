"""Keyframes and the parts that edges hold together."""

import numpy as np
import pytest

from trolley.geometry import Pose2D
from trolley.slices import whole
from trolley_mapper.slam.anchors import Anchors
from trolley_mapper.slam.keyframe import Keyframe
from trolley_mapper.slam.keyframe_store import KeyframeStore
from trolley_mapper.slam.loop_closure import relax
from trolley_mapper.slam.pose_graph import (
    LOOP,
    ODOMETRY,
    SCAN_MATCH,
    Edge,
    between,
    make_problem,
    squared_errors,
)
from trolley_mapper.slam.serialization import State, pack, unpack


def keyframe(number: int) -> Keyframe:
    points = np.array([[1.0, 0.0]], np.float32)
    return Keyframe(number, number, points, points, np.zeros(2, np.float32))


def edge(first: int, second: int, kind: int = ODOMETRY) -> Edge:
    return Edge(first, second, np.array([float(second - first), 0.0, 0.0]), np.eye(3), kind)


@pytest.fixture
def store() -> KeyframeStore:
    """Keyframes 0 to 2, and 3 to 5 of which nobody knows how they lie to them."""
    store = KeyframeStore()
    for number in range(6):
        edges = [] if number in (0, 3) else [edge(number - 1, number)]
        store.add(keyframe(number), np.array([float(number), 0.0, 0.0]), edges)
    return store


def test_a_part_that_no_edge_leads_to_hangs_loose(store: KeyframeStore) -> None:
    assert store.part_of(4) == [3, 4, 5]
    assert store.loose.tolist() == [False] * 3 + [True] * 3
    assert store.anchored_rows == [0, 3]


def test_a_closure_joins_it_and_a_cut_lets_it_hang_loose_again(store: KeyframeStore) -> None:
    join = edge(1, 4, LOOP)
    copy = store.copy()
    store.link(join)
    assert store.part_of(0) == [0, 1, 2, 3, 4, 5]
    assert not store.loose.any()
    assert copy.is_loose(5)
    store.cut([join])
    assert store.part_of(4) == [3, 4, 5]
    assert [one for one in store.edges if one.kind == LOOP] == []


def test_what_was_held_by_a_keyframe_that_is_removed_hangs_loose(store: KeyframeStore) -> None:
    store.link(edge(2, 3))
    store.remove([3])
    assert store.part_of(5) == [4, 5]
    assert store.is_loose(4)


def test_what_a_dissolved_keyframe_held_stays_together(store: KeyframeStore) -> None:
    store.link(edge(2, 3))
    store.dissolve(3)
    assert store.part_of(5) == [0, 1, 2, 4, 5]


@pytest.mark.parametrize(("dev_m", "is_near"), [(0.05, True), (1.0, False)])
def test_a_match_that_does_not_show_the_place_along_a_corridor_is_no_short_cut(
    store: KeyframeStore, dev_m: float, is_near: bool
) -> None:
    information = np.diag([1.0 / dev_m**2, 1e4, 1e4])
    store.link(Edge(2, 4, np.array([0.5, 0.0, 0.0]), information, SCAN_MATCH))
    assert (4 in store.distances_from(2, 8.0)) == is_near
    assert not store.loose.any()


def corridor() -> KeyframeStore:
    """Ten steps of a metre, as wheels of which nothing is known measure them."""
    store = KeyframeStore()
    for number in range(11):
        step = np.array([1.0, 0.0, 0.0])
        one = Edge(number - 1, number, step, np.eye(3), ODOMETRY, 1.0, step)
        pose = np.array([float(number), 0.0, 0.0])
        store.add(keyframe(number), pose, [one] if number else [])
    return store


def test_a_corridor_is_mapped_as_long_as_it_is_once_the_wheels_are_known() -> None:
    store = corridor()
    store.scale = 1.05
    whole(relax(store))
    assert store.pose(10) == pytest.approx([10.5, 0.0, 0.0])
    other = store.copy()
    other.dissolve(5)
    other.scale = 1.0
    whole(relax(other))
    # What was dissolved stays as it was known then.
    assert other.pose(10) == pytest.approx([10.1, 0.0, 0.0])


def test_a_corridor_is_as_long_after_a_restart() -> None:
    store = corridor()
    store.scale = 1.05
    whole(relax(store))
    state = State(store, Anchors(), None, Pose2D.identity(), 11, 0)
    restored = unpack(pack(state)).store
    whole(relax(restored))
    assert restored.pose(10) == pytest.approx([10.5, 0.0, 0.0])


def wander(keyframes: int, most: int) -> list[int]:
    """Drive about in a room, and dissolve a keyframe where there are too many.

    Returns:
        The number of edges after each keyframe.
    """
    rng = np.random.default_rng(3)
    store, counts = KeyframeStore(), list[int]()
    for number in range(keyframes):
        pose = np.array([*rng.uniform(0.0, 4.0, 2), 0.0])
        away = np.hypot(*(store.poses[:, :2] - pose[:2]).T)
        to = {store.keyframes[row].number for row in np.argsort(away)[:3].tolist()}
        to |= {store.newest.number} if number else set()
        edges = [
            Edge(one, number, between(store.pose(one), pose), 1e3 * np.eye(3), SCAN_MATCH)
            for one in sorted(to)
        ]
        store.add(keyframe(number), pose, edges)
        if len(store) > most:
            numbers = [one.number for one in store.keyframes]
            store.dissolve(store.most_crowded(numbers[most // 4 : -most // 4], numbers))
        counts.append(len(store.edges))
    assert not store.loose.any()
    assert np.all(squared_errors(store.poses, make_problem(store.edges, store.rows)) < 1e-6)
    return counts


def test_hours_in_one_room_leave_the_graph_as_large_as_it_was() -> None:
    counts = wander(600, 60)
    assert max(counts[300:]) < 1.1 * max(counts[:150])


def test_what_only_a_dissolved_keyframe_tied_is_tied_however_many_edges_it_has() -> None:
    """Two crowds, each well tied in itself, and one keyframe between them."""
    store = KeyframeStore()
    for number in range(17):
        to = [3, 12] if number == 16 else range(0 if number < 8 else 8, number)
        edges = [edge(one, number) for one in to]
        store.add(keyframe(number), np.array([float(number), 0.0, 0.0]), edges)
    store.dissolve(16)
    assert store.part_of(0) == list(range(16))
