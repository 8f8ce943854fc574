"""Beams put where they would be had the robot stood still."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trolley.deskewing import deskew, is_blind
from trolley.geometry import Pose2D, interpolate
from trolley.scanning import FrontEndParams, ScanInput

PARAMS = FrontEndParams(
    least_range_m=0.05, usable_range_share=0.9, telling_range_m=0.5, min_telling_share=0.1
)


def make_scan(ranges: list[float], motion: Pose2D | None = None) -> ScanInput:
    odom_T_base = Pose2D(3.0, -2.0, 0.7)
    return ScanInput(
        stamp_ns=1,
        ranges=np.array(ranges, np.float32),
        angle_min=-1.0,
        angle_increment=0.25,
        range_min=0.01,
        range_max=10.0,
        base_T_laser=Pose2D(0.2, 0.1, 0.3),
        odom_T_base=odom_T_base,
        odom_T_base_end=odom_T_base @ (motion or Pose2D.identity()),
    )


@given(
    st.lists(st.floats(0.125, 8.0), min_size=2, max_size=9),
    st.floats(-0.2, 0.2),
    st.floats(-0.2, 0.2),
    st.floats(-0.4, 0.4),
    st.sampled_from([1.0, 0.05]),
)
def test_each_beam_starts_where_the_laser_was(
    ranges: list[float], x: float, y: float, yaw: float, unit_m: float
) -> None:
    scan = make_scan(ranges, Pose2D(x, y, yaw))
    seen = deskew(scan, PARAMS, 20.0, unit_m)
    for i, reach in enumerate(ranges):
        share = i / (len(ranges) - 1)
        laser = interpolate(Pose2D.identity(), Pose2D(x, y, yaw), share) @ scan.base_T_laser
        end = laser @ Pose2D(0.0, 0.0, -1.0 + 0.25 * i) @ Pose2D(reach, 0.0, 0.0)
        assert (seen.starts.x[i] * unit_m, seen.starts.y[i] * unit_m) == pytest.approx(
            (laser.x, laser.y), abs=1e-6
        )
        assert (seen.ends.x[i] * unit_m, seen.ends.y[i] * unit_m) == pytest.approx(
            (end.x, end.y), abs=1e-6
        )


def test_only_ranges_that_can_be_measured_are_echoes() -> None:
    ranges = [0.0, 0.04, 0.06, math.nan, math.inf, 8.9, 9.1, -1.0]
    assert deskew(make_scan(ranges), PARAMS, 20.0).echoes.tolist() == [2, 5]
    assert deskew(make_scan(ranges), PARAMS, 5.0).echoes.tolist() == [2]
    nearest = replace(make_scan(ranges), range_min=0.1)
    assert deskew(nearest, PARAMS, 20.0).echoes.tolist() == [5]


def test_the_wheels_of_a_robot_that_stood_are_not_believed() -> None:
    moved = make_scan([1.0, 2.0, 3.0], Pose2D(0.1, 0.0, 0.2))
    stood = deskew(moved, PARAMS, 20.0, is_still=True)
    plain = deskew(make_scan([1.0, 2.0, 3.0]), PARAMS, 20.0)
    assert np.allclose(stood.ends, plain.ends, atol=1e-12)
    assert stood.motion == Pose2D.identity()


def test_a_scan_of_near_echoes_only_is_blind() -> None:
    assert is_blind(np.full(100, 0.4), PARAMS)
    assert is_blind(np.full(14, 3.0), PARAMS)
    assert not is_blind(np.full(15, 3.0), PARAMS)
    mixed = np.full(400, 0.4)
    mixed[:39] = 3.0
    assert is_blind(mixed, PARAMS)
    mixed[39] = 3.0
    assert not is_blind(mixed, PARAMS)
