"""What a configuration of real devices must not say."""

import math
import os
from pathlib import Path
from typing import Any

import msgspec
import pytest

from trolley.config import ConfigError, RobotConfig
from trolley_base.description import UNWATCHED_SPEED, limits_of
from trolley_base.drivers.real_device import RealDevice


def config_of(folder: Path, port: str, lidar: str, **chassis: Any) -> RobotConfig:
    plain = {
        "robot": {"name": "r", "footprint": {"radius_m": 0.2}},
        "base": {
            "driver": "hardware",
            "chassis": {"board": "linorobot", "port": port, **chassis},
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


@pytest.mark.parametrize(
    ("chassis", "watchdog_s", "speed"),
    [
        ({}, 0.4, 0.5),
        ({"board": "create2"}, math.inf, UNWATCHED_SPEED),
        ({"board": "linorobot2"}, math.inf, UNWATCHED_SPEED),
        ({"board": "linorobot2", "watchdog_s": 0.5}, 0.5, 0.5),
        ({"board": "create2", "watchdog_s": 0.4}, 0.4, 0.5),
        (
            {"board": "hoverboard", "settings": {"diameter_m": 0.165, "track_m": 0.34}},
            0.8,
            UNWATCHED_SPEED,
        ),
        ({"board": "waveshare_ugv", "settings": {"type": "ugv_beast"}}, 0.4, 0.5),
    ],
)
def test_a_board_that_drives_on_is_driven_slowly_unless_its_owner_knows_better(
    tmp_path: Path, chassis: dict[str, Any], watchdog_s: float, speed: float
) -> None:
    config = config_of(tmp_path, "ttyUSB0", "ttyUSB1", **chassis)
    device = RealDevice(config)
    assert device.watchdog_s == watchdog_s
    assert limits_of(config, device.watchdog_s).speed == speed


@pytest.mark.parametrize(
    ("chassis", "longest_s", "usual_s"),
    [
        ({}, 0.35, None),
        ({"delay_s": 0.2}, 0.2, 0.2),
        ({"delay_s": 0.2, "usual_delay_s": 0.05}, 0.2, 0.05),
        ({"usual_delay_s": 0.0}, 0.35, 0.0),
    ],
)
def test_brakes_reckon_with_the_longest_delay_and_the_planner_with_the_usual_one(
    tmp_path: Path, chassis: dict[str, Any], longest_s: float, usual_s: float | None
) -> None:
    device = RealDevice(config_of(tmp_path, "ttyUSB0", "ttyUSB1", **chassis))
    assert (device.delay_s, device.usual_delay_s) == (longest_s, usual_s)


def test_a_usual_delay_is_not_longer_than_the_longest(tmp_path: Path) -> None:
    with pytest.raises(msgspec.ValidationError, match="usual_delay_s is longer"):
        config_of(tmp_path, "ttyUSB0", "ttyUSB1", delay_s=0.1, usual_delay_s=0.2)
