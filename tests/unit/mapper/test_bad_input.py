"""Drives that no mapper likes: a lift, wheels without a gyro, hours on the spot."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from trolley.config.mapper import MapperConfig
from trolley.geometry import Pose2D
from trolley.gridmap import FREE, OCCUPIED, GridMap
from trolley_mapper.slam.estimate import MapEstimate
from trolley_mapper.slam.mapper import Mapper
from trolley_mapper.slam.sentences import OTHER_FLOOR

from .conftest import Drive

MakeDrive = Callable[..., Drive]

pytestmark = pytest.mark.drives

# The cabin of a lift, and its door [cells].
CABIN = (slice(50, 80), slice(2, 32))
DOOR = (slice(56, 74), slice(32, 34))


def floor(*furniture: tuple[int, int, int, int]) -> GridMap:
    """A floor of 9 x 6.5 m behind the open door of a lift."""
    cells = np.full((130, 200), OCCUPIED, np.int8)
    cells[2:-2, 34:-2] = FREE
    cells[CABIN] = cells[DOOR] = FREE
    for row, col, high, wide in furniture:
        cells[row : row + high, col : col + wide] = OCCUPIED
    return GridMap("floor", 0.05, Pose2D.identity(), cells)


def with_closed_door(grid: GridMap) -> GridMap:
    cells = grid.cells.copy()
    cells[DOOR] = OCCUPIED
    return GridMap("floor", 0.05, Pose2D.identity(), cells)


def drive_to(drive: Drive, *places: tuple[float, float]) -> list[MapEstimate]:
    """Drive through places x, y [m]; returns what the mapper made of each scan."""
    made: list[MapEstimate] = []
    for x, y in places:
        bearing = math.atan2(y - drive.pose.y, x - drive.pose.x)
        turn = math.remainder(bearing - drive.pose.yaw, 2.0 * math.pi)
        count = math.ceil(abs(turn) / 0.08)
        made += [drive.scan(0.0, 10.0 * turn / count) for _ in range(count)]
        away = math.hypot(x - drive.pose.x, y - drive.pose.y)
        count = math.ceil(away / 0.04)
        made += [drive.scan(10.0 * away / count) for _ in range(count)]
    return made


def ride(drive: Drive, to: GridMap) -> None:
    """Close the door, and open it on another floor."""
    for grid in (with_closed_door(drive.grid), with_closed_door(to), to):
        drive.grid = grid
        for _ in range(5):
            drive.scan(seconds=1.0)


@pytest.mark.slow
def test_a_floor_reached_by_lift_is_not_drawn_over_the_first_one() -> None:
    # Behind the lift both floors have the same corridor.
    corridor = ((46, 34, 4, 56), (80, 34, 4, 56))
    first = floor(*corridor, (20, 130, 30, 20), (100, 60, 10, 30), (90, 150, 20, 8))
    away = ((2, 34, 26, 164), (108, 34, 20, 164), (2, 176, 126, 22))
    second = floor(*corridor, *away, (28, 124, 40, 4), (84, 120, 24, 4))
    start = Pose2D(3.0, 3.25, 0.0)
    drive = Drive(first, Mapper(MapperConfig(), start), start)
    drive.look()
    drive_to(drive, (5.5, 3.25), (5.5, 1.5), (8.5, 1.0), (8.5, 4.0), (5.5, 3.25), (0.85, 3.25))
    drive_to(drive, (0.9, 3.25))
    assert drive.last is not None
    assert drive.last.state == "mapping"
    assert drive.error_m() < 0.05
    before = drive.mapper.grid()
    ride(drive, second)
    seen = drive_to(drive, (5.4, 3.25), (5.4, 5.0), (5.4, 3.8), (7.5, 3.8), (7.5, 2.0), (7.5, 3.8))
    assert drive.last.state == "lost"
    assert OTHER_FLOOR in {one.message for one in seen}
    now = drive.mapper.grid()
    walls = [{*map(tuple, np.argwhere(one.cells >= 65).tolist())} for one in (before, now)]
    assert now.origin == before.origin
    assert len(walls[0] ^ walls[1]) < 0.05 * len(walls[0])
    # Back to the first floor, whose map goes on.
    drive_to(drive, (5.4, 3.8), (5.0, 3.25), (0.85, 3.25), (0.9, 3.25))
    ride(drive, first)
    drive_to(drive, (5.5, 3.25), (5.5, 1.5), (8.5, 1.0))
    assert drive.last.state == "mapping"
    assert drive.error_m() < 0.05


@pytest.mark.parametrize("share", [0.8, 1.25])
def test_without_a_gyro_wheels_that_tell_turns_badly_bend_nothing(
    make_drive: MakeDrive, share: float
) -> None:
    drive = make_drive()
    drive.odometry_turn_scale = share
    drive.tour()
    assert drive.last is not None
    assert drive.last.state == "mapping"
    assert drive.error_m() < 0.05


def test_two_scans_a_second_are_enough(make_drive: MakeDrive) -> None:
    drive = make_drive()
    drive.odometry_scale = 0.95
    drive.look()
    for vx, wz, count in ((0.5, 0.0, 12), (0.0, 0.8, 4), (0.5, 0.0, 12), (0.0, 0.8, 4)):
        for _ in range(count):
            drive.scan(vx, wz, seconds=0.5)
    assert drive.last is not None
    assert drive.last.state == "mapping"
    assert drive.error_m() < 0.05
