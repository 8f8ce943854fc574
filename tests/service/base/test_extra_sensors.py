"""What an extra sensor sees stops the robot, as what the lidar sees does."""

import dataclasses
import math
from collections.abc import Callable

import numpy as np
import pytest

from trolley import codes, topics
from trolley.geometry import Twist2D
from trolley.messages import Scan, floats_to_bytes
from trolley_base.drivers import ChassisReading, Contact

from .conftest import MakeRig, Rig

LOW = {"scans": {"front": {"pose": {"x": 0.15, "y": 0.0, "yaw": 0.0}, "z_m": 0.1}}}
THING_X = 1.0
"""Where something low stands, which the lidar looks over [m]; the robot starts at 0."""


def camera(rig: Rig) -> Scan:
    """What a camera at the robot's front sees of it."""
    away = THING_X - rig.truth.pose.x - 0.15
    return Scan(
        stamp_ns=rig.now_ns,
        frame="front",
        angle_min=-0.4,
        angle_increment=0.1,
        time_increment=0.0,
        range_min=0.15,
        range_max=3.0,
        ranges=floats_to_bytes(
            np.array([math.inf] * 3 + [away if away > 0.15 else 0.0] * 3 + [math.inf] * 3)
        ),
    )


def drive(rig: Rig, seconds: float, sees: Callable[[Rig], Scan] | None, name: str) -> None:
    for _ in range(round(seconds * 10)):
        if sees is not None:
            rig.lockstep.publish(topics.EXTRA_SCAN, sees(rig), name)
        rig.send(Twist2D(0.3, 0.0, 0.0))
        rig.run(0.1)


def test_what_a_listed_sensor_sees_stops_the_robot(make_rig: MakeRig) -> None:
    rig = make_rig(base=LOW)
    drive(rig, 6.0, camera, "front")
    assert rig.truth.twist.is_zero
    gap = THING_X - rig.truth.pose.x - 0.15
    assert 0.04 < gap < 0.12
    assert rig.counters.get("scan/late", 0) == 0


@pytest.mark.parametrize("uses", [["mark"], None])
def test_one_that_is_not_listed_for_it_stops_nothing(
    make_rig: MakeRig, uses: list[str] | None
) -> None:
    listed = {} if uses is None else {"front": {"uses": uses}}
    rig = make_rig(base={"scans": listed})
    drive(rig, 5.0, camera, "front")
    assert rig.truth.pose.x > 1.1
    assert (rig.counters.get("scan/unlisted", 0) > 0) == (uses is None)


def test_a_sensor_that_falls_silent_is_named_and_what_it_saw_is_forgotten(
    make_rig: MakeRig,
) -> None:
    rig = make_rig(base=LOW)
    health = rig.lockstep.record(topics.HEALTH, "base")
    drive(rig, 3.0, camera, "front")
    stood = rig.truth.pose.x
    rig.run(2.0)
    assert "scan/front" in health[-1].message
    assert health[-1].state == "degraded"
    drive(rig, 4.0, None, "front")
    assert rig.truth.pose.x > stood + 0.3


def test_where_it_sits_is_published(make_rig: MakeRig) -> None:
    rig = make_rig(base=LOW)
    rig.restart()
    frames = rig.lockstep.record(topics.TF, "front")
    rig.restart()
    rig.run(0.2)
    assert (frames[-1].parent, frames[-1].pose.x, frames[-1].z) == ("base_link", 0.15, 0.1)


LOW_BOX = """
[[box]]
x = 0.6
y = 0.0
length_m = 0.2
width_m = 0.4
seen = false
"""
"""Its near side is at 0.5; the robot's front at 0.15."""


class Bumped:
    """The simulated chassis with a bumper in front, as a motor board reports it."""

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._chassis = rig.base.hardware.chassis
        self.is_hit = False
        self._read, self._chassis.read = self._chassis.read, self.read  # type: ignore[method-assign]

    def read(self) -> ChassisReading:
        reading = self._read()
        self.is_hit = bool(self._rig.truths) and self._rig.truth.clearance < 0.002
        felt = (FRONT,) if self.is_hit else ()
        alarms = (codes.BUMPER,) if self.is_hit else ()
        return dataclasses.replace(reading, contacts=(Contact("bumper", felt),), alarms=alarms)


FRONT = (-0.5, 0.5)


def bump_back_off_and_try_again(rig: Rig) -> float:
    """Return how near it came to the low box at the second try."""
    bumper = Bumped(rig)
    rig.drive(3.0, 0.2)
    assert bumper.is_hit
    assert rig.state.reason == codes.BUMPER
    rig.drive(1.5, -0.1)
    assert not bumper.is_hit
    backed_off = rig.truth.clearance
    assert backed_off > 0.08
    before = len(rig.truths)
    rig.drive(4.0, 0.2)
    return min(truth.clearance for truth in rig.truths[before:])


def test_a_thing_that_the_bumper_met_stops_the_robot_before_it_the_next_time(
    make_rig: MakeRig,
) -> None:
    listed = {"bumper": {"kept_s": 30.0}}
    rig = make_rig(things=LOW_BOX, base={"scans": listed})
    heard = rig.lockstep.record(topics.EXTRA_SCAN, "bumper")
    assert bump_back_off_and_try_again(rig) > 0.03
    assert rig.state.reason == codes.STOP_FIELD
    assert {scan.frame for scan in heard} == {"bumper"}
    assert rig.counters.get("scan/late", 0) == 0


def test_it_is_met_again_where_the_bumper_is_not_listed(make_rig: MakeRig) -> None:
    rig = make_rig(things=LOW_BOX)
    assert bump_back_off_and_try_again(rig) < 0.002
