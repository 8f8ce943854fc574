"""Speckles: the fast filter drops what LDROBOT's rule, written out slowly, drops."""

import math

import numpy as np
import pytest
from bench.base.lidars.ld19 import ld19_stream
from bench.base.lidars.record import chunks
from hypothesis import given, settings
from hypothesis import strategies as st
from support.cases import cases

from trolley.config.hardware import LidarConfig
from trolley_base.drivers.interface import DriverError
from trolley_base.drivers.lidars import make_lidar
from trolley_base.drivers.lidars.speckles import speckles

Echo = tuple[float, float, float, int]
"""Angle [deg], distance [mm], intensity, number."""


def kept_by_the_maker(echoes: list[Echo], step_deg: float) -> set[int]:
    """Numbers of those that the maker's rule keeps."""
    kept = {one[3] for one in echoes if one[1] >= 5000}
    near = sorted(one for one in echoes if 0 < one[1] < 5000)
    groups: list[list[Echo]] = []
    for one in near:
        last = groups[-1][-1] if groups else None
        is_beside = last is not None and one[0] - last[0] <= 2 * step_deg
        if last is not None and is_beside and abs(one[1] - last[1]) <= last[1] * 0.03:
            groups[-1].append(one)
        else:
            groups.append([one])
    if len(groups) > 1:
        first, last = groups[0][0], groups[-1][-1]
        if first[0] + 360 - last[0] < 2 * step_deg and abs(first[1] - last[1]) < last[1] * 0.03:
            groups[0] = groups.pop() + groups[0]
    for group in groups:
        mean = sum(one[2] for one in group) / len(group)
        is_single = len(group) < 3 and math.floor(mean) < 220
        if len(group) > 15 or (not is_single and mean > 15):
            kept |= {one[3] for one in group}
    return kept


@settings(deadline=None, max_examples=cases(200))
@given(seed=st.integers(0, 2**32 - 1), wall_m=st.floats(0.3, 6.0), dim=st.floats(0.0, 1.0))
def test_what_the_maker_drops_is_dropped(seed: int, wall_m: float, dim: float) -> None:
    rng = np.random.default_rng(seed)
    step_deg, count = 0.8, 450
    angle_deg = (3.0 + step_deg * np.arange(count)).astype(np.float64)
    runs = np.repeat(rng.random(count) < 0.3, rng.integers(1, 20, count))[:count]
    depth_mm = np.where(runs, 1000.0 * wall_m, rng.uniform(0.0, 6000.0, count)).round()
    depth_mm = np.where(rng.random(count) < 0.1, 0.0, depth_mm)
    bright = np.where(rng.random(count) < dim, rng.integers(0, 30, count), 225).astype(float)
    echoes = [
        (float(angle % 360.0), float(mm), float(light), number)
        for number, (angle, mm, light) in enumerate(zip(angle_deg, depth_mm, bright, strict=True))
    ]
    dropped = speckles(angle_deg, depth_mm / 1000.0, bright, step_deg)
    expected = kept_by_the_maker(echoes, step_deg) | set(np.flatnonzero(depth_mm == 0.0).tolist())
    assert set(np.flatnonzero(~dropped).tolist()) == expected


def scans(*, drops: bool) -> list[np.ndarray]:
    """Of an LD19 before whose wall a speck floats; all echoes have an intensity of 200."""

    def seen(angle_deg: float) -> float:
        return 1.0 if 90.2 < angle_deg % 360.0 < 91.0 else 2.5

    lidar = make_lidar(LidarConfig(model="ld19", settings={"speckle_filter": drops}))
    lidar.begin(0)
    found = []
    for at_s, data in chunks(ld19_stream(seen=seen), 230400, 0.5, 0.02):
        lidar.receive(data, round(at_s * 1e9))
        found += [scan.ranges for scan in lidar.take(round(at_s * 1e9)).scans]
    return found


def test_a_speck_is_dropped_only_if_one_says_so() -> None:
    assert all(np.count_nonzero(ranges == 1.0) == 1 for ranges in scans(drops=False))
    without = scans(drops=True)
    assert len(without) >= 3
    assert all(np.count_nonzero(ranges == 0.0) == 1 for ranges in without)
    assert all(np.count_nonzero(ranges == 2.5) == len(ranges) - 1 for ranges in without)


def test_a_lidar_without_the_filter_refuses_it() -> None:
    with pytest.raises(DriverError, match="unknown key `speckle_filter`"):
        make_lidar(LidarConfig(model="ydlidar_x4", settings={"speckle_filter": True}))
