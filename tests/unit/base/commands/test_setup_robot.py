"""The robot as setup opens it: what becomes of a device that fails while the robot stands."""

import itertools
import math
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from trolley.config import RobotConfig, load_config
from trolley.geometry import Twist2D
from trolley.messages import Link
from trolley_base.commands import setup_robot
from trolley_base.commands.setup_robot import OpenRobot
from trolley_base.drivers import LidarScan
from trolley_base.drivers.interface import ChassisReading, LidarReading
from trolley_base.setup.record import SetupRefused

IsUp = Callable[[int], bool]
"""Whether the lidar is heard at its n-th reading."""


class PretendDevice:
    """Board and lidar of metal; the lidar is heard when it is said to be."""

    cannot_drive = ""
    watchdog_s = 0.4
    is_up: IsUp

    def __init__(self, config: RobotConfig) -> None:
        self._readings = itertools.count()
        self.told: list[Twist2D] = []

    def open(self, *_: Any) -> SimpleNamespace:
        chassis = SimpleNamespace(read=self._read_chassis, drive=self.told.append)
        lidar = SimpleNamespace(read=self._read_lidar)
        return SimpleNamespace(
            hardware=SimpleNamespace(
                chassis=chassis, lidar=lidar, advance=lambda _ns: None, close=lambda: None
            )
        )

    def _read_chassis(self) -> ChassisReading:
        return ChassisReading(motions=(), link=Link(name="chassis", state="up", message=""))

    def _read_lidar(self) -> LidarReading:
        number = next(self._readings)
        if not type(self).is_up(number):
            return LidarReading((), Link(name="lidar", state="down", message="It is silent."))
        ranges = np.full(90, 2.0, np.float32)
        scan = LidarScan(number, -math.pi, math.radians(4.0), 0.0, 0.1, 8.0, ranges)
        return LidarReading((scan,), Link(name="lidar", state="up", message=""))


def opened(folder: Path, monkeypatch: pytest.MonkeyPatch, is_up: IsUp) -> OpenRobot:
    device = type("Device", (PretendDevice,), {"is_up": staticmethod(is_up)})
    monkeypatch.setattr(setup_robot, "RealDevice", device)
    monkeypatch.setattr(setup_robot, "STEADY_S", 0.0)
    written = folder / "robot.toml"
    written.write_text('[robot]\nname = "r"\nfootprint = { length_m = 0.3, width_m = 0.3 }\n')
    return OpenRobot(load_config(written))


def test_a_lidar_that_is_silent_for_a_moment_is_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = opened(tmp_path, monkeypatch, lambda number: not 4 <= number < 8)
    with robot.opened():
        assert len(robot.look(6)) == 6


def test_a_lidar_that_stays_silent_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = opened(tmp_path, monkeypatch, lambda number: number < 4)
    with robot.opened(), pytest.raises(SetupRefused, match="The lidar has failed: It is silent"):
        robot.look(6)
