import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trolley.geometry import Pose2D, Twist2D
from trolley_ros2 import cdr
from trolley_ros2.from_ros import Dropped, decoded, twist_of, where_of

TIME = cdr.make("builtin_interfaces/msg/Time", 1_700_000_000, 5)
RVIZ = [0.25, 0.0, 0.0, 0.25, 0.06853892326654787]
"""What rviz2 says of a pose that was drawn: variances of x and y, of yaw."""


def header(frame: str) -> object:
    return cdr.make("std_msgs/msg/Header", TIME, frame)


def twist(vx: float = 0.2, wz: float = 0.1, vz: float = 0.0) -> object:
    linear = cdr.make("geometry_msgs/msg/Vector3", vx, 0.0, vz)
    return cdr.make(cdr.TWIST, linear, cdr.make("geometry_msgs/msg/Vector3", 0.0, 0.0, wz))


def pose(x: float = 1.0, z: float = 0.0, w: float = 1.0, qx: float = 0.0) -> object:
    return cdr.make(
        "geometry_msgs/msg/Pose",
        cdr.make("geometry_msgs/msg/Point", x, 2.0, 0.0),
        cdr.make("geometry_msgs/msg/Quaternion", qx, 0.0, z, w),
    )


def estimate(covariance: object, frame: str = "map") -> object:
    inner = cdr.make("geometry_msgs/msg/PoseWithCovariance", pose(), covariance)
    return cdr.make(cdr.POSE_WITH_COVARIANCE, header(frame), inner)


def reason(message: Any) -> str:
    with pytest.raises(Dropped) as dropped:
        (twist_of if "Twist" in message.__msgtype__ else where_of)(message)
    return dropped.value.reason


def test_a_twist_is_a_velocity_in_the_plane() -> None:
    assert twist_of(twist()) == Twist2D(0.2, 0.0, 0.1)
    for frame in ("", "base_link", "/base_link", "base_footprint"):
        stamped = cdr.make(cdr.TWIST_STAMPED, header(frame), twist())
        assert twist_of(stamped) == Twist2D(0.2, 0.0, 0.1)


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
def test_a_twist_that_is_not_finite_is_dropped_whatever_part_it_is(number: float) -> None:
    assert reason(twist(vx=number)) == "not_finite"
    assert reason(twist(wz=number)) == "not_finite"
    assert reason(twist(vz=number)) == "not_finite"


def test_a_velocity_in_another_frame_is_dropped() -> None:
    assert reason(cdr.make(cdr.TWIST_STAMPED, header("odom"), twist())) == "frame"


def test_a_goal_is_a_pose_in_its_frame() -> None:
    where = where_of(cdr.make(cdr.POSE, header("map"), pose(z=1.0, w=0.0)))
    assert (where.frame, where.covariance) == ("map", None)
    assert where.pose == Pose2D(1.0, 2.0, math.pi)


def test_a_goal_without_frame_or_direction_or_that_is_not_finite_is_dropped() -> None:
    assert reason(cdr.make(cdr.POSE, header(""), pose())) == "frame"
    assert reason(cdr.make(cdr.POSE, header("map"), pose(w=0.0))) == "no_pose"
    assert reason(cdr.make(cdr.POSE, header("map"), pose(qx=0.5))) == "no_pose"
    assert reason(cdr.make(cdr.POSE, header("map"), pose(x=math.nan))) == "no_pose"


def test_the_covariance_of_a_drawn_pose_is_kept() -> None:
    covariance = np.zeros(36)
    covariance[[0, 1, 6, 7, 35]] = RVIZ
    assert where_of(estimate(covariance)).covariance == [
        0.25, 0.0, 0.0,
        0.0, 0.25, 0.0,
        0.0, 0.0, RVIZ[4],
    ]  # fmt: skip


@pytest.mark.parametrize("number", [0.0, -1.0, math.nan, math.inf, 1e308])
def test_a_covariance_that_is_none_says_nothing(number: float) -> None:
    assert where_of(estimate(np.full(36, number))).covariance is None


@given(st.binary(max_size=200), st.sampled_from([cdr.POSE, cdr.TWIST, cdr.TWIST_STAMPED]))
def test_any_bytes_are_read_or_dropped(data: bytes, type_name: str) -> None:
    try:
        message = decoded(type_name, b"\x00\x01\x00\x00" + data)
        (twist_of if "Twist" in type_name else where_of)(message)
    except Dropped as dropped:
        assert dropped.reason in ("malformed", "not_finite", "frame", "no_pose")  # noqa: PT017


def test_a_message_of_any_size_is_not_even_read() -> None:
    with pytest.raises(Dropped, match="4096 at most"):
        decoded(cdr.TWIST, bytes(1 << 20))
