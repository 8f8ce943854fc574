"""The messages between a linorobot firmware and its host, as they lie in rosserial frames.

What a board announces of them is compared by md5, which ROS makes from a message's fields: another
md5 is another layout of bytes.

Source:
    linorobot, teensy/firmware/src/firmware.ino and lib/ros_lib (BSD).
"""

import math
import struct
from typing import NamedTuple

from trolley.config.hardware import Axis
from trolley.geometry import Twist2D
from trolley.messages import Imu

MOST_SPEED, MOST_TURN = 10.0, 50.0
"""Anything faster is not a robot but a broken message [m/s, rad/s]."""

Vector = tuple[float, float, float]


class Topic(NamedTuple):
    """A topic of the firmware.

    Attributes:
        name: of the topic.
        is_published: the board publishes it; else it subscribes to it.
        is_needed: without it there is no driving.
        type_name: of its messages.
        md5: of their definition.
    """

    name: str
    is_published: bool
    is_needed: bool
    type_name: str
    md5: str


RAW_VEL = Topic("raw_vel", True, True, "lino_msgs/Velocities", "0ee8ad4cb7809be2d5a0a76352fea86a")
RAW_IMU = Topic("raw_imu", True, False, "lino_msgs/Imu", "275110405f08e1b7c0c0f1aba3e19c67")
CMD_VEL = Topic("cmd_vel", False, True, "geometry_msgs/Twist", "9f195f881246fdfa2798d1d3eebca84a")
PID = Topic("pid", False, False, "lino_msgs/PID", "a559df187bdf63f426d5f304b6b28bb4")
TOPICS = (RAW_VEL, RAW_IMU, CMD_VEL, PID)


def encode_twist(twist: Twist2D) -> bytes:
    """Return `geometry_msgs/Twist`."""
    return struct.pack("<6d", twist.vx, twist.vy, 0.0, 0.0, 0.0, twist.wz)


def encode_pid(p: float, i: float, d: float) -> bytes:
    """Return `lino_msgs/PID`, which has d before i."""
    return struct.pack("<3f", p, d, i)


def parse_velocities(payload: bytes) -> Twist2D | None:
    """Read `lino_msgs/Velocities`; None if it is none or no speed that a robot can have."""
    if len(payload) != struct.calcsize("<3f"):
        return None
    twist = Twist2D(*struct.unpack("<3f", payload))
    # Comparisons with NaN are false.
    is_sane = twist.speed <= MOST_SPEED and abs(twist.wz) <= MOST_TURN
    return twist if is_sane else None


def parse_imu(payload: bytes, axes: tuple[Axis, Axis, Axis], stamp_ns: int) -> Imu | None:
    """Read `lino_msgs/Imu`, turned from the chip's axes into `base_link`.

    Args:
        payload: of the frame.
        axes: which axes of the chip point forward, left and up.
        stamp_ns: robot time of the measurement.

    Returns:
        None if it is none or not finite. The magnetic field is left out: motors bend it.
    """
    if len(payload) != struct.calcsize("<9d"):
        return None
    values = struct.unpack("<9d", payload)
    if not all(math.isfinite(value) for value in values[:6]):
        return None
    return Imu(
        stamp_ns=stamp_ns,
        linear_acceleration=turned(values[0:3], axes),
        angular_velocity=turned(values[3:6], axes),
    )


def turned(chip: tuple[float, ...], axes: tuple[Axis, Axis, Axis]) -> Vector:
    """Turn a vector from the chip's axes into `base_link`."""
    x, y, z = (
        -chip["xyz".index(axis[-1])] if axis.startswith("-") else chip["xyz".index(axis)]
        for axis in axes
    )
    return x, y, z
