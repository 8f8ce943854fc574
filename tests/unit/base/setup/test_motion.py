"""How far the robot has turned, and where its lidar is."""

import math
from collections.abc import Iterable
from dataclasses import replace
from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from trolley.geometry import Pose2D, wrap_angle
from trolley_base.drivers import LidarScan
from trolley_base.setup.motion import LidarTrack, Turn

AHEAD = np.linspace(-0.5 * math.pi, 0.5 * math.pi, 181)

steps = st.lists(st.floats(-3.0, 3.0), max_size=20)


@given(first=st.floats(-math.pi, math.pi), steps=steps)
def test_a_turn_adds_up_however_far_it_leads(first: float, steps: list[float]) -> None:
    turn, direction = Turn(first), first
    for step in steps:
        direction = wrap_angle(direction + step)
        turn.update(direction)
    assert math.isclose(turn.angle, math.fsum(steps), abs_tol=1e-9)


def test_half_a_turn_is_not_over_where_left_becomes_right() -> None:
    error = -3.12
    turn = Turn(error)
    left = [error + turn.update(now) for now in (3.13, -3.0, -1.5)]
    assert left == sorted(left)
    assert left[0] < -3.1


def scan_at(pose: Pose2D, stamp_ns: int) -> LidarScan:
    """What a lidar that looks ahead only sees in a room of 5 x 4 m with a cupboard in a corner."""
    angles = pose.yaw + AHEAD
    ray = np.stack([np.cos(angles), np.sin(angles)])
    walls = [
        np.where(along > 0.0, half - at, half + at) / np.maximum(np.abs(along), 1e-9)
        for along, half, at in zip(ray, (2.5, 2.0), (pose.x, pose.y), strict=True)
    ]
    ranges = np.minimum(*walls)
    # The cupboard has two sides that show, at x = 1.5 and y = 1.2.
    for axis, edge, other in ((0, 1.5, 1.2), (1, 1.2, 1.5)):
        here = (pose.x, pose.y)
        away = (edge - here[axis]) / np.where(ray[axis] > 1e-9, ray[axis], math.inf)
        meets = (away > 0.0) & (here[1 - axis] + away * ray[1 - axis] > other)
        ranges = np.where(meets, np.minimum(ranges, away), ranges)
    return LidarScan(
        stamp_ns=stamp_ns,
        angle_min=float(AHEAD[0]),
        angle_increment=float(AHEAD[1] - AHEAD[0]),
        time_increment=0.0,
        range_min=0.05,
        range_max=12.0,
        ranges=ranges.astype(np.float32),
    )


def path(*poses: Pose2D) -> Iterable[list[Pose2D]]:
    """The way from each pose to the next, in steps that scans can be followed over."""
    for before, after in pairwise(poses):
        moved = before.inverse() @ after
        count = math.ceil(max(10.0 * math.hypot(moved.x, moved.y), 10.0 * abs(moved.yaw), 1.0))
        shares = np.linspace(0.0, 1.0, count + 1)[1:]
        yield [before @ Pose2D(*(share * moved.as_array()).tolist()) for share in shares]


def test_what_was_seen_on_the_first_turns_is_known_after_many_strokes() -> None:
    track = LidarTrack()
    strokes = [Pose2D(0.45 * way, 0.0, 0.0) for way in (1.0, 0.5, 0.0, -0.5, -1.0, -0.5, 0.0, 0.5)]
    turns = [Pose2D(0.0, 0.0, wrap_angle(1.2 * k)) for k in range(6)]
    poses = [*turns, *strokes, *strokes, Pose2D(-0.45, 0.0, 3.0)]
    stamp_ns = 0
    for number, leg in enumerate(([poses[0]], *path(*poses))):
        for pose in leg:
            stamp_ns += 100_000_000
            scan = scan_at(pose, stamp_ns)
            assert track.take(scan)
            track.follow(scan, [])
        found, _, is_plain = track.note_stand(track.scans[-1:] * 6, [], number)
        assert not is_plain
        assert found.distance_to(leg[-1]) < 0.01


def test_where_a_lidar_is_masked_it_does_not_see() -> None:
    round_about = np.linspace(-math.pi, math.pi, 360, endpoint=False)
    masked = abs(round_about) > 0.5 * math.pi
    track = LidarTrack()
    for number in range(2):
        ranges = np.where(masked, 0.0, 2.0).astype(np.float32)
        ranges[180 + number :: 2] = 0.0  # here and there a beam fails, but not each time
        scan = replace(
            scan_at(Pose2D.identity(), number + 1),
            angle_min=-math.pi,
            angle_increment=math.radians(1.0),
            ranges=ranges,
        )
        assert track.take(scan)
    assert math.isclose(track.view_rad([]), math.pi, abs_tol=0.05)
    assert math.isclose(track.view_rad([(0.0, 0.5)]), math.pi - 0.5, abs_tol=0.05)
