"""The simulated world as hardware."""

from typing import TYPE_CHECKING

import pytest

from trolley.config.base import BatteryConfig
from trolley.config.robot import PoseConfig
from trolley.geometry import Pose2D, Twist2D
from trolley_base.simulation.simulated_hardware import SimulatedBattery, SimulatedHardware

if TYPE_CHECKING:
    from collections.abc import Callable

    from trolley_base.drivers import Hardware
    from trolley_base.world import Simulation

    MakeSimulation = Callable[..., Simulation]

START_NS = 5_000_000_000
MS = 1_000_000


@pytest.fixture
def hardware(simulate: "MakeSimulation") -> SimulatedHardware:
    return SimulatedHardware(simulate(), START_NS)


def test_it_is_hardware(hardware: SimulatedHardware) -> None:
    devices: Hardware = hardware
    devices.advance(START_NS)
    assert devices.chassis.read().link.state == "up"
    assert devices.lidar.read().link.state == "up"
    devices.close()
    devices.close()


def test_stamps_are_robot_time_and_motions_join(hardware: SimulatedHardware) -> None:
    odom_T_base, stamps = Pose2D.identity(), []
    for tick in range(1, 101):
        hardware.chassis.drive(Twist2D(0.3, 0.0, 0.5))
        hardware.advance(START_NS + 33 * tick * MS)
        for motion in hardware.chassis.read().motions:
            odom_T_base = odom_T_base @ motion.previous_T_base
            stamps.append(motion.stamp_ns)
    assert stamps == [START_NS + 20 * MS * n for n in range(1, len(stamps) + 1)]
    assert stamps[-1] <= hardware.truth().stamp_ns <= START_NS + 3300 * MS
    # Without errors the odometry is the truth, at the stamp of the newest report.
    while hardware.truth().stamp_ns % (20 * MS):
        hardware.advance(hardware.truth().stamp_ns + 10 * MS)
    for motion in hardware.chassis.read().motions:
        odom_T_base = odom_T_base @ motion.previous_T_base
    assert odom_T_base.distance_to(hardware.truth().pose) < 1e-9


def test_scans_come_once_they_are_complete(hardware: SimulatedHardware) -> None:
    hardware.advance(START_NS + 99 * MS)
    assert hardware.lidar.read().scans == ()
    hardware.advance(START_NS + 200 * MS)
    scans = hardware.lidar.read().scans
    assert [scan.stamp_ns for scan in scans] == [START_NS, START_NS + 100 * MS]
    assert hardware.lidar.read().scans == ()


def test_time_does_not_go_back(hardware: SimulatedHardware) -> None:
    hardware.advance(START_NS + 100 * MS)
    hardware.advance(START_NS)
    assert hardware.truth().stamp_ns == START_NS + 100 * MS


def test_without_commands_the_board_stops_by_itself(hardware: SimulatedHardware) -> None:
    hardware.chassis.drive(Twist2D(0.4, 0.0, 0.0))
    hardware.advance(START_NS + 500 * MS)
    assert hardware.truth().twist.vx == pytest.approx(0.4)
    hardware.advance(START_NS + 1000 * MS)
    assert hardware.truth().twist.is_zero


def test_close_stops_the_wheels(hardware: SimulatedHardware) -> None:
    hardware.chassis.drive(Twist2D(0.4, 0.0, 0.0))
    hardware.advance(START_NS + 400 * MS)
    hardware.close()
    hardware.advance(START_NS + 800 * MS)
    assert hardware.truth().twist.is_zero


def test_a_battery_empties_with_time_and_charges_at_its_charger() -> None:
    charger = PoseConfig(x=1.0, y=1.0, yaw=0.0)
    config = BatteryConfig(fraction=0.5, minutes=10.0, charger=charger)
    battery = SimulatedBattery(config)
    battery.step(Pose2D(5.0, 5.0, 0.0), 60_000 * MS)
    read = battery.read()
    assert (read.fraction, read.charging) == (pytest.approx(0.4), False)
    battery.step(Pose2D(1.2, 1.0, 3.0), 60_000 * MS)
    read = battery.read()
    assert (read.fraction, read.charging) == (pytest.approx(0.8), True)
    battery.step(Pose2D(1.2, 1.0, 3.0), 600_000 * MS)
    assert battery.read().fraction == 1.0
    battery.step(Pose2D(5.0, 5.0, 0.0), 60_000_000 * MS)
    assert battery.read().fraction == 0.0


def test_a_chassis_reports_its_battery_where_there_is_one(simulate: "MakeSimulation") -> None:
    assert SimulatedHardware(simulate(), START_NS).chassis.read().battery is None
    battery = SimulatedBattery(BatteryConfig(minutes=1.0))
    hardware = SimulatedHardware(simulate(), START_NS, battery=battery)
    hardware.advance(START_NS + 6_000 * MS)
    read = hardware.chassis.read().battery
    assert read is not None
    assert read.fraction == pytest.approx(0.9, abs=0.001)
