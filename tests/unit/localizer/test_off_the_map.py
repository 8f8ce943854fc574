"""Where the map ends: following on, not jumping, and saying so."""

import numpy as np
import pytest

from trolley.config.localizer import LocalizerConfig
from trolley.geometry import Pose2D
from trolley.gridmap import OCCUPIED, UNKNOWN, GridMap
from trolley_localizer.core import Localizer

from .conftest import LATE, RESOLUTION, LateDrive, at, make_house

pytestmark = pytest.mark.drives


def left_half(house: GridMap) -> GridMap:
    """The map of a robot that has not been in the right room."""
    cells = house.cells.copy()
    cells[:, 134:] = UNKNOWN
    return GridMap("left", house.resolution, house.origin, cells)


def begin(late: int, known: GridMap | None = None) -> LateDrive:
    house = make_house()
    localizer = Localizer(known or left_half(house), [], LocalizerConfig(), 0)
    drive = LateDrive(house, localizer, Pose2D(4.0, 2.5, 0.0), late)
    localizer.set_pose(drive.pose)
    drive.stand(8)
    return drive


@pytest.mark.parametrize("late", LATE)
def test_off_the_map_it_follows_on_says_so_and_is_right_when_it_is_back(late: int) -> None:
    drive = begin(late)
    out = drive.go(6.0)
    assert out[-1].state == "unsure"
    assert out[-1].message.startswith("off the map since ")
    assert drive.error_m(out[-1]) < 0.3
    back = drive.go(-6.0)
    assert back[-1].state == "localized"
    assert drive.error_m(back[-1]) < 0.1
    every = [*out, *back]
    assert not [one.state for one in every if one.state in ("lost", "searching")]


def test_off_the_map_the_covariance_grows() -> None:
    drive = begin(0)
    sizes = [e.covariance[0, 0] for e in drive.go(6.0) if e.covariance is not None]
    assert sizes[-1] > 4.0 * sizes[0]


def test_off_the_map_scans_lead_on_though_the_wheels_slip() -> None:
    drive = begin(0)
    drive.go(5.0)
    for _ in range(30):
        drive.odom = drive.odom @ Pose2D(0.05, 0.0, 0.0)
        estimate = drive.look()
    assert drive.error_m(estimate) < 0.3


@pytest.mark.parametrize("late", LATE)
def test_carried_into_the_unknown_it_is_never_sure(late: int) -> None:
    drive = begin(late)
    drive.pose = at(drive.grid, 9.0, 2.2, 2.0)
    estimates = drive.stand(60)
    assert not [e for e in estimates[5:] if e.state == "localized"]


@pytest.mark.parametrize("late", LATE)
def test_carried_on_the_map_it_is_found_whenever_the_search_delivers(late: int) -> None:
    house = make_house()
    drive = begin(late, house)
    drive.pose = at(house, 9.0, 1.2, 2.0)
    estimates = drive.stand(90)
    wrong = [e for e in estimates if e.state == "localized" and drive.error_m(e) > 0.5]
    assert len(wrong) <= 1
    assert estimates[-1].state == "localized"
    assert drive.error_m(estimates[-1]) < 0.1


@pytest.mark.parametrize("late", LATE)
def test_furniture_that_has_come_is_no_reason_to_jump(late: int) -> None:
    house = make_house()
    drive = begin(late, house)
    drive.grid = GridMap("changed", RESOLUTION, house.origin, house.cells.copy())
    for r0, r1, c0, c1 in ((30, 34, 60, 100), (66, 70, 50, 110), (40, 56, 40, 44)):
        drive.grid.cells[r0:r1, c0:c1] = OCCUPIED
    drive.worst_m = 0.0
    for metres in (1.0, -1.0, 1.0):
        drive.go(metres)
    assert drive.worst_m < 0.3


def test_a_map_that_knows_nothing_is_no_place_to_be_sure_of() -> None:
    house = make_house()
    nothing = GridMap("nothing", RESOLUTION, house.origin, np.full_like(house.cells, UNKNOWN))
    drive = begin(0, nothing)
    assert not [e for e in drive.go(2.0) if e.state == "localized"]


def test_a_lidar_that_sees_nothing_for_a_minute_loses_nothing() -> None:
    drive = begin(0, make_house())
    drive.alter = lambda ranges: ranges.fill(np.inf)
    for _ in range(600):
        estimate = drive.scan()
    assert estimate.state == "unsure"
    drive.alter = lambda ranges: None
    for _ in range(10):
        estimate = drive.scan()
    assert estimate.state == "localized"
    assert drive.error_m(estimate) < 0.1


def test_of_two_flats_alike_it_is_sure_of_neither() -> None:
    house = make_house()
    gap = np.full((house.rows, 6), OCCUPIED, np.int8)
    cells = np.hstack([house.cells, gap, house.cells])
    twins = GridMap("twins", RESOLUTION, house.origin, cells)
    localizer = Localizer(twins, [], LocalizerConfig(), 0)
    drive = LateDrive(house, localizer, Pose2D(2.0, 2.5, 0.0), 0)
    assert not [e for e in drive.go(4.0) if e.state == "localized"]
