"""Recorded drives played by base and followed by the localizer, on the wire in lock-step."""

from pathlib import Path

import msgspec
import numpy as np
import pytest
from bench.harness.recorded import Recording, Score, read_recording, score, start_nearby

from trolley import topics
from trolley.config import RobotConfig
from trolley.geometry import Pose2D
from trolley.runtime.lockstep import Lockstep
from trolley_base.service import BaseService
from trolley_localizer.service import LocalizerService

# base stamps the first scan at its epoch; later ones keep the spacing of the file.
SAME_STAMP_NS = 1_000_000


def play(folder: Path, recording: Recording, name: str, map_name: str) -> tuple[Score, set[str]]:
    """Return how the drive was followed, and all states that were published."""
    start = start_nearby(recording, 0)
    config = msgspec.convert(
        {
            "robot": {"name": "trolley", "footprint": {"radius_m": 0.2}},
            "map": {"file": str(folder / f"{map_name}.yaml")},
            "start": {"pose": {"x": start.x, "y": start.y, "yaw": start.yaw}},
            "base": {"driver": "recording", "recording": {"file": str(folder / f"{name}.npz")}},
        },
        RobotConfig,
    )
    with Lockstep() as bus:
        poses = bus.record(topics.POSE)
        bus.add(LocalizerService(config))
        bus.add(BaseService(config))
        bus.run(recording.stamps[-1] + 1.0)
    scans_ns = np.round(recording.stamps * 1e9).astype(np.int64)
    found: list[tuple[Pose2D | None, str]] = [(None, "missing")] * len(scans_ns)
    epoch_ns = poses[0].stamp_ns - scans_ns[0]
    for pose in poses:
        index = int(np.argmin(np.abs(scans_ns + epoch_ns - pose.stamp_ns)))
        if abs(int(scans_ns[index]) + epoch_ns - pose.stamp_ns) < SAME_STAMP_NS:
            found[index] = (pose.pose, pose.state)
    return score(recording, found), {pose.state for pose in poses}


@pytest.mark.parametrize(
    ("name", "odom", "reference", "map_name"),
    [
        pytest.param(
            "freiburg-079",
            "odom_signed",
            "reference_refined",
            "freiburg-079",
            marks=pytest.mark.slow,
        ),
        ("create3-rplidar-mac", "odom", "reference", "mac_1st_floor_final"),
    ],
)
def test_a_recorded_drive_is_followed_on_the_wire(
    recordings: Path, name: str, odom: str, reference: str, map_name: str
) -> None:
    recording = read_recording(recordings, name, odom, reference)
    result, states = play(recordings, recording, name, map_name)
    assert result.far_share <= 0.001
    assert result.states.count("missing") <= 1
    assert not result.is_far[-1]
    assert result.median_m <= 0.06
    assert states <= {"localized", "unsure"}
