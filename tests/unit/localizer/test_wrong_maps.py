"""Maps of something else: whatever they show, the robot is never sure of a wrong place."""

import math

import numpy as np
import pytest

from trolley.config.localizer import LocalizerConfig
from trolley.geometry import Pose2D
from trolley.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from trolley_localizer.core import Localizer
from trolley_localizer.estimate import Estimate

from .conftest import LATE, RESOLUTION, LateDrive, make_house

pytestmark = pytest.mark.drives

START = Pose2D(2.2, 2.5, 0.0)


def wrong(estimates: list[Estimate], truths: list[Pose2D]) -> int:
    """How often it was sure of a place over half a metre off."""
    count = 0
    for estimate, truth in zip(estimates, truths, strict=True):
        pose = estimate.map_T_base
        if estimate.state == "localized" and (pose is None or pose.distance_to(truth) > 0.5):
            count += 1
    return count


def wander(drive: LateDrive) -> tuple[list[Estimate], list[Pose2D]]:
    """Drive about in the left room, through the door and about in the right one."""
    estimates: list[Estimate] = []
    truths: list[Pose2D] = []
    # Turn and come back to the heading, so that the way leads through the door.
    for vx, wz, scans in (
        (0.2, 0.5, 40), (0.0, -1.0, 20), (0.4, 0.0, 20), (0.0, 0.6, 20), (0.0, -0.6, 20),
    ):  # fmt: skip
        for _ in range(scans):
            estimates += drive.arc(vx, wz, 1)
            truths.append(drive.pose)
    return estimates, truths


def begin(known: GridMap, late: int, start: Pose2D = START) -> LateDrive:
    """A robot in the house, with a map, that does not know where it is."""
    return LateDrive(make_house(), Localizer(known, [], LocalizerConfig(), 0), start, late)


def with_blocks(cells: np.ndarray, blocks: tuple[tuple[int, int, int, int], ...]) -> GridMap:
    for r0, r1, c0, c1 in blocks:
        cells[r0:r1, c0:c1] = OCCUPIED
    return GridMap("another", RESOLUTION, Pose2D.identity(), cells)


def another_floor() -> GridMap:
    """The same outer walls, other rooms."""
    cells = np.full((100, 260), OCCUPIED, np.int8)
    cells[2:98, 2:258] = FREE
    return with_block_door(
        cells, ((44, 47, 2, 200), (2, 98, 86, 89), (47, 98, 170, 173), (10, 20, 20, 60)),
        ((10, 28, 86, 89), (60, 78, 86, 89), (44, 47, 40, 58), (44, 47, 120, 138)),
    )  # fmt: skip


def with_block_door(
    cells: np.ndarray,
    blocks: tuple[tuple[int, int, int, int], ...],
    doors: tuple[tuple[int, int, int, int], ...],
) -> GridMap:
    grid = with_blocks(cells, blocks)
    for r0, r1, c0, c1 in doors:
        cells[r0:r1, c0:c1] = FREE
    return grid


def before_rebuilding() -> GridMap:
    """The house when the wall stood 1.5 m further to the right and the furniture elsewhere."""
    cells = np.full((100, 260), OCCUPIED, np.int8)
    cells[2:98, 2:258] = FREE
    return with_block_door(
        cells, ((2, 98, 158, 162), (70, 98, 30, 50), (2, 20, 100, 125), (40, 50, 60, 80)),
        ((70, 90, 158, 162),),
    )  # fmt: skip


@pytest.mark.parametrize("late", LATE)
@pytest.mark.parametrize("known", [another_floor(), before_rebuilding()])
def test_on_the_map_of_another_floor_or_before_rebuilding_it_is_never_sure(
    known: GridMap, late: int
) -> None:
    estimates, _ = wander(begin(known, late))
    assert not [e for e in estimates if e.state == "localized"]
    assert all(e.message for e in estimates)


@pytest.mark.parametrize("late", LATE)
def test_told_where_it_is_on_the_map_before_rebuilding_it_is_not_sure_of_elsewhere(
    late: int,
) -> None:
    drive = begin(before_rebuilding(), late)
    drive.localizer.set_pose(START)
    assert wrong(*wander(drive)) == 0


@pytest.mark.parametrize("late", LATE)
def test_in_a_room_that_was_furnished_anew_it_is_not_lost_and_jumps_nowhere(late: int) -> None:
    """It has been followed from where it was right, without a break: nothing can be elsewhere."""
    drive = begin(make_house(), late)
    shelves = ((22, 34, 136, 240), (72, 84, 136, 240), (34, 72, 215, 225))
    drive.grid = with_blocks(make_house().cells.copy(), shelves)
    drive.localizer.set_pose(START)
    assert drive.go(3.6)[-1].state == "localized"
    anew = [*drive.go(3.2), *drive.arc(0.2, 0.6, 60)]
    assert "unsure" in {one.state for one in anew}
    assert not {one.state for one in anew} & {"lost", "searching"}
    assert drive.worst_m < 0.3


@pytest.mark.parametrize("late", LATE)
def test_on_a_map_of_one_room_it_is_sure_only_there(late: int) -> None:
    house = make_house()
    room = GridMap("room", RESOLUTION, house.origin, house.cells[:, :132].copy())
    drive = begin(room, late, Pose2D(11.0, 2.5, math.pi))
    outside = drive.arc(0.2, 0.6, 60)
    assert not [e for e in outside if e.state == "localized"]
    drive.pose = Pose2D(8.0, 2.5, math.pi)  # carried before the door
    inside = drive.go(5.5)
    assert inside[-1].state == "localized"
    assert drive.error_m(inside[-1]) < 0.2


@pytest.mark.parametrize("late", LATE)
def test_on_a_map_that_was_turned_it_finds_the_turned_place(late: int) -> None:
    house = make_house()
    cells = np.ascontiguousarray(np.rot90(house.cells))
    turned = GridMap("turned", RESOLUTION, Pose2D.identity(), cells)
    drive = begin(turned, late)
    drive.localizer.set_pose(START)
    estimates, truths = wander(drive)
    width_m = house.cols * RESOLUTION
    # `rot90` turns the picture with row 0 on top: (row, col) becomes (cols - 1 - col, row).
    moved = Pose2D(0.0, width_m, -0.5 * math.pi)
    assert wrong(estimates, [moved @ truth for truth in truths]) == 0
    end = estimates[-1]
    assert end.state == "localized"
    assert end.map_T_base is not None
    assert end.map_T_base.distance_to(moved @ truths[-1]) < 0.2


def two_flats() -> GridMap:
    """The house twice, side by side."""
    house = make_house()
    gap = np.full((house.rows, 6), OCCUPIED, np.int8)
    cells = np.hstack([house.cells, gap, house.cells])
    return GridMap("twins", RESOLUTION, house.origin, cells)


@pytest.mark.parametrize("late", LATE)
def test_in_one_of_two_flats_alike_it_is_sure_of_neither(late: int) -> None:
    drive = begin(two_flats(), late)
    estimates, _ = wander(drive)
    assert not [e for e in estimates if e.state == "localized"]
    assert "several places look alike" in estimates[-1].message


def searching_in_vain(late: int) -> LateDrive:
    """A robot that has driven 10 m in one of two flats alike and has just searched again."""
    drive = begin(two_flats(), late, Pose2D(3.2, 1.5, 0.0))
    drive.arc(0.5, 0.5, 160)
    searches = drive.searches
    while drive.searches == searches:
        drive.arc(0.5, 0.5, 1)
    return drive


@pytest.mark.parametrize("late", LATE)
def test_it_searches_less_and_less_often_in_vain_but_at_once_when_carried_off(late: int) -> None:
    drive = searching_in_vain(late)
    searches = drive.searches
    drive.arc(0.5, 0.5, 32)  # 3.2 s, 2 m
    assert drive.searches == searches
    drive.pose = Pose2D(9.6, 2.5, 1.0)
    drive.stand(1)
    assert drive.searches == searches + 1


def test_it_searches_at_once_when_asked_to_or_told_a_pose() -> None:
    drive = searching_in_vain(0)
    searches = drive.searches
    drive.localizer.search()
    drive.stand(1)
    drive.localizer.set_pose(drive.pose)
    drive.stand(1)
    assert drive.searches == searches + 2


def test_standing_where_nothing_fits_it_does_not_search_the_same_scan_again() -> None:
    drive = begin(another_floor(), 0)
    drive.stand(150)
    assert drive.searches == 1
    drive.pose = Pose2D(4.5, 2.5, 1.0)  # Somebody has lifted it over.
    drive.stand(1)
    assert drive.searches == 2


def room_alike(
    gone: tuple[tuple[int, int, int, int], ...] = (),
    come: tuple[tuple[int, int, int, int], ...] = (),
) -> GridMap:
    """Another house with a left room of the same shape, its furniture gone or come."""
    cells = make_house().cells.copy()
    cells[:, 132:] = UNKNOWN
    cells[36:64, 132:186] = OCCUPIED
    cells[0:100, 182:244] = OCCUPIED
    cells[40:60, 132:190] = FREE
    cells[2:98, 186:240] = FREE
    with_block_door(cells, (), gone)
    return with_blocks(cells, come)


@pytest.mark.parametrize("late", LATE)
def test_a_room_alike_is_not_proven_by_driving_about_in_it(late: int) -> None:
    """The same walls fit again in each scan, as they did in the first."""
    known = room_alike(gone=((2, 22, 30, 50), (80, 98, 70, 95)), come=((82, 98, 16, 44),))
    drive = begin(known, late, Pose2D(1.2, 2.5, 0.0))
    estimates = [*drive.stand(30), *drive.go(2.5)]
    assert any(e.message == "driving on will show whether it is here" for e in estimates)
    assert not [e for e in estimates if e.state == "localized"]
