"""A base without encoders, and one whose wheels slip, through the whole service."""

from collections.abc import Callable
from typing import Any

import pytest

from trolley import codes, requests, topics
from trolley.messages import Health
from trolley_base.odometry.lidar_odometry import LidarOdometry
from trolley_base.service import BaseService
from trolley_base.simulation.simulated_hardware import SimulatedChassis
from trolley_base.world.faulty_wheels import BOTH, Trouble

from .conftest import REAL, Rig

THINGS = """
[[box]]
name = "chest"
x = -1.5
y = 1.2
length_m = 0.8
width_m = 0.5
"""


def rig_with(make_rig: Callable[..., Rig], source: str, trouble: Trouble, **more: Any) -> Rig:
    rig = make_rig(things=THINGS, errors=REAL, base={"odometry": {"source": source}}, **more)
    set_trouble(rig, trouble)
    return rig


def set_trouble(rig: Rig, trouble: Trouble) -> None:
    chassis = rig.base.hardware.chassis
    assert isinstance(chassis, SimulatedChassis)
    chassis.wheels.trouble = trouble


def test_a_base_without_encoders_knows_where_it_went(make_rig: Callable[..., Rig]) -> None:
    rig = rig_with(make_rig, "lidar", Trouble(stuck_encoders=BOTH))
    rig.run(1.0)
    rig.drive(3.0, 0.3)
    rig.drive(2.0, 0.0, 0.8)
    rig.drive(2.0, 0.2, -0.4)
    rig.run(1.0)
    known = rig.odometry[-1]
    assert rig.truth.pose.distance_to(known.pose) < 0.03
    assert rig.truth.pose.yaw == pytest.approx(known.pose.yaw, abs=0.02)
    assert known.twist.is_zero, "it stands, without the noise of the scans"
    assert not any(state.mode == "fault" for state in rig.states)
    seconds = (known.stamp_ns - rig.odometry[0].stamp_ns) * 1e-9
    assert 20.0 <= len(rig.odometry) / seconds <= 50.0


def test_what_a_scan_calls_is_compiled_before_the_run_begins(
    make_rig: Callable[..., Rig], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It took 8 s at the first scans, in which base neither decided nor told that it lives."""
    done: list[str] = []
    update, start = LidarOdometry.update, BaseService.start
    monkeypatch.setattr(LidarOdometry, "update", lambda *a: (done.append("scan"), update(*a))[1])
    monkeypatch.setattr(BaseService, "start", lambda base: (done.append("start"), start(base))[1])
    rig_with(make_rig, "lidar", Trouble())
    assert done.index("scan") < done.index("start")


def test_with_wheels_alone_such_a_base_would_not(make_rig: Callable[..., Rig]) -> None:
    rig = rig_with(make_rig, "wheels", Trouble(stuck_encoders=BOTH))
    rig.drive(1.0, 0.3)
    assert rig.odometry[-1].pose.x == 0.0


@pytest.mark.parametrize("trouble", [Trouble(goes_on=True), Trouble(dead_motors=BOTH)])
def test_without_encoders_the_lidar_tells_that_the_board_does_not_obey(
    make_rig: Callable[..., Rig], trouble: Trouble
) -> None:
    rig = rig_with(make_rig, "lidar", Trouble(stuck_encoders=BOTH))
    rig.drive(2.0, 0.3)
    set_trouble(rig, trouble)
    if trouble.goes_on:
        rig.lockstep.ask(requests.BASE_STOP)
        rig.run(1.5)
    else:
        rig.drive(2.0, 0.3)
    assert rig.state.reason == codes.DOES_NOT_OBEY


def test_a_stuck_robot_that_uses_both_says_so_and_does_not_drift(
    make_rig: Callable[..., Rig],
) -> None:
    rig = rig_with(make_rig, "both", Trouble())
    healths: list[Health] = rig.lockstep.record(topics.HEALTH, "base")
    rig.drive(1.0, 0.2)
    set_trouble(rig, Trouble(lifted=True))
    before = rig.odometry[-1].pose
    rig.drive(3.0, 0.2)
    assert rig.odometry[-1].pose.distance_to(before) < 0.1, "not 0.6 m"
    assert "stuck, or they slip" in healths[-1].message
