"""Recorded drives of real robots through `base` and `localizer`, judged by their references."""

import math
from pathlib import Path

import numpy as np
import pytest
from drives import replay_errors

from trolley.geometry import Pose2D

OFFSET = Pose2D(0.3, 0.0, math.radians(10.0))
START_UP_SCANS = 10


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "map_name", "allowed"),
    [
        ("freiburg-079", "freiburg-079.yaml", 0.02),
        ("create3-rplidar-mac", "mac_1st_floor_final.yaml", 0.0),
    ],
)
def test_whole_drive_is_tracked(recordings: Path, name: str, map_name: str, allowed: float) -> None:
    errors = replay_errors(recordings / f"{name}.npz", recordings / map_name, OFFSET, seed=1)
    lost = (errors[:, 0] > 0.5) | (errors[:, 1] > math.radians(20.0))
    # Until the first scans are in there is no pose to judge.
    assert np.isfinite(errors[START_UP_SCANS:, 0]).all()
    assert lost[START_UP_SCANS:].mean() <= allowed
    assert not lost[-1]
