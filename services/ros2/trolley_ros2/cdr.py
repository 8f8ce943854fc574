"""ROS 2's messages as bytes (CDR): by the library rosbags, which knows them without ROS."""

import struct
from typing import Any

from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore

from trolley_ros2.names import NO_HASH

LASER_SCAN = "sensor_msgs/msg/LaserScan"
ODOMETRY = "nav_msgs/msg/Odometry"
TF_MESSAGE = "tf2_msgs/msg/TFMessage"
OCCUPANCY_GRID = "nav_msgs/msg/OccupancyGrid"
POSE_WITH_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"
PATH = "nav_msgs/msg/Path"
POSE = "geometry_msgs/msg/PoseStamped"
TWIST = "geometry_msgs/msg/Twist"
TWIST_STAMPED = "geometry_msgs/msg/TwistStamped"

MAX_INPUT_BYTES = 4096
"""More than any message that is taken; most of them have less than 400 bytes."""

STORE: Any = get_typestore(Stores.ROS2_JAZZY)
"""What these messages consist of is the same from Humble to Lyrical; so is how they are written."""


class NotWritten(Exception):
    """A message holds what its fields cannot; the text says what."""


class NotRead(Exception):
    """Bytes are no message of this type; the text says why."""


def make(type_name: str, *fields: Any) -> Any:
    """A message of its fields, in their order."""
    return STORE.types[type_name](*fields)


def write(message: Any) -> bytes:
    """A message's bytes.

    Raises:
        NotWritten: A number is too large for its field.
    """
    try:
        return bytes(STORE.serialize_cdr(message, message.__msgtype__))
    except (SerdeError, struct.error, OverflowError, UnicodeEncodeError) as problem:
        raise NotWritten(str(problem)) from problem


def read(type_name: str, data: bytes) -> Any:
    """A message from its bytes.

    Raises:
        NotRead: It is none.
    """
    if len(data) > MAX_INPUT_BYTES:
        raise NotRead(f"{len(data)} bytes, {MAX_INPUT_BYTES} at most")
    try:
        return STORE.deserialize_cdr(data, type_name)
    except SerdeError as problem:
        raise NotRead(str(problem)) from problem


def type_hash(type_name: str, distro: str) -> str:
    """The hash of a type's definition (REP-2016), as that release of ROS 2 writes it."""
    return NO_HASH if distro == "humble" else STORE.hash_rihs01(type_name)
