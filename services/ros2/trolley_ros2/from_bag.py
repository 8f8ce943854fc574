"""What Trolley records of a drive, from the messages of a bag. Frames and units are the same."""

import math
from collections.abc import Iterable, Iterator
from typing import Any, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D, Twist2D, pose_from_quaternion
from trolley.messages import Odometry, Scan
from trolley.runtime import codec
from trolley_ros2 import cdr
from trolley_ros2.bag import Channel
from trolley_ros2.from_ros import BASE_FRAMES

TF_TYPES = (cdr.TF_MESSAGE, "tf/msg/tfMessage")
MAX_TILT_RAD = math.radians(15.0)
"""A lidar that is tilted further does not see a plane."""
LONGEST_LEAP_NS = 60_000_000_000
"""A stamp that runs ahead of the recorder's clock by more is wrong."""

Matrix = NDArray[np.float64]
Kind = TypeVar("Kind", Scan, Odometry)


class NotTaken(Exception):
    """Something of a bag cannot be used; the text says why."""


class Frames:
    """Which frame sits where in which, as the bag said first; frames that move are in it, too."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, Matrix]] = {}

    def add(self, message: Any) -> None:
        """Take in a TFMessage."""
        for one in message.transforms:
            child = frame_name(one.child_frame_id)
            if child not in self._parents:
                at, turned = one.transform.translation, one.transform.rotation
                self._parents[child] = (
                    frame_name(one.header.frame_id),
                    _matrix((at.x, at.y, at.z), (turned.x, turned.y, turned.z, turned.w)),
                )

    def mount(self, laser: str, base: str) -> Matrix:
        """base_T_laser (4, 4), else from the robot's other frame: they lie above each other.

        Raises:
            NotTaken: No chain of transforms leads there.
        """
        frame, chain, found = laser, np.eye(4), None
        seen: set[str] = set()
        while frame != base and frame in self._parents and frame not in seen:
            seen.add(frame)
            if is_base(frame):
                found = chain
            frame, link = self._parents[frame]
            chain = link @ chain
        if frame == base or (found is None and is_base(frame)):
            found = chain
        if found is None:
            raise NotTaken(
                f"no transform leads from {base} to {laser}; say where the lidar sits with --laser"
            )
        if not np.isfinite(found).all():
            raise NotTaken(f"the transform from {base} to {laser} holds numbers that are none")
        return found


def frame_name(text: str) -> str:
    """A frame as ROS 2 writes it."""
    return text.strip("/")


def is_base(frame: str) -> bool:
    """Whether a frame is the robot's body, in whatever namespace."""
    return frame.rpartition("/")[2] in BASE_FRAMES


def split_mount(base_T_laser: Matrix) -> tuple[Pose2D, float, bool]:
    """Where in the plane a lidar sits, how high [m], and whether it hangs upside down.

    Raises:
        NotTaken: It is tilted.
    """
    upright = float(np.clip(base_T_laser[2, 2], -1.0, 1.0))
    tilt = math.acos(abs(upright))
    if tilt > MAX_TILT_RAD:
        raise NotTaken(f"the lidar is tilted by {math.degrees(tilt):.0f} degrees")
    yaw = math.atan2(base_T_laser[1, 0], base_T_laser[0, 0])
    at = Pose2D(float(base_T_laser[0, 3]), float(base_T_laser[1, 3]), yaw)
    return at, float(base_T_laser[2, 3]), upright < 0.0


def scan_of(message: Any, *, is_inverted: bool = False) -> Scan:
    """A LaserScan as Trolley has it: counter-clockwise, no echo +inf, invalid 0 (REP-117).

    A lidar that turns clockwise, or hangs upside down, measures its last beam first: then
    `time_increment` is negative.

    Raises:
        NotTaken: Its numbers cannot be.
    """
    stamp_ns = stamp_of(message)
    first, step, delay_s = message.angle_min, message.angle_increment, message.time_increment
    ranges = np.asarray(message.ranges, dtype=np.float32)
    strengths = np.asarray(message.intensities, dtype=np.float32)
    numbers = (first, step, delay_s, message.range_min, message.range_max)
    if not all(map(math.isfinite, numbers)) or step == 0.0 or not len(ranges):
        raise NotTaken("scans without beams, or with angles or limits that are not numbers")
    if len(strengths) != len(ranges):
        strengths = strengths[:0]
    far, near = ranges > message.range_max, ~(ranges >= message.range_min)  # NaN is near
    ranges = np.where(far, np.float32(np.inf), np.where(near, np.float32(0.0), ranges))
    if is_inverted:
        first, step = -first, -step
    if step < 0.0:
        last = len(ranges) - 1
        first, step = first + last * step, -step
        stamp_ns, delay_s = stamp_ns + round(last * delay_s * 1e9), -delay_s
        ranges, strengths = ranges[::-1], strengths[::-1]
    return _checked(
        Scan(
            stamp_ns=stamp_ns,
            frame="laser",
            angle_min=first,
            angle_increment=step,
            time_increment=delay_s,
            range_min=max(0.0, message.range_min),
            range_max=message.range_max,
            ranges=memoryview(ranges.tobytes()),
            intensities=memoryview(strengths.tobytes()),
        )
    )


def odometry_of(message: Any) -> Odometry:
    """A nav_msgs/Odometry.

    Raises:
        NotTaken: It is no pose in the plane.
    """
    at, turned, speed = message.pose.pose.position, message.pose.pose.orientation, message.twist
    return _odometry(
        stamp_of(message),
        (at.x, at.y),
        (turned.x, turned.y, turned.z, turned.w),
        Twist2D(speed.twist.linear.x, speed.twist.linear.y, speed.twist.angular.z),
    )


def odometry_of_transform(one: Any, before: Odometry | None) -> Odometry:
    """A transform odom -> base_link; its speed is that since the one before.

    Raises:
        NotTaken: It is no pose in the plane.
    """
    at, turned, stamp_ns = one.transform.translation, one.transform.rotation, stamp_of(one)
    quaternion = (turned.x, turned.y, turned.z, turned.w)
    still = _odometry(stamp_ns, (at.x, at.y), quaternion, Twist2D(0.0, 0.0, 0.0))
    if before is None or stamp_ns <= before.stamp_ns:
        return still
    step = before.pose.inverse() @ still.pose
    rate = 1e9 / (stamp_ns - before.stamp_ns)
    return msgspec.structs.replace(
        still, twist=Twist2D(step.x * rate, step.y * rate, step.yaw * rate)
    )


def stamp_of(message: Any) -> int:
    """The stamp of a header [ns]."""
    stamp = message.header.stamp
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


class Stamps:
    """Lets pass stamps of one topic that grow, and do not leap away from the recorder's clock."""

    def __init__(self) -> None:
        self._last: tuple[int, int] | None = None

    def check(self, stamp_ns: int, at_ns: int) -> None:
        """Take in the next one.

        Raises:
            NotTaken: It cannot be.
        """
        if stamp_ns <= 0:
            raise NotTaken("without a stamp")
        if self._last is not None:
            passed_ns = stamp_ns - self._last[0]
            if passed_ns <= 0:
                raise NotTaken("stamped not later than the one before")
            if passed_ns - (at_ns - self._last[1]) > LONGEST_LEAP_NS:
                raise NotTaken("stamped far in the future")
        self._last = stamp_ns, at_ns


def is_tf(channel: Channel) -> bool:
    """Whether transforms are sent there."""
    return channel.type_name in TF_TYPES


def moving_base(transforms: Iterable[Any], odom: str) -> Iterator[Any]:
    """Those that say where the robot's body is in the odometry's frame."""
    for one in transforms:
        if frame_name(one.header.frame_id) == odom and is_base(frame_name(one.child_frame_id)):
            yield one


def _odometry(
    stamp_ns: int, at: tuple[float, float], quaternion: tuple[float, ...], twist: Twist2D
) -> Odometry:
    try:
        pose = pose_from_quaternion(*at, quaternion)
    except ValueError as error:
        raise NotTaken(str(error)) from error
    return _checked(Odometry(stamp_ns=stamp_ns, pose=pose, twist=twist))


def _checked(message: Kind) -> Kind:
    """A message that Trolley would take from the wire."""
    try:
        return codec.decode(type(message), codec.encode(message, "msgpack"))
    except (codec.BadPayload, ValueError) as error:
        raise NotTaken(str(error)) from error


def _matrix(at: tuple[float, ...], quaternion: tuple[float, ...]) -> Matrix:
    length = math.hypot(*quaternion)
    x, y, z, w = (value / length if length > 0.0 else math.nan for value in quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w), at[0]],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w), at[1]],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y), at[2]],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )
