"""A lidar that hangs, told by a robot that knows how it moves and by one that does not."""

from dataclasses import replace

import numpy as np
import pytest

from trolley.geometry import Pose2D
from trolley_base.drivers import LidarScan
from trolley_base.safety.frozen_lidar import FrozenLidar


def scan_of(seed: int, beams: int = 100) -> LidarScan:
    ranges = np.random.default_rng(seed).uniform(1.0, 3.0, beams).astype(np.float32)
    return LidarScan(seed, 0.0, 0.06, 0.001, 0.1, 12.0, ranges)


@pytest.mark.parametrize("knows_motion", [True, False])
def test_scans_that_differ_are_alive(knows_motion: bool) -> None:
    frozen = FrozenLidar(knows_motion=knows_motion)
    assert not any(frozen.update(scan_of(k), Pose2D(0.1 * k, 0.0, 0.0)) for k in range(12))


def test_a_robot_that_knows_its_motion_may_stand_before_the_same_scan() -> None:
    frozen = FrozenLidar()
    assert not any(frozen.update(scan_of(1), Pose2D.identity()) for _ in range(12))
    assert frozen.update(scan_of(1), Pose2D(0.2, 0.0, 0.0))


def test_where_only_the_lidar_tells_motion_repetition_is_enough() -> None:
    frozen = FrozenLidar(knows_motion=False)
    told = [frozen.update(scan_of(1), Pose2D.identity()) for _ in range(8)]
    assert told == [False] * 4 + [True] * 4
    assert not frozen.update(scan_of(2), Pose2D.identity())


def test_scans_repeated_here_and_there_are_no_hang() -> None:
    frozen = FrozenLidar(knows_motion=False)
    assert not any(frozen.update(scan_of(k // 2), Pose2D.identity()) for k in range(24))


@pytest.mark.parametrize("knows_motion", [True, False])
def test_open_floor_all_around_looks_the_same_from_everywhere(knows_motion: bool) -> None:
    nothing = replace(scan_of(1), ranges=np.full(100, np.inf, np.float32))
    frozen = FrozenLidar(knows_motion=knows_motion)
    assert not any(frozen.update(nothing, Pose2D(0.1 * k, 0.0, 0.0)) for k in range(12))


def test_a_revolution_of_another_length_is_another_scan() -> None:
    frozen = FrozenLidar(knows_motion=False)
    lengths = [100 - k % 2 for k in range(12)]
    told = [frozen.update(scan_of(k, n), Pose2D.identity()) for k, n in enumerate(lengths)]
    assert not any(told)
