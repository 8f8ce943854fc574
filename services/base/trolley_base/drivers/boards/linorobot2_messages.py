"""The messages between a linorobot2 firmware and its host, as ROS 2 puts them into bytes.

CDR, little-endian, without the four bytes that DDS puts before it: each number lies at a multiple
of its size, counted from the message's start; a string is its length with a closing 0, and its
letters.

Source:
    linorobot2_hardware, firmware/; common_interfaces (Odometry.msg, Imu.msg, BatteryState.msg,
    Range.msg, Twist.msg); OMG CORBA 3.0, chapter 15.3.
"""

import math
import struct
from typing import Any, NamedTuple

from trolley.config.hardware import Axis
from trolley.geometry import Twist2D
from trolley.messages import Imu
from trolley_base.drivers.boards.lino_messages import MOST_SPEED, MOST_TURN, turned

ODOMETRY, IMU = "odom/unfiltered", "imu/data"
RAW_IMU = "imu/data_raw"
"""What a firmware with a magnetometer calls the same."""
BATTERY, ULTRASOUND, CMD_VEL = "battery", "ultrasound", "cmd_vel"
TYPES = {
    ODOMETRY: "nav_msgs::msg::dds_::Odometry_",
    IMU: "sensor_msgs::msg::dds_::Imu_",
    RAW_IMU: "sensor_msgs::msg::dds_::Imu_",
    BATTERY: "sensor_msgs::msg::dds_::BatteryState_",
    ULTRASOUND: "sensor_msgs::msg::dds_::Range_",
    CMD_VEL: "geometry_msgs::msg::dds_::Twist_",
}
"""What the topics carry."""
LONGEST_STRING = 256
MOST_RANGE_M = 50.0
POSE, POSE_WITH_COVARIANCE = 7, 7 + 36
"""How many numbers a pose is, and one with its covariance."""


class Odometry(NamedTuple):
    """When the board took it, by its clock [ns], and how fast it was."""

    stamp_ns: int
    twist: Twist2D


class Range(NamedTuple):
    """What a sonar measured.

    Attributes:
        stamp_ns: by the board's clock.
        cone_rad: whole angle of its cone.
        range_min: [m].
        range_max: [m].
        range_m: what it measured [m]; +inf for nothing within reach.
    """

    stamp_ns: int
    cone_rad: float
    range_min: float
    range_max: float
    range_m: float


class NoMessageError(ValueError):
    """These bytes are not such a message."""


def encode_twist(twist: Twist2D) -> bytes:
    """Return `geometry_msgs/Twist`."""
    return struct.pack("<6d", twist.vx, twist.vy, 0.0, 0.0, 0.0, twist.wz)


def parse_odometry(body: bytes) -> Odometry:
    """Read `nav_msgs/Odometry`; its pose is left out, which no firmware computes rightly.

    Raises:
        NoMessageError: it is none, or no speed that a robot can have.
    """
    stamp_ns, at = _header(body)
    at = _after_string(body, at)
    values = _doubles(body, at, POSE_WITH_COVARIANCE + 6)
    vx, vy, *_, wz = values[POSE_WITH_COVARIANCE:]
    twist = Twist2D(vx, vy, wz)
    # Comparisons with NaN are false.
    if not (twist.speed <= MOST_SPEED and abs(wz) <= MOST_TURN):
        raise NoMessageError("no robot is that fast")
    return Odometry(stamp_ns, twist)


def parse_imu(body: bytes, axes: tuple[Axis, Axis, Axis]) -> Imu:
    """Read `sensor_msgs/Imu`, turned from the chip's axes into `base_link`.

    Args:
        body: the message.
        axes: which axes of the chip point forward, left and up.

    Returns:
        Stamped with the board's clock.

    Raises:
        NoMessageError: it is none, or not finite.
    """
    stamp_ns, at = _header(body)
    values = _doubles(body, at, 4 + 9 + 3 + 9 + 3)
    rates, accelerations = values[13:16], values[25:28]
    if not all(math.isfinite(value) for value in (*rates, *accelerations)):
        raise NoMessageError("it holds what is no number")
    return Imu(
        stamp_ns=stamp_ns,
        linear_acceleration=turned(accelerations, axes),
        angular_velocity=turned(rates, axes),
    )


def parse_voltage(body: bytes) -> float:
    """Read the voltage of `sensor_msgs/BatteryState` [V].

    Raises:
        NoMessageError: it is none, or not finite.
    """
    _, at = _header(body)
    voltage = float(_unpack("<f", body, at + -at % 4)[0])
    if not math.isfinite(voltage):
        raise NoMessageError("it holds what is no number")
    return voltage


def parse_range(body: bytes) -> Range | None:
    """Read `sensor_msgs/Range`; None of a board without a sonar, which reports zeros.

    Raises:
        NoMessageError: it is none, or of no cone or reach that a sonar has.
    """
    stamp_ns, at = _header(body)
    at += 1  # the kind of radiation
    cone_rad, range_min, range_max, range_m = _unpack("<4f", body, at + -at % 4)
    if range_max == 0.0:
        return None
    # Comparisons with NaN are false.
    if not (0.0 < cone_rad < math.pi and 0.0 <= range_min < range_max <= MOST_RANGE_M):
        raise NoMessageError("no sonar is like that")
    return Range(stamp_ns, cone_rad, range_min, range_max, range_m)


def _header(body: bytes) -> tuple[int, int]:
    """Return a header's stamp [ns], and where it ends."""
    seconds, nanoseconds = _unpack("<iI", body, 0)
    return seconds * 1_000_000_000 + nanoseconds, _after_string(body, 8)


def _after_string(body: bytes, at: int) -> int:
    at += -at % 4
    (length,) = _unpack("<I", body, at)
    if length > LONGEST_STRING:
        raise NoMessageError("a name is too long")
    return at + 4 + length


def _doubles(body: bytes, at: int, count: int) -> tuple[float, ...]:
    return _unpack(f"<{count}d", body, at + -at % 8)


def _unpack(layout: str, body: bytes, at: int) -> tuple[Any, ...]:
    try:
        return struct.unpack_from(layout, body, at)
    except struct.error as error:
        raise NoMessageError("it is too short") from error
