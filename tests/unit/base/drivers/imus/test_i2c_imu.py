"""Inertial units over I2C: what they measure, and how they fail and come back."""

import errno
import math
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import smbus2
from msgspec import ValidationError, convert
from support.fake_i2c import (
    FakeBno055,
    FakeBno085,
    FakeIcm20948,
    FakeMpu6050,
    FakeSMBus,
    Motion,
)
from support.waiting import wait_until

from trolley import serial_diagnosis
from trolley.config import ConfigError, RobotConfig
from trolley.config.hardware import ImuConfig, LidarConfig
from trolley.messages import Imu
from trolley_base.drivers.imus import CHIPS
from trolley_base.drivers.imus.bus import LinuxBus
from trolley_base.drivers.imus.i2c_imu import I2cImu
from trolley_base.drivers.lidars import make_lidar
from trolley_base.drivers.real_device import RealDevice
from trolley_base.drivers.real_hardware import RealHardware

pytestmark = pytest.mark.drives

FAKES: dict[str, Callable[[Motion], Any]] = {
    "mpu6050": FakeMpu6050,
    "icm20948": FakeIcm20948,
    "bno055": FakeBno055,
    "bno085": FakeBno085,
}
PUSHED_UP = (0.4, -0.7, 9.7)


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("trolley_base.drivers.imus.i2c_imu.FIRST_PAUSE_S", 0.02)


@pytest.fixture
def bus(monkeypatch: pytest.MonkeyPatch) -> FakeSMBus:
    fake = FakeSMBus()
    monkeypatch.setattr(smbus2, "SMBus", fake.open)
    return fake


class Reader:
    """A unit that is running, and all that it has said."""

    def __init__(self, **config: Any) -> None:
        self.imu = I2cImu(convert(config, ImuConfig), LinuxBus)
        self.found: list[Imu] = []
        self.notes: list[str] = []
        self.counts: dict[str, int] = {}
        self.imu.start()

    def take(self) -> None:
        found, notes, counts = self.imu.take(lambda ns: ns)
        self.found += found
        self.notes += [note.text for note in notes]
        for name, count in counts.items():
            self.counts[name] = self.counts.get(name, 0) + count

    def until(self, is_so: Callable[[], bool]) -> None:
        """Go on taking until something is so."""

        def look() -> bool:
            self.take()
            return is_so()

        wait_until(look, self.told)

    def wait_for(self, number: int) -> list[Imu]:
        """Wait for so many readings more."""
        begin = len(self.found)
        self.until(lambda: len(self.found) >= begin + number)
        return self.found[begin:]

    def wait_for_note(self, part: str) -> None:
        self.until(lambda: any(part in note for note in self.notes))

    def told(self) -> str:
        return f"{self.notes[-3:]} {self.counts} {len(self.found)}"


@pytest.fixture
def read() -> Iterator[Callable[..., Reader]]:
    made: list[Reader] = []

    def make(**config: Any) -> Reader:
        made.append(Reader(**config))
        return made[-1]

    yield make
    for one in made:
        one.imu.close()


def plug(bus: FakeSMBus, chip: str) -> Motion:
    motion = Motion()
    bus.chips[CHIPS[chip].address] = FAKES[chip](motion)
    return motion


@pytest.mark.parametrize("chip", sorted(FAKES))
def test_a_chip_gives_rates_and_accelerations_in_the_robot_s_axes(
    bus: FakeSMBus, read: Callable[..., Reader], chip: str
) -> None:
    motion = plug(bus, chip)
    motion.rates, motion.accelerations = (0.1, -0.2, 1.5), PUSHED_UP
    reader = read(chip=chip, axes=["-y", "x", "z"])
    last = reader.wait_for(5)[-1]
    assert last.angular_velocity == pytest.approx((0.2, 0.1, 1.5), abs=0.004)
    assert last.linear_acceleration == pytest.approx((0.7, 0.4, 9.7), abs=0.03)
    stamps = [one.stamp_ns for one in reader.found]
    assert stamps == sorted(set(stamps))
    assert reader.counts.get("imu/lost", 0) == 0


@pytest.mark.parametrize("chip", sorted(FAKES))
def test_the_fastest_turn_of_a_robot_is_within_reach(
    bus: FakeSMBus, read: Callable[..., Reader], chip: str
) -> None:
    motion = plug(bus, chip)
    motion.rates = (0.0, 0.0, math.radians(-480.0))
    assert read(chip=chip).wait_for(3)[-1].angular_velocity[2] == pytest.approx(-8.378, abs=0.01)


@pytest.mark.parametrize("chip", sorted(FAKES))
def test_one_that_is_plugged_in_later_or_restarts_is_found(
    bus: FakeSMBus, read: Callable[..., Reader], chip: str
) -> None:
    reader = read(chip=chip)
    reader.wait_for_note("No answer from the")
    motion = plug(bus, chip)
    motion.rates = (0.0, 0.0, 0.5)
    reader.wait_for(3)
    # Its supply breaks down for a moment: as after power-up, it sleeps, or says so.
    fake = bus.chips[CHIPS[chip].address]
    (fake.reset if isinstance(fake, FakeBno085) else fake.power_up)()
    motion.is_frozen = True
    lost = reader.counts.get("imu/lost", 0)
    wait_until(lambda: (reader.take() and False) or reader.counts["imu/lost"] > lost, reader.told)
    motion.is_frozen = False
    assert reader.wait_for(3)[-1].angular_velocity[2] == pytest.approx(0.5, abs=0.01)


def test_a_read_that_fails_is_counted_and_costs_nothing_else(
    bus: FakeSMBus, read: Callable[..., Reader]
) -> None:
    plug(bus, "mpu6050")
    reader = read(chip="mpu6050")
    reader.wait_for(3)
    bus.failures = 3
    reader.wait_for(3)
    assert reader.counts["imu/errors"] == 3
    assert bus.num_opened == 1


@pytest.mark.parametrize(
    ("chip", "there", "told"),
    [
        ("mpu6050", "icm20948", "no MPU-6050"),
        ("icm20948", "mpu6050", "no ICM-20948"),
        ("bno055", "mpu6050", "no BNO055"),
        ("bno085", "mpu6050", "does not say who it is"),
    ],
)
def test_another_chip_is_not_taken_for_it(
    bus: FakeSMBus, read: Callable[..., Reader], chip: str, there: str, told: str
) -> None:
    bus.chips[CHIPS[chip].address] = FAKES[there](Motion())
    reader = read(chip=chip)
    reader.wait_for_note(told)
    assert not reader.found


def test_a_bus_that_is_not_there_is_said(bus: FakeSMBus, read: Callable[..., Reader]) -> None:
    read(chip="mpu6050", bus=7).wait_for_note("/dev/i2c-7 is not there: switch I2C on")


def test_a_service_that_may_not_use_the_bus_says_how_to_let_it(
    bus: FakeSMBus, read: Callable[..., Reader], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "self").mkdir()
    (tmp_path / "self" / "cgroup").write_text("0::/system.slice/trolley-base.service\n")
    monkeypatch.setattr(serial_diagnosis, "PROC", tmp_path)

    def refuse(*_: Any) -> None:
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(smbus2, "SMBus", refuse)
    read(chip="mpu6050").wait_for_note("`sudo systemctl edit trolley-base`")


def test_it_takes_the_place_of_the_board_s_unit(bus: FakeSMBus) -> None:
    plug(bus, "mpu6050").rates = (0.0, 0.0, 0.7)
    lidar = make_lidar(LidarConfig(model="ld19", port="/dev/null/none"))
    imu = I2cImu(ImuConfig(chip="mpu6050"), LinuxBus)
    now_ns = time.monotonic_ns()
    hardware = RealHardware(
        None,
        (lidar, "/dev/null/none"),
        now_ns,
        lambda ns: ns + 5,
        lambda call: None,
        lambda port, error: port,
        imu,
    )
    found: list[Imu] = []

    def read() -> bool:
        hardware.advance(time.monotonic_ns())
        reading = hardware.chassis.read()
        assert reading.link.state == "up", "a chip says nothing of the board"
        found.extend(reading.imu)
        return len(found) > 3

    wait_until(read, "readings come")
    hardware.close()
    hardware.close()
    assert found[-1].angular_velocity[2] == pytest.approx(0.7, abs=0.001)
    assert now_ns < found[0].stamp_ns < found[-1].stamp_ns < time.monotonic_ns()


def test_axes_are_checked() -> None:
    with pytest.raises(ValidationError, match="right-handed"):
        convert({"chip": "mpu6050", "axes": ["y", "x", "z"]}, ImuConfig)


def test_without_smbus2_it_is_said_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "smbus2", None)
    robot = {"name": "r", "footprint": {"radius_m": 0.2}}
    base = {"driver": "hardware", "lidar": {"model": "ld19", "port": "x"}}
    RealDevice(convert({"robot": robot, "base": base}, RobotConfig))
    base["imu"] = {"chip": "mpu6050"}
    with pytest.raises(ConfigError, match="trolley-robot\\[i2c\\]"):
        RealDevice(convert({"robot": robot, "base": base}, RobotConfig))
