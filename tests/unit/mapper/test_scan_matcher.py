"""Where scan and odometry together have the robot."""

import math

import numpy as np
import pytest

from trolley.geometry import Pose2D
from trolley.scan_matching.layout import Cloud
from trolley.scan_matching.sweep import Sweep
from trolley.scanning import ScanInput
from trolley_mapper.slam.keyframe import Keyframe
from trolley_mapper.slam.local_map import LocalMap
from trolley_mapper.slam.scan_matcher import ScanMatcher


def beside_somebody(x: float) -> Sweep:
    """What is seen at x [m] in a bare corridor 2 m wide, of somebody half a metre ahead, too."""
    along = np.arange(-4.0, 12.0, 0.1) - x
    walls = [np.column_stack([along, np.full_like(along, y)]) for y in (-1.0, 1.0)]
    facing = [np.tile([0.0, sign], (len(along), 1)) for sign in (1.0, -1.0)]
    angles = np.linspace(0.6, 1.4, 60) * math.pi
    rays = np.column_stack([np.cos(angles), np.sin(angles)])
    points = np.vstack([*walls, np.array([0.7, -0.3]) + 0.2 * rays])
    return Sweep(Cloud(points, np.vstack([*facing, rays])), np.zeros(2), is_blind=False)


def scan(x: float) -> ScanInput:
    """The odometry that belongs to it: the sweep has the echoes."""
    pose = Pose2D(x, 0.0, 0.0)
    return ScanInput(
        stamp_ns=1,
        ranges=np.full(10, np.inf, np.float32),
        angle_min=0.0,
        angle_increment=0.1,
        range_min=0.1,
        range_max=8.0,
        base_T_laser=Pose2D.identity(),
        odom_T_base=pose,
        odom_T_base_end=pose,
    )


@pytest.mark.parametrize("dev_m", [0.03, 0.16])
def test_somebody_met_again_does_not_make_a_robot_stand_that_drives(dev_m: float) -> None:
    keyframe = Keyframe.of(0, 0, beside_somebody(0.0))
    local = LocalMap([keyframe], np.zeros((1, 3)), np.zeros(2), 14.0)
    matcher = ScanMatcher(30.0)
    matcher.reset(np.zeros(3), (dev_m, 0.01))
    matcher.predict(Pose2D(0.7, 0.0, 0.0), np.diag([0.03**2, 0.03**2, 0.03**2]))
    matcher.correct(local, beside_somebody(0.7), scan(0.7))
    assert matcher.pose == pytest.approx([0.7, 0.0, 0.0], abs=0.1)


def among_boxes(x: float) -> Sweep:
    """What is seen at x [m] of boxes that stand at uneven distances along a corridor."""
    edges = np.cumsum([-3.0, 0.9, 0.5, 1.3, 0.4, 1.1, 0.7, 1.6, 0.5, 0.9, 1.2])
    rungs = np.arange(-1.0, 1.0, 0.05)
    points = np.vstack([np.column_stack([np.full_like(rungs, at - x), rungs]) for at in edges])
    normals = np.where(points[:, :1] > 0.0, -1.0, 1.0) * np.array([1.0, 0.0])
    return Sweep(Cloud(points, normals), np.zeros(2), is_blind=False)


@pytest.mark.parametrize(("told_m", "is_taken"), [(0.7, False), (2.0, True)])
def test_one_scan_does_not_take_a_robot_farther_than_its_wheels_have_driven(
    told_m: float, is_taken: bool
) -> None:
    keyframe = Keyframe.of(0, 0, among_boxes(0.0))
    local = LocalMap([keyframe], np.zeros((1, 3)), np.zeros(2), 14.0)
    matcher = ScanMatcher(30.0)
    matcher.reset(np.zeros(3), (0.04, 0.01))
    matcher.predict(Pose2D(told_m, 0.0, 0.0), np.diag([0.03**2, 0.03**2, 0.03**2]))
    match = matcher.correct(local, among_boxes(2.0), scan(told_m))
    assert match.quality.is_good == is_taken
    assert matcher.pose[0] == pytest.approx(told_m, abs=0.2)


def in_corridor(x: float) -> Sweep:
    """What is seen at x [m] of a bare corridor."""
    along = np.arange(-4.0, 4.0, 0.05) - x
    points = np.vstack([np.column_stack([along, np.full_like(along, y)]) for y in (-1.0, 1.0)])
    normals = np.vstack([np.tile([0.0, sign], (len(along), 1)) for sign in (1.0, -1.0)])
    return Sweep(Cloud(points, normals), np.zeros(2), is_blind=False)


def elsewhere() -> Sweep:
    """Echoes where a corridor is free."""
    points = np.random.default_rng(0).uniform((0.2, -0.6), (1.0, 0.6), (300, 2))
    normals = -points / np.hypot(*points.T)[:, None]
    return Sweep(Cloud(points, normals), np.zeros(2), is_blind=False)


@pytest.mark.parametrize(
    ("num_against", "is_believed"), [(1, True), (2, False)], ids=["somebody", "a missed turn"]
)
def test_a_scan_that_fits_is_not_believed_where_those_before_spoke_more_against_the_wheels(
    num_against: int, is_believed: bool
) -> None:
    local = LocalMap([Keyframe.of(0, 0, in_corridor(0.0))], np.zeros((1, 3)), np.zeros(2), 14.0)
    matcher = ScanMatcher(30.0)
    matcher.reset(np.zeros(3), (0.04, 0.01))
    places = 0.4 * np.arange(1.0, num_against + 2.0)
    sweeps = [*[elsewhere()] * num_against, in_corridor(places[-1])]
    matches: list[bool] = []
    for x, sweep in zip(places.tolist(), sweeps, strict=True):
        matcher.predict(Pose2D(0.4, 0.0, 0.0), np.diag([0.03**2, 0.03**2, 0.03**2]))
        matches.append(matcher.correct(local, sweep, scan(x)).quality.is_good)
    assert matches == [*[False] * num_against, is_believed]
