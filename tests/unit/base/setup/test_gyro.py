"""Which axis of a gyro points up."""

import math

import numpy as np
import pytest

from trolley.config.hardware import Axis, ChassisConfig
from trolley.geometry import Pose2D
from trolley.messages import Imu
from trolley_base.setup.geometry import Stretch
from trolley_base.setup.gyro import Gyro, find_gyro
from trolley_base.setup.record import Record, Stand

AXES: list[Axis] = ["x", "-x", "y", "-y", "z", "-z"]
BIAS = (0.02, -0.03, 0.01)
TURNS = (1.5, 1.5, -1.5, 1.5, -1.5, -1.5)


def turned(up: np.ndarray, scale: float) -> tuple[Record, list[Stretch]]:
    """A drive of turns by a gyro whose `up` (3,) points up."""
    record, parts, now_ns = Record(), [], 0

    def read(rate: float, seconds: float) -> None:
        nonlocal now_ns
        for _ in range(round(seconds * 50)):
            now_ns += 20_000_000
            x, y, z = (np.array(BIAS) + up * rate / scale).tolist()
            gravity = (0.0, 0.0, 9.8)
            imu = Imu(stamp_ns=now_ns, angular_velocity=(x, y, z), linear_acceleration=gravity)
            record.imu.append(imu)

    def stand() -> Stand:
        begun_ns = now_ns
        read(0.0, 1.0)
        pose = Pose2D.identity()
        record.stands.append(Stand(begun_ns, now_ns, pose, np.empty(0, np.float32)))
        return record.stands[-1]

    before = stand()
    for turn in TURNS:
        read(math.copysign(0.75, turn), 2.0)
        after = stand()
        span = before.middle_ns, after.middle_ns
        parts.append(Stretch(*span, slice(0, 0), Pose2D(0.0, 0.0, turn), 0.0, turn, False))
        before = after
    return record, parts


@pytest.mark.parametrize("axis", AXES)
def test_the_axis_that_points_up_is_found(axis: Axis) -> None:
    up = np.zeros(3)
    up["xyz".index(axis[-1])] = -1.0 if axis.startswith("-") else 1.0
    found = find_gyro(*turned(up, 1.02))
    assert isinstance(found, Gyro)
    assert found.up == axis
    assert found.scale.value == pytest.approx(1.02, abs=0.005)
    # What is written is a frame that a chip can have, and the axis is its third.
    axes = found.axes(("x", "y", "z"))
    ChassisConfig(imu_axes=axes)
    assert axes[2] == axis


def test_axes_that_are_turned_already_are_turned_on() -> None:
    found = find_gyro(*turned(np.array([0.0, 0.0, -1.0]), 1.0))
    assert isinstance(found, Gyro)
    axes = found.axes(("y", "-x", "z"))
    ChassisConfig(imu_axes=axes)
    assert axes[2] == "-z"
    assert axes[0] == "y"


def test_a_gyro_that_is_right_stays_as_it_is() -> None:
    found = find_gyro(*turned(np.array([0.0, 0.0, 1.0]), 1.0))
    assert isinstance(found, Gyro)
    assert found.axes(("y", "-x", "z")) == ("y", "-x", "z")


def test_a_gyro_that_cannot_be_used_is_said_to_be_so() -> None:
    for up, scale, words in (
        (np.zeros(3), 1.0, "does not turn"),
        (np.array([0.0, 0.7, 0.7]), 1.0, "askew"),
        (np.array([0.0, 0.0, 1.0]), 2.0, "range"),
    ):
        found = find_gyro(*turned(up, scale))
        assert isinstance(found, str)
        assert words in found


def test_a_robot_without_a_gyro_has_none() -> None:
    assert find_gyro(Record(), []) is None
