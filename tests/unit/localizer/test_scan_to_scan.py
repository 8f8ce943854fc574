"""Two scans tell whether the robot has driven on, and how far."""

import math
from dataclasses import replace

import numpy as np
import pytest

from trolley.config.localizer import LocalizerConfig
from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley_localizer.filter.scan_to_scan import PARAMS, ScanToScan, View
from trolley_localizer.matching.map_matcher import BeamSet, read_beams

from .conftest import BASE_T_LASER, RESOLUTION, Turn, at, make_scan

SURE = np.diag([0.01, 0.01, 1e-5])


def beams_at(flat: GridMap, pose: Pose2D, num_beams: int = 360, view_deg: float = 360.0) -> BeamSet:
    """What a lidar of so many beams a turn sees, ahead only if its view is narrower."""
    scan = make_scan(flat, pose, Pose2D.identity(), turn=Turn(num_beams))
    ahead = BASE_T_LASER.yaw + scan.angle_min + np.arange(num_beams) * scan.angle_increment
    is_seen = np.cos(ahead) >= math.cos(math.radians(0.5 * view_deg)) - 1e-9
    scan = replace(scan, ranges=np.where(is_seen, scan.ranges, np.float32(np.inf)))
    return read_beams(scan, RESOLUTION, LocalizerConfig().max_range_m)


def in_cells(flat: GridMap, pose: Pose2D) -> np.ndarray:
    seen = flat.origin.inverse() @ pose
    return np.array([seen.x / RESOLUTION, seen.y / RESOLUTION, seen.yaw])


@pytest.fixture
def scans(flat: GridMap) -> ScanToScan:
    scans, pose = ScanToScan(RESOLUTION), at(flat, 5.5, 3.0, 0.4)
    assert not scans.follow(beams_at(flat, pose), in_cells(flat, pose), SURE, 0.1)
    return scans


def test_the_first_scan_has_nothing_to_agree_with(flat: GridMap) -> None:
    pose = at(flat, 5.5, 3.0, 0.4)
    scans = ScanToScan(RESOLUTION)
    assert scans.agreement(beams_at(flat, pose), in_cells(flat, pose)) is None
    assert scans.align(in_cells(flat, pose), beams_at(flat, pose)) is None


def test_scans_of_one_drive_agree(flat: GridMap, scans: ScanToScan) -> None:
    pose = at(flat, 5.7, 3.05, 0.6)
    agreement = scans.agreement(beams_at(flat, pose), in_cells(flat, pose))
    assert agreement is not None
    assert agreement > 0.97


def test_a_scan_from_elsewhere_does_not(flat: GridMap, scans: ScanToScan) -> None:
    elsewhere, believed = at(flat, 1.6, 4.8, 2.5), at(flat, 5.5, 3.0, 0.4)
    assert scans.follow(beams_at(flat, elsewhere), in_cells(flat, believed), SURE, 0.1)


# Beams a turn, and the view [degrees]: some 23 echoes each.
FEW = [(90, 90.0), (45, 180.0), (24, 360.0)]


@pytest.mark.parametrize(("num_beams", "view_deg"), FEW)
def test_some_twenty_beams_tell_that_the_robot_was_carried(
    flat: GridMap, num_beams: int, view_deg: float
) -> None:
    believed = at(flat, 5.5, 3.0, 0.4)
    for elsewhere in (at(flat, 1.6, 4.8, 2.5), at(flat, 2.5, 1.0, -1.0), at(flat, 7.0, 2.0, 1.5)):
        scans = ScanToScan(RESOLUTION)
        beams = beams_at(flat, believed, num_beams, view_deg)
        assert not scans.follow(beams, in_cells(flat, believed), SURE, 0.1)
        beams = beams_at(flat, elsewhere, num_beams, view_deg)
        assert scans.follow(beams, in_cells(flat, believed), SURE, 0.1)


@pytest.mark.parametrize(("num_beams", "view_deg"), FEW)
def test_some_twenty_beams_of_one_drive_agree(
    flat: GridMap, num_beams: int, view_deg: float
) -> None:
    scans, pose = ScanToScan(RESOLUTION), at(flat, 5.5, 3.0, 0.4)
    scans.follow(beams_at(flat, pose, num_beams, view_deg), in_cells(flat, pose), SURE, 0.1)
    for turned in np.linspace(0.2, 0.6, 9):
        pose = at(flat, 5.7, 3.05, turned)
        beams = beams_at(flat, pose, num_beams, view_deg)
        agreement = scans.agreement(beams, in_cells(flat, pose))
        assert agreement is not None
        assert agreement > 0.93


def test_a_scan_is_aligned_with_the_earlier_one(flat: GridMap, scans: ScanToScan) -> None:
    true, told = at(flat, 5.7, 3.05, 0.5), at(flat, 5.74, 3.0, 0.52)
    led = scans.align(in_cells(flat, told), beams_at(flat, true))
    assert led is not None
    error = led.pose - in_cells(flat, true)
    assert np.hypot(error[0], error[1]) * RESOLUTION < 0.02
    assert abs(error[2]) < 0.01


def test_the_covariance_is_never_less_than_that_of_the_earlier_scan(
    flat: GridMap, scans: ScanToScan
) -> None:
    pose = at(flat, 5.7, 3.05, 0.5)
    led = scans.align(in_cells(flat, pose), beams_at(flat, pose))
    assert led is not None
    assert led.covariance[0, 0] > SURE[0, 0] + (PARAMS.floor_m / RESOLUTION) ** 2


def test_on_a_map_as_fine_as_a_millimetre_the_field_stays_small(flat: GridMap) -> None:
    fine, pose = 0.001, at(flat, 5.5, 3.0, 0.4)
    scan = make_scan(flat, pose, Pose2D.identity())
    view = View(read_beams(scan, fine, LocalizerConfig().max_range_m), fine)
    assert view.field.nbytes < 100e6
    scans = ScanToScan(fine)
    assert not scans.follow(view.beams, np.zeros(3), SURE, 0.1)
    told = np.array([15.0, 10.0, 0.01])
    led = scans.align(told, view.beams)
    assert led is not None
    assert np.hypot(led.pose[0], led.pose[1]) < 5.0
