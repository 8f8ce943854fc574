"""A robot that stands: it looks rarely, says the same, and notices at once what changes."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley_localizer.filter.standing import PARAMS, Standing, shows_the_same

from .conftest import Drive, at, make_scan

MakeDrive = Callable[..., Drive]
START = (5.5, 3.0, 0.4)
STOOD = 30
"""After so many scans it rests."""


def stand(drive: Drive, noise_m: float = 0.01) -> None:
    rng = np.random.default_rng(1)

    def shake(ranges: np.ndarray) -> None:
        ranges += noise_m * rng.standard_normal(ranges.size).astype(np.float32)

    drive.alter = shake
    drive.localizer.set_pose(drive.pose)
    for _ in range(STOOD):
        drive.scan()


def looks(grid: GridMap, poses: list[Pose2D], odometry: list[Pose2D] | None = None) -> list[bool]:
    """Which of the scans from some poses are looked at."""
    standing, found = Standing(), list[bool]()
    wheels = odometry or [Pose2D.identity()] * len(poses)
    for k, (pose, odom) in enumerate(zip(poses, wheels, strict=True)):
        scan = make_scan(grid, pose, odom, 1 + k * 100_000_000)
        found.append(standing.is_news(scan))
        if found[-1]:
            standing.look(scan)
    return found


def test_it_looks_until_all_has_settled_and_then_once_a_second(flat: GridMap) -> None:
    news = looks(flat, [at(flat, *START)] * 51)
    assert all(news[: PARAMS.settled_looks])
    rested = news[PARAMS.settled_looks + 1 :]
    assert 3 <= sum(rested) <= 5


def test_wheels_that_turn_end_the_rest(flat: GridMap) -> None:
    poses = [at(flat, *START)] * 15
    wheels = [Pose2D.identity()] * 14 + [Pose2D(0.01, 0.0, 0.0)]
    assert looks(flat, poses, wheels)[12:] == [False, False, True]


@pytest.mark.parametrize("push", [(0.2, 0.0, 0.0), (0.0, -0.15, 0.0), (0.0, 0.0, 0.12)])
def test_a_push_without_the_wheels_ends_the_rest(
    flat: GridMap, push: tuple[float, float, float]
) -> None:
    pose = at(flat, *START)
    assert looks(flat, [pose] * 14 + [pose @ Pose2D(*push)])[12:] == [False, False, True]


def test_a_lidar_that_sees_nothing_shows_nothing_the_same(flat: GridMap) -> None:
    scan = make_scan(flat, at(flat, *START), Pose2D.identity())
    object.__setattr__(scan, "ranges", np.full(scan.ranges.size, np.inf, np.float32))
    assert not shows_the_same(scan, scan)


def test_at_rest_poses_go_on_with_fresh_stamps_and_the_same_certainty(
    make_drive: MakeDrive,
) -> None:
    drive = make_drive()
    stand(drive)
    said = [drive.scan() for _ in range(40)]
    assert [one.stamp_ns for one in said] == sorted({one.stamp_ns for one in said})
    assert said[-1].stamp_ns == drive.stamp_ns
    assert {one.state for one in said} == {"localized"}
    assert max(drive.error_m(one) for one in said) < 0.02
    sizes = [math.sqrt(one.covariance[0, 0]) for one in said if one.covariance is not None]
    assert len(sizes) == len(said)
    assert max(sizes) < 1.3 * min(sizes)


def test_pushed_at_rest_the_next_pose_is_where_it_was_pushed(make_drive: MakeDrive) -> None:
    drive = make_drive()
    stand(drive)
    drive.pose = drive.pose @ Pose2D(0.15, 0.1, 0.1)
    found = [drive.scan() for _ in range(5)]
    assert drive.error_m(found[0]) < 0.1
    assert drive.error_m(found[-1]) < 0.03


def test_carried_off_at_rest_it_is_found_within_three_seconds(make_drive: MakeDrive) -> None:
    drive = make_drive()
    stand(drive)
    drive.pose = at(drive.grid, 1.6, 4.8, 2.5)
    found = [drive.scan() for _ in range(30)]
    assert sum(one.state == "localized" and drive.error_m(one) > 0.5 for one in found) < 10
    assert found[-1].state == "localized"
    assert drive.error_m(found[-1]) < 0.06


def test_from_rest_it_drives_on_as_if_it_had_looked(make_drive: MakeDrive) -> None:
    drive = make_drive()
    stand(drive)
    for _ in range(20):
        estimate = drive.scan(0.3, 0.4)
        assert estimate.state == "localized"
        assert drive.error_m(estimate) < 0.03
