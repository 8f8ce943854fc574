"""What a cheap lidar does to its revolutions."""

import math

import numpy as np
import pytest

from trolley_base.drivers.interface import LidarScan
from trolley_base.world.lidar_faults import FaultyLidar
from trolley_base.world.spec import LidarFaults, Sun

COUNT = 360
ANGLES = -math.pi + np.arange(COUNT) * (2.0 * math.pi / COUNT)


def make_scan(ranges: np.ndarray | None = None) -> LidarScan:
    full = np.full(COUNT, 3.0, dtype=np.float32) if ranges is None else ranges.astype(np.float32)
    return LidarScan(10**9, -math.pi, 2.0 * math.pi / COUNT, 0.1 / COUNT, 0.1, 8.0, full)


def spoil(faults: LidarFaults, scan: LidarScan, sun: Sun | None = None) -> LidarScan:
    spoiled = FaultyLidar(faults, np.random.default_rng(1)).spoil(scan, 0.0, sun)
    assert spoiled is not None
    return spoiled


def test_a_lidar_without_faults_changes_nothing() -> None:
    scan = make_scan()
    assert spoil(LidarFaults(), scan) is scan


def test_beams_at_an_edge_end_between_what_is_before_and_behind() -> None:
    ranges = np.where(np.abs(ANGLES) < 0.5, 1.0, 3.0)
    after = spoil(LidarFaults(mixed=1.0), make_scan(ranges)).ranges
    changed = np.flatnonzero(after != ranges.astype(np.float32))
    assert len(changed) == 2, "both edges of the near thing, one beam each"
    assert np.all((after[changed] > 1.0) & (after[changed] < 3.0))


def test_a_mount_that_leans_meets_the_floor_on_that_side_only() -> None:
    faults = LidarFaults(tilt_rad=0.05, tilt_towards=math.pi / 2, height_m=0.1)
    after = spoil(faults, make_scan(np.full(COUNT, np.inf))).ranges
    left = after[np.argmin(np.abs(ANGLES - math.pi / 2))]
    assert left == pytest.approx(0.1 / math.tan(0.05), rel=0.1)
    assert np.all(np.isinf(after[ANGLES < 0.0]))
    near = spoil(faults, make_scan(np.full(COUNT, 1.0))).ranges
    assert np.all(near == 1.0), "what stands before the floor is measured as ever"


def test_the_sun_blinds_the_beams_that_look_into_it() -> None:
    sun = Sun(x=0.0, y=0.0, length_m=1.0, width_m=1.0, towards=1.0, width_rad=0.4, lost=1.0)
    after = spoil(LidarFaults(), make_scan(), sun).ranges
    assert np.array_equal(after == 0.0, np.abs(ANGLES - 1.0) < 0.2)


def test_revolutions_are_lost_and_stamps_err() -> None:
    lidar = FaultyLidar(LidarFaults(lost_turns=0.3, stamp_jitter_s=0.002), np.random.default_rng(0))
    sent = [lidar.spoil(make_scan(), 0.0, None) for _ in range(500)]
    kept = [scan for scan in sent if scan is not None]
    assert 300 < len(kept) < 400
    errors = [1e-9 * (scan.stamp_ns - 10**9) for scan in kept]
    assert np.std(errors) == pytest.approx(0.002, rel=0.2)
