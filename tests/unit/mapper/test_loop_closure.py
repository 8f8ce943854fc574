"""Which closures are believed: those that agree, and strain the rest of the graph little."""

import numpy as np
import pytest

from trolley.config.mapper import MapperConfig
from trolley.slices import whole
from trolley_mapper.slam.keyframe import Keyframe
from trolley_mapper.slam.keyframe_store import KeyframeStore
from trolley_mapper.slam.loop_closure import PARAMS, Closure, LoopJob, relax, total_error
from trolley_mapper.slam.occupancy_grid import LogOddsGrid
from trolley_mapper.slam.pose_graph import LOOP, ODOMETRY, Edge, between
from trolley_mapper.slam.scan_matcher import MatchQuality

OUT = 20
"""Keyframes a metre apart along a corridor; as many on the way back."""
DRIVEN = np.diag([400.0, 400.0, 1e4])
"""Information of a step of the odometry: 0.05 m, 0.01 rad."""
MATCHED = np.diag([1e4, 1e4, 1e4])


def there_and_back() -> KeyframeStore:
    """A corridor driven up and down, as the odometry has it."""
    poses = [np.array([float(x), 0.0, 0.0]) for x in range(OUT)]
    poses += [np.array([float(x), 0.0, np.pi]) for x in reversed(range(OUT))]
    store = KeyframeStore()
    points = np.array([[1.0, 0.0], [0.0, 1.0]], np.float32)
    for number, pose in enumerate(poses):
        step = between(poses[number - 1], pose)
        edges = [Edge(number - 1, number, step, DRIVEN, ODOMETRY)] if number else []
        store.add(Keyframe(number, number, points, points, np.zeros(2, np.float32)), pose, edges)
    return store


def closures(store: KeyframeStore, off_m: float) -> list[Closure]:
    """Seven that agree that the way back lies so far off along the corridor."""
    quality = MatchQuality(1.0, 1.0, is_good=True)
    return [
        Closure(Edge(first, second, step, MATCHED, LOOP), quality)
        for first in range(2, 9)
        for second in [2 * OUT - 1 - first]
        for step in [between(store.pose(first), store.pose(second) + np.array([off_m, 0.0, 0.0]))]
    ]


def strain(store: KeyframeStore, some: list[Closure]) -> float:
    """By how much closures raise the squared error of all edges."""
    bent = store.copy()
    for one in some:
        bent.link(one.edge)
    whole(relax(bent, is_robust=False))
    return total_error(bent) - total_error(store)


@pytest.mark.parametrize(
    ("off_m", "is_believed"), [(2.2, True), (3.2, False)], ids=["drift", "another room"]
)
def test_closures_that_agree_are_believed_as_long_as_together_they_strain_the_odometry_little(
    off_m: float, is_believed: bool
) -> None:
    store = there_and_back()
    some = closures(store, off_m)
    together = strain(store, some)
    # Neither is refused for what each of them says alone, nor as doubtful and seen from nearby.
    assert together / len(some) < 0.3 * PARAMS.max_strain
    assert together > PARAMS.doubtful_strain * len(some)
    assert (together < PARAMS.max_strain) == is_believed
    *pending, newest = some
    blank = LogOddsGrid(0.05)
    job = LoopJob(
        store.copy(), pending, MapperConfig(), blank, newest.edge.second, [], found=[newest]
    )
    whole(job.slices())
    moved_m = job.store.pose(newest.edge.second)[0] - store.pose(newest.edge.second)[0]
    if is_believed:
        assert len(job.accepted) == len(some)
        assert moved_m == pytest.approx(off_m, abs=0.1)
    else:
        assert job.accepted == []
        assert job.occupancy is None
        assert moved_m == 0.0
