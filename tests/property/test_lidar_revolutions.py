"""A turning sensor and its scans: each beam where and when it was measured, whatever the speed."""

import math
from collections import Counter
from itertools import pairwise

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from support.cases import cases

from trolley.config.hardware import LidarConfig
from trolley_base.drivers.interface import LidarScan
from trolley_base.drivers.lidars import MODELS
from trolley_base.drivers.lidars.revolutions import Revolutions, Rotation, Samples
from trolley_base.drivers.lidars.sample_clock import SampleClock

START_NS = 1_790_000_000 * 10**9
SAMPLE_S = 1.0 / 4500.0


def scans_of(
    angle_deg: np.ndarray, range_m: np.ndarray, turns_hz: float, cuts: list[int]
) -> tuple[list[LidarScan], Counter[str]]:
    """Feed samples in pieces, without any lateness; the first is measured at `START_NS`."""
    counts: Counter[str] = Counter()
    revolutions = Revolutions(MODELS["ld19"].facts, LidarConfig(model="ld19"), counts)
    rotation, clock = Rotation(turns_hz), SampleClock()
    clock.update(0.0, START_NS)
    sensor_s = 0.0
    edges = [0, *sorted({cut % len(angle_deg) for cut in cuts} - {0}), len(angle_deg)]
    for first, last in pairwise(edges):
        rates = np.full(last - first, 360.0 * turns_hz)
        angle, elapsed_s, begins = rotation.follow(angle_deg[first:last] % 360.0, rates)
        times_s = sensor_s + np.cumsum(elapsed_s)
        sensor_s = float(times_s[-1])
        nothing = np.zeros(last - first)
        samples = Samples(angle, nothing, elapsed_s, begins, range_m[first:last], np.empty(0))
        revolutions.add(samples, times_s, clock)
    return list(revolutions.scans), counts


@settings(deadline=None, max_examples=cases(60))
@given(
    turns_hz=st.floats(5.0, 13.0),
    begin_deg=st.floats(0.0, 359.9),
    cuts=st.lists(st.integers(0, 3000), max_size=20),
)
def test_even_samples_keep_their_angles_and_times(
    turns_hz: float, begin_deg: float, cuts: list[int]
) -> None:
    number = np.arange(2500)
    angle_deg = begin_deg + 360.0 * turns_hz * SAMPLE_S * number
    range_m = 1.0 + (number % 997) / 100.0  # so that each tells which sample it was
    scans, counts = scans_of(angle_deg, range_m, turns_hz, cuts)
    assert not counts
    assert len(scans) == math.floor(angle_deg[-1] / 360.0) - 1
    for scan in scans:
        assert (scan.ranges > 0.0).all()
        beams = np.arange(len(scan.ranges))
        theta = scan.angle_min + scan.angle_increment * beams
        measured_s = (scan.stamp_ns - START_NS) * 1e-9 + scan.time_increment * beams
        fired = np.rint(measured_s / SAMPLE_S).astype(int)
        np.testing.assert_allclose(measured_s, fired * SAMPLE_S, atol=1e-6)
        np.testing.assert_allclose(scan.ranges, range_m[fired], atol=1e-4)
        beside = (np.degrees(theta) + angle_deg[fired] + 180.0) % 360.0 - 180.0
        np.testing.assert_allclose(beside, 0.0, atol=1e-6)


@settings(deadline=None, max_examples=cases(60))
@given(
    seed=st.integers(0, 2**32 - 1), turns_hz=st.floats(5.0, 13.0), spread_deg=st.floats(0.0, 2.0)
)
def test_uneven_samples_leave_no_holes_and_the_nearest_counts(
    seed: int, turns_hz: float, spread_deg: float
) -> None:
    rng = np.random.default_rng(seed)
    step_deg = 360.0 * turns_hz * SAMPLE_S
    # Angles wander slowly beside the head's, as a triangulating sensor's do along a wall.
    number = np.arange(2500)
    head_deg = 10.0 + step_deg * number
    wander = spread_deg * np.sin(2.0 * np.radians(head_deg) + rng.uniform(0.0, 6.0))
    angle_deg = head_deg + wander
    # No three of them are on one surface, so that each stays what it is.
    range_m = np.where(number % 2, rng.uniform(0.5, 1.0, 2500), rng.uniform(4.0, 9.0, 2500))
    scans, _ = scans_of(angle_deg, range_m, turns_hz, [])
    assert scans
    for scan in scans:
        # One may be left at the seam, where the wandering of two turns meets.
        assert np.count_nonzero(scan.ranges == 0.0) <= 1
        seen = scan.ranges[scan.ranges > 0.0]
        assert np.isin(seen, range_m.astype(np.float32)).all()


@settings(deadline=None, max_examples=cases(40))
@given(seed=st.integers(0, 2**32 - 1), share=st.floats(0.0, 0.18))
def test_what_was_not_measured_is_empty(seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    number = np.arange(2500)
    is_kept = rng.random(len(number)) >= share
    is_kept[::450] = True  # the first of a turn says where its grid begins
    kept = np.flatnonzero(is_kept)
    angle_deg, range_m = 0.8 * number, 1.0 + (number % 450) / 100.0
    scans, _ = scans_of(angle_deg[kept], range_m[kept], 10.0, [])
    for scan in scans:
        fired = np.rint(
            ((scan.stamp_ns - START_NS) * 1e-9 + scan.time_increment * np.arange(len(scan.ranges)))
            / SAMPLE_S
        ).astype(int)
        assert ((scan.ranges > 0.0) == np.isin(fired, kept)).all()
