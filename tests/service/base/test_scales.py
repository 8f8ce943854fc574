"""A robot whose wheels count wrongly, and whose configuration says so."""

import math
from collections.abc import Callable
from typing import Any

import pytest

from trolley.config import ConfigError

WRONG = """
[wheels]
left_scale = 1.05
right_scale = 1.01
turn_scale = 0.97
scale_std = 0.0
turn_scale_std = 0.0
slip_per_m = 0.0
yaw_slip_per_m = 0.0
yaw_slip_per_rad = 0.0
"""
RIGHT = {
    "linear_scale": 0.5 * (1.0 / 1.05 + 1.0 / 1.01),
    "angular_scale": 0.5 * (1.0 / 1.05 + 1.0 / 1.01) / 0.97,
    "wheel_ratio": 1.0 + (1.05 / 1.01 - 1.0) * 0.97,
    "track_m": 0.2,
}


@pytest.mark.parametrize("is_calibrated", [True, False])
def test_a_calibrated_robot_drives_what_it_is_told_and_knows_what_it_drove(
    make_rig: Callable[..., Any], is_calibrated: bool
) -> None:
    rig = make_rig(errors=WRONG, base={"odometry": RIGHT} if is_calibrated else {})
    rig.drive(3.0, 0.3, 0.3)
    driven = rig.truth.twist
    assert math.isclose(driven.vx, 0.3, rel_tol=5e-3) == is_calibrated
    assert math.isclose(driven.wz, 0.3, rel_tol=5e-3) == is_calibrated
    rig.run(1.0)
    true, known = rig.truth.pose, rig.odometry[-1].pose
    assert (true.distance_to(known) < 0.01) == is_calibrated
    assert math.isclose(true.yaw, known.yaw, abs_tol=0.01) == is_calibrated


def test_a_wheel_ratio_without_a_track_is_refused_at_the_start(
    make_rig: Callable[..., Any],
) -> None:
    with pytest.raises(ConfigError, match=r"\[base.odometry\] wheel_ratio needs the track"):
        make_rig(base={"odometry": {"wheel_ratio": 1.02}})
