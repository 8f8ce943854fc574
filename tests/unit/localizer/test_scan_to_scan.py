"""Two scans tell whether the robot has driven on, and how far."""

import numpy as np
import pytest

from trolley.config.localizer import LocalizerConfig
from trolley.geometry import Pose2D
from trolley.gridmap import GridMap
from trolley_localizer.filter.scan_to_scan import PARAMS, ScanToScan, View
from trolley_localizer.matching.map_matcher import BeamSet, read_beams

from .conftest import RESOLUTION, at, make_scan

SURE = np.diag([0.01, 0.01, 1e-5])


def beams_at(flat: GridMap, pose: Pose2D) -> BeamSet:
    scan = make_scan(flat, pose, Pose2D.identity())
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
