"""What a board's bumpers and sonars feel, as echoes around the robot."""

import math

import numpy as np
import pytest

from trolley.geometry import footprint_from_box, polygon_contains
from trolley.messages import Link, Scan
from trolley.messages.types import floats_from_bytes
from trolley_base.board_sensors import AGAIN_NS, BEARINGS, BoardSensors, outline_distances
from trolley_base.drivers import ChassisReading, Contact
from trolley_base.drivers.boards.sonar import sonar_scan

OUTLINE = footprint_from_box(0.40, 0.30)
AHEAD = ((math.radians(-45.0), math.radians(45.0)),)
BEHIND = ((math.radians(150.0), math.radians(-150.0)),)
LINK = Link(name="chassis", state="up")


def feel(*contacts: Contact, ranges: tuple[Scan, ...] = ()) -> ChassisReading:
    return ChassisReading((), LINK, contacts=contacts, ranges=ranges)


def echoes(scan: Scan) -> np.ndarray:
    """Where its echoes lie, (n, 2)."""
    ranges = floats_from_bytes(scan.ranges).astype(float)
    angles = scan.angle_min + np.arange(len(ranges)) * scan.angle_increment
    points = np.stack([ranges * np.cos(angles), ranges * np.sin(angles)], axis=1)
    return points[(ranges > 0.0) & (ranges <= scan.range_max)]


@pytest.mark.parametrize(
    "outline",
    [
        OUTLINE,
        OUTLINE + np.array([0.05, 0.0]),
        0.17 * np.stack([np.cos(BEARINGS), np.sin(BEARINGS)], axis=1),
    ],
)
def test_the_outline_is_where_a_ray_leaves_the_polygon(outline: np.ndarray) -> None:
    """Against a search by steps of a tenth of a millimetre."""
    bearings = np.random.default_rng(3).uniform(-math.pi, math.pi, 40)
    for bearing, away in zip(bearings, outline_distances(outline, bearings), strict=True):
        steps = np.arange(0.0, 0.5, 1e-4)
        ray = np.stack([steps * math.cos(bearing), steps * math.sin(bearing)], axis=1)
        assert away == pytest.approx(steps[polygon_contains(outline, ray)].max(), abs=2e-4)


@pytest.mark.parametrize(("sectors", "sign"), [(AHEAD, 1.0), (BEHIND, -1.0)])
def test_a_bumper_has_echoes_just_outside_of_the_outline_where_it_is_hit(
    sectors: tuple[tuple[float, float], ...], sign: float
) -> None:
    [scan] = BoardSensors(["bumper"], OUTLINE).scans(feel(Contact("bumper", sectors)), 0)
    points = echoes(scan)
    assert len(points) >= 10
    assert not polygon_contains(OUTLINE, points).any()
    assert polygon_contains(1.12 * OUTLINE, points).all()
    assert (sign * points[:, 0] > 0.1).all()


def test_what_is_not_hit_is_not_known_and_nothing_is_free_by_it() -> None:
    [scan] = BoardSensors(["bumper"], OUTLINE).scans(feel(Contact("bumper", ())), 0)
    assert not floats_from_bytes(scan.ranges).any()


def test_only_listed_sensors_are_said() -> None:
    ranges = (sonar_scan("ahead", 5, 1.0, cone_rad=0.3, range_min=0.02, range_max=3.0),)
    reading = feel(Contact("bumper", AHEAD), ranges=ranges)
    assert BoardSensors([], OUTLINE).scans(reading, 0) == []
    assert BoardSensors(["ahead"], OUTLINE).scans(reading, 0) == list(ranges)


def test_a_change_is_said_at_once_and_everything_again_after_a_while() -> None:
    sensors = BoardSensors(["bumper"], OUTLINE)
    free, hit = feel(Contact("bumper", ())), feel(Contact("bumper", AHEAD))
    at_ns = [0, 20_000_000, 40_000_000, 60_000_000, 40_000_000 + AGAIN_NS]
    readings = [free, free, hit, hit, hit]
    said = [len(sensors.scans(one, at)) for one, at in zip(readings, at_ns, strict=True)]
    assert said == [1, 0, 1, 0, 1]


@pytest.mark.parametrize(
    ("measured", "told"),
    [(0.5, 0.5), (4.0, math.inf), (math.inf, math.inf), (0.0, 0.0), (math.nan, 0.0), (-1.0, 0.0)],
)
def test_a_sonar_has_the_same_range_all_across_its_cone(measured: float, told: float) -> None:
    scan = sonar_scan("ahead", 7, measured, cone_rad=0.35, range_min=0.02, range_max=3.0)
    ranges = floats_from_bytes(scan.ranges)
    assert len(ranges) >= 3
    assert (ranges == np.float32(told)).all()
    assert scan.angle_min + (len(ranges) - 1) * scan.angle_increment == pytest.approx(0.175)
