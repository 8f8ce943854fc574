"""What a lidar sees of the robot itself, and how scans that begin anywhere are joined."""

import math

import numpy as np
import pytest

from trolley.geometry import Pose2D
from trolley_base.drivers import LidarScan
from trolley_base.setup.record import Stand
from trolley_base.setup.sight import (
    Beams,
    Room,
    is_within,
    moving_share,
    near_sectors,
    own_sectors,
    picture,
    usual_ranges,
)


def square_room(angles: np.ndarray) -> np.ndarray:
    """Ranges in a room of 4 x 4 m, from its middle."""
    with np.errstate(divide="ignore"):
        return np.minimum(2.0 / np.abs(np.cos(angles)), 2.0 / np.abs(np.sin(angles)))


def scan_of(ranges: np.ndarray, first: float, stamp_ns: int = 0) -> LidarScan:
    increment = 2.0 * math.pi / len(ranges)
    return LidarScan(stamp_ns, first, increment, 0.0, 0.05, 12.0, ranges.astype(np.float32))


def test_scans_that_begin_anywhere_agree_once_they_are_resampled() -> None:
    scans: list[LidarScan] = []
    for first in (-3.1, -3.0837, 0.4, 1.7):
        angles = first + 2.0 * math.pi / 450 * np.arange(450)
        scans.append(scan_of(square_room(angles), first))
    beams = Beams.round_about(scans[0])
    usual = usual_ranges(beams, scans)
    away = np.abs(usual - square_room(beams.angles))
    assert np.median(away) < 0.001
    assert away.max() < 0.03  # in the corners
    assert moving_share(beams, scans) == 0.0


def test_a_third_of_the_picture_that_moves_is_noticed() -> None:
    angles = 2.0 * math.pi / 360 * np.arange(360)
    before = square_room(angles)
    after = np.where(np.abs(angles - 2.0) < 1.0, 0.7, before)
    scans = [scan_of(one, 0.0) for one in (before, before, after, after)]
    assert 0.25 < moving_share(Beams.round_about(scans[0]), scans) < 0.4


def test_what_turns_with_the_robot_is_its_own_and_a_wall_is_not() -> None:
    scan = scan_of(np.full(360, 3.0), -math.pi)
    beams = Beams.round_about(scan)
    stands: list[Stand] = []
    for number in range(5):
        ranges = np.full(360, 3.0, np.float32)
        ranges[beams.angles > 3.05] = 0.15  # a post behind, across the seam
        ranges[beams.angles < -3.05] = 0.15
        wall = np.abs(np.angle(np.exp(1j * (beams.angles - number)))) < 0.3
        ranges[wall] = 0.35
        stands.append(Stand(0, 1, Pose2D(0.0, 0.0, float(number)), ranges))
    near = near_sectors(beams, stands[1].ranges, 0.4)
    assert len(near) == 2
    (own,) = own_sectors(beams, stands, 0.4)
    first, last = map(math.degrees, own)
    assert (first, last) == pytest.approx((173.0, 187.0), abs=2.0)
    assert is_within((3.1, 3.2), [own])
    assert not is_within((0.9, 1.1), [own])


def test_room_is_free_only_where_it_was_seen() -> None:
    angles = np.linspace(-math.pi, math.pi, 720, endpoint=False)
    points = 2.0 * np.column_stack([np.cos(angles), np.sin(angles)])
    room = Room(np.zeros(2))
    room.add(points[angles > -2.5])
    assert room.blind > 0
    assert room.free_m == 0.0
    room.add(points)
    assert room.blind == 0
    assert room.free_m == pytest.approx(2.0)
    room.add(np.array([[0.0, 0.5]]))
    assert room.free_m == pytest.approx(0.5)


def test_a_picture_is_in_the_frame_of_the_robot_and_not_too_large() -> None:
    corners = np.array([[0.2, 0.1], [0.2, -0.1], [-0.2, -0.1], [-0.2, 0.1]])
    ahead = np.array([[2.0, 0.0]] * 1000 + [[50.0, 0.0]])
    mount = Pose2D(0.1, 0.0, 0.5 * math.pi)
    sight = picture(ahead, mount, corners, 0.7, is_measured=False)
    assert 180 <= len(sight.points) <= 360
    assert set(sight.points) == {(0.1, 2.0)}
    assert sight.laser == (0.1, 0.0)
    assert picture(np.empty((0, 2)), mount, corners, 0.7, is_measured=False).points == []
