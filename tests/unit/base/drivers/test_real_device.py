"""What a configuration of real devices must not say."""

import os
from pathlib import Path

import msgspec
import pytest

from trolley.config import ConfigError, RobotConfig
from trolley_base.drivers.real_device import RealDevice


def config_of(folder: Path, board: str, lidar: str) -> RobotConfig:
    plain = {
        "robot": {"name": "r", "footprint": {"radius_m": 0.2}},
        "base": {
            "driver": "hardware",
            "chassis": {"board": "linorobot", "port": board},
            "lidar": {"model": "ld19", "port": lidar},
        },
        "folder": str(folder),
    }
    return msgspec.convert(plain, RobotConfig)


def test_board_and_lidar_cannot_claim_one_port_by_whatever_name(tmp_path: Path) -> None:
    (tmp_path / "ttyUSB0").touch()
    os.symlink("ttyUSB0", tmp_path / "by-id")
    for lidar in ("ttyUSB0", "by-id", str(tmp_path / "ttyUSB0")):
        with pytest.raises(ConfigError, match="both name the port"):
            RealDevice(config_of(tmp_path, "ttyUSB0", lidar))
    assert RealDevice(config_of(tmp_path, "ttyUSB0", "ttyUSB1")).cannot_drive == ""
