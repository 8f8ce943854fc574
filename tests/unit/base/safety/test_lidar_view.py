import dataclasses
import math

import numpy as np
import pytest
from numpy.typing import NDArray

from trolley.geometry import Pose2D, footprint_from_box
from trolley_base.drivers import LidarScan
from trolley_base.safety.lidar_view import SIDES, LidarView, covered_beams, without_cover

S = 1_000_000_000
FOOTPRINT = footprint_from_box(0.3, 0.24)
SCAN = LidarScan(
    stamp_ns=0,
    angle_min=-math.pi,
    angle_increment=math.radians(1.0),
    time_increment=0.0,
    range_min=0.1,
    range_max=8.0,
    ranges=np.full(360, 2.0, dtype=np.float32),
)


def but(where: slice, what: float) -> LidarScan:
    """A scan with something else in some directions; beam 180 looks ahead."""
    ranges = SCAN.ranges.copy()
    ranges[where] = what
    return dataclasses.replace(SCAN, ranges=ranges)


DARK_AHEAD = but(slice(150, 211), 0.0)


class Watch:
    """A view that gets a scan ten times a second."""

    def __init__(self, mount: Pose2D | None = None) -> None:
        self.view = LidarView(FOOTPRINT, mount or Pose2D.identity())
        self.now_ns = 0

    def see(
        self,
        scan: LidarScan,
        seconds: float,
        start: Pose2D | None = None,
        end: Pose2D | None = None,
    ) -> list[str]:
        start = start or Pose2D.identity()
        end = end or start
        for step in range(round(seconds * 10)):
            self.now_ns += S // 10
            part = step / (seconds * 10)
            pose = Pose2D(
                start.x + part * (end.x - start.x), 0.0, start.yaw + part * (end.yaw - start.yaw)
            )
            self.view.update(dataclasses.replace(scan, stamp_ns=self.now_ns), pose)
        return self.view.closed


def test_a_lidar_that_sees_all_round_says_so() -> None:
    watch = Watch()
    assert watch.see(SCAN, 1.0) == []
    assert watch.view.share == 1.0
    assert watch.view.shares == dict.fromkeys(SIDES, 1.0)


def test_nothing_in_reach_is_seen_too() -> None:
    watch = Watch()
    watch.see(but(slice(0, 360), np.inf), 1.0)
    assert watch.view.share == 1.0
    assert not watch.view.lacks_echoes


def test_walls_do_not_vanish() -> None:
    watch = Watch()
    watch.see(SCAN, 1.0)
    watch.see(but(slice(3, 360), np.inf), 1.0)
    assert watch.view.lacks_echoes
    assert watch.view.share < 0.01
    watch.see(but(slice(0, 360), 0.0), 1.0)
    assert not watch.view.lacks_echoes, "it reports no open floor either"
    watch.see(SCAN, 1.0)
    assert (watch.view.share, watch.view.lacks_echoes) == (1.0, False)


def test_echoes_of_the_own_body_are_no_walls() -> None:
    watch = Watch()
    watch.see(SCAN, 1.0)
    own = np.where(np.arange(360) < 60, np.float32(0.05), np.float32(np.inf))
    watch.see(dataclasses.replace(SCAN, ranges=own), 1.0)
    assert watch.view.lacks_echoes


def test_who_walks_away_in_a_hall_leaves_open_floor() -> None:
    watch = Watch()
    watch.see(but(slice(40, 360), np.inf), 1.0)
    for beams in (30, 10, 4, 0):
        watch.see(but(slice(beams, 360), np.inf), 1.0)
        assert (watch.view.share, watch.view.lacks_echoes) == (1.0, False)


def test_sides_are_named_as_they_lie_on_the_robot_however_the_lidar_is_mounted() -> None:
    watch = Watch(Pose2D(0.0, 0.0, 0.5 * math.pi))
    watch.see(DARK_AHEAD, 1.0)
    assert watch.view.shares["left"] == 0.0
    assert watch.view.shares["front"] == watch.view.shares["rear"] == 1.0


def test_half_a_view_is_dark_behind_but_not_closed() -> None:
    watch = Watch()
    half = dataclasses.replace(SCAN, angle_min=-0.5 * math.pi, ranges=SCAN.ranges[:181])
    assert watch.see(half, 20.0, end=Pose2D(5.0, 0.0, 3.0)) == []
    assert watch.view.shares["rear"] == watch.view.shares["rear left"] == 0.0
    assert watch.view.shares["front"] == 1.0
    assert watch.view.share == 1.0, "of the beams that it has"


def test_a_side_that_goes_dark_at_once_and_stays_so_is_closed() -> None:
    watch = Watch()
    watch.see(SCAN, 1.0)
    assert watch.see(DARK_AHEAD, 2.5) == []
    assert watch.see(DARK_AHEAD, 1.0) == ["front"]
    assert watch.see(SCAN, 0.1) == []


def test_a_side_that_was_dark_from_the_start_is_not_said_to_have_been_closed() -> None:
    assert Watch().see(DARK_AHEAD, 20.0, end=Pose2D(3.0, 0.0, 3.0)) == []


def fading(part: float) -> LidarScan:
    """A black cupboard that comes nearer: ever more beams find nothing."""
    half = round(30 * part)
    return but(slice(180 - half, 181 + half), 0.0)


def test_a_black_wall_that_the_robot_drives_up_to_closes_nothing() -> None:
    watch = Watch()
    watch.see(SCAN, 1.0)
    for step in range(20):
        here, there = Pose2D(0.05 * step, 0.0, 0.0), Pose2D(0.05 * (step + 1), 0.0, 0.0)
        watch.see(fading(step / 19), 0.3, here, there)
    end = Pose2D(1.0, 0.0, 0.0)
    assert watch.see(DARK_AHEAD, 10.0, end) == []


def test_what_stays_dark_though_the_robot_turns_is_closed() -> None:
    watch = Watch()
    watch.see(SCAN, 1.0)
    for step in range(20):
        here, there = Pose2D(0.05 * step, 0.0, 0.0), Pose2D(0.05 * (step + 1), 0.0, 0.0)
        watch.see(fading(step / 19), 0.3, here, there)
    turned = Pose2D(1.0, 0.0, 1.5)
    assert watch.see(DARK_AHEAD, 4.0, Pose2D(1.0, 0.0, 0.0), turned) == ["front"]


def test_an_echo_of_its_own_body_is_no_view() -> None:
    watch = Watch()
    mast = but(slice(330, 360), 0.12)
    watch.see(mast, 1.0)
    assert watch.view.shares["rear"] < 0.6
    kept = watch.view.update(mast, Pose2D.identity()).ranges
    assert kept[330:].max() == 0.0
    assert kept[:330].min() == 2.0
    touching = watch.view.update(but(slice(175, 186), 0.14), Pose2D.identity()).ranges
    assert touching[180] == pytest.approx(0.14), "what touches it in front is the stop field's"


@pytest.mark.parametrize(
    "where", [slice(150, 211), slice(0, 360), slice(340, 360), slice(300, 345)]
)
def test_many_beams_side_by_side_at_the_nearest_range_are_a_cover(where: slice) -> None:
    scan = but(where, 0.1)
    expected = np.zeros(360, np.bool_)
    expected[where] = True
    expected &= expected.sum() >= 40
    assert covered_beams(scan).tolist() == expected.tolist()
    assert without_cover(scan).ranges[expected].tolist() == [0.0] * int(expected.sum())


def test_a_cover_may_lie_across_the_first_beam() -> None:
    scan = but(slice(0, 30), 0.1)
    scan.ranges[330:] = 0.1
    assert covered_beams(scan).sum() == 60


def near_things() -> list[NDArray[np.float32]]:
    """A post at the nearest range, and a wall that is as near at one place only."""
    post = SCAN.ranges.copy()
    post[175:186] = 0.1
    angles = np.radians(np.arange(-180.0, 180.0))
    wall = np.where(np.abs(angles) < 1.2, 0.101 / np.maximum(np.cos(angles), 0.1), 2.0)
    return [post, wall.astype(np.float32)]


@pytest.mark.parametrize("ranges", near_things(), ids=["a post", "a wall"])
def test_near_things_are_no_cover(ranges: NDArray[np.float32]) -> None:
    scan = dataclasses.replace(SCAN, ranges=ranges)
    assert without_cover(scan) is scan
