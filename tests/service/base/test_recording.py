"""A recorded drive in place of hardware."""

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from trolley import topics
from trolley.config import ConfigError, RobotConfig
from trolley.config.base import RecordingConfig
from trolley.geometry import Pose2D
from trolley.messages import Robot, floats_from_bytes
from trolley_base.service import BaseService

from .conftest import Rig


@pytest.fixture
def config(tmp_path: Path) -> RobotConfig:
    """Of a recording of 4 s at 4 Hz with a gap of 1 s: 0.25 m/s ahead, 90 beams."""
    stamps = np.array([i * 0.25 for i in range(17) if not 4 < i < 8])
    arrays: dict[str, Any] = {
        "stamps": stamps + 1e9,
        "odom": np.stack([3.0 + 0.25 * stamps, np.full(len(stamps), 7.0), 0 * stamps], axis=1),
        "ranges_mm": np.full((len(stamps), 90), 2000, dtype=np.uint16),
        "angle_min": -np.pi / 2,
        "angle_increment": np.pi / 90,
        "range_max": 12.0,
        "laser_in_base": np.array([0.1, 0.0, 0.5]),
    }
    np.savez(tmp_path / "drive.npz", **arrays)
    plain = {
        "robot": {"name": "trolley", "footprint": {"radius_m": 0.2}},
        "base": {"driver": "recording", "recording": {"file": "drive.npz"}},
        "folder": str(tmp_path),
    }
    return msgspec.convert(plain, RobotConfig)


def test_it_is_played_as_scans_and_odometry_from_zero(config: RobotConfig, tmp_path: Path) -> None:
    rig = Rig(config, tmp_path / "state")
    robots: list[Robot] = rig.lockstep.record(topics.ROBOT)
    scans = rig.lockstep.record(topics.SCAN)
    rig.run(4.0)
    assert rig.odometry[0].pose == Pose2D(0.0, 0.0, 0.0)
    assert rig.odometry[-1].pose.x == pytest.approx(1.0, abs=1e-6)
    assert len(rig.odometry) == pytest.approx(80, abs=2)
    stamps = [scan.stamp_ns / 1e9 for scan in scans]
    assert stamps == pytest.approx([i * 0.25 for i in range(1, 17) if not 4 < i < 8], abs=1e-6)
    assert floats_from_bytes(scans[-1].ranges) == pytest.approx(np.full(90, 2.0))
    assert rig.truths == []
    assert robots == [], "who it is was said at the start"
    rig.lockstep.close()


def test_commands_go_nowhere_and_base_says_so(config: RobotConfig, tmp_path: Path) -> None:
    rig = Rig(config, tmp_path / "state")
    rig.drive(1.0, 0.3)
    assert rig.driven[-1].twist.is_zero
    assert (rig.state.mode, rig.state.source) == ("ok", None)
    assert "recorded drive" in rig.state.message
    rig.lockstep.close()


def test_at_the_end_it_holds_the_last_state_and_says_so(
    config: RobotConfig, tmp_path: Path
) -> None:
    rig = Rig(config, tmp_path / "state")
    healths = rig.lockstep.record(topics.HEALTH, "base")
    scans = rig.lockstep.record(topics.SCAN)
    rig.run(10.0)
    assert rig.odometry[-1].pose.x == pytest.approx(1.0, abs=1e-6)
    assert rig.odometry[-1].twist.is_zero
    assert rig.odometry[-1].stamp_ns > 9_900_000_000
    assert scans[-1].stamp_ns > 9_000_000_000
    assert (healths[-1].state, "ended" in healths[-1].message) == ("ok", True)
    rig.lockstep.close()


def test_a_file_that_is_not_there_is_refused_by_its_key(config: RobotConfig) -> None:
    recording = RecordingConfig(file="nowhere.npz")
    base = msgspec.structs.replace(config.base, recording=recording)
    with pytest.raises(ConfigError, match=r"base\.recording.*nowhere\.npz"):
        BaseService(msgspec.structs.replace(config, base=base))


def test_without_a_file_the_key_is_named(config: RobotConfig) -> None:
    base = msgspec.structs.replace(config.base, recording=None)
    with pytest.raises(ConfigError, match=r"base\.recording"):
        BaseService(msgspec.structs.replace(config, base=base))


@pytest.mark.parametrize("name", ["freiburg-079.npz", "create3-rplidar-mac.npz"])
def test_real_recordings_play(recordings: Path, tmp_path: Path, name: str) -> None:
    plain = {
        "robot": {"name": "trolley", "footprint": {"radius_m": 0.2}},
        "base": {"driver": "recording", "recording": {"file": str(recordings / name)}},
    }
    rig = Rig(msgspec.convert(plain, RobotConfig), tmp_path / "state")
    scans = rig.lockstep.record(topics.SCAN)
    rig.run(20.0)
    assert len(scans) > 50
    assert len(rig.odometry) == pytest.approx(400, abs=5)
    rig.lockstep.close()
