"""Plays a recorded drive behind the interfaces of the hardware.

The odometry is interpolated to 20 Hz and starts at zero; scans come when they came. Commands go
nowhere. At the end the robot stands, and its lidar goes on to see what it saw last.
"""

import dataclasses

import numpy as np

from trolley.geometry import Pose2D, Twist2D, interpolate, log_pose
from trolley.messages import Link
from trolley.messages.motion import CHASSIS
from trolley_base.drivers.interface import ChassisReading, LidarReading, LidarScan, MotionSample
from trolley_base.recording.recording import Recording

ODOMETRY_PERIOD_NS = 50_000_000


class RecordedChassis:
    """The wheels of a recorded drive: they report, and do not listen."""

    def __init__(self, recording: Recording, start_ns: int) -> None:
        self._recording = recording
        self._start_ns = start_ns
        self._elapsed_ns = 0
        self._read_ns = 0
        self._odom_T_base = self._odometry_at(0)

    def drive(self, twist: Twist2D) -> None:
        """Do nothing: what was driven cannot be changed."""

    def read(self) -> ChassisReading:
        """Hand over the motions since the last call, 20 a second."""
        motions: list[MotionSample] = []
        while self._read_ns + ODOMETRY_PERIOD_NS <= self._elapsed_ns:
            self._read_ns += ODOMETRY_PERIOD_NS
            odom_T_base = self._odometry_at(self._read_ns)
            # Who stands, stands exactly, without what rounding leaves of a pose and its inverse.
            is_standing = odom_T_base == self._odom_T_base
            previous_T_base = (
                Pose2D.identity() if is_standing else self._odom_T_base.inverse() @ odom_T_base
            )
            twist = log_pose(previous_T_base).scaled(1e9 / ODOMETRY_PERIOD_NS)
            motions.append(MotionSample(self._start_ns + self._read_ns, previous_T_base, twist))
            self._odom_T_base = odom_T_base
        return ChassisReading(tuple(motions), Link(name=CHASSIS, state="up"))

    def restart(self) -> bool:
        """There is no board to restart."""
        return False

    def advance(self, elapsed_ns: int) -> None:
        """Play up to this time since the recording began [ns]."""
        self._elapsed_ns = max(self._elapsed_ns, elapsed_ns)

    def _odometry_at(self, elapsed_ns: int) -> Pose2D:
        """Return the recorded pose at a time, interpolated; after the end the last one."""
        stamps_ns, odom = self._recording.odom_stamps_ns, self._recording.odom
        row = int(np.searchsorted(stamps_ns, elapsed_ns, side="right")) - 1
        if row >= len(stamps_ns) - 1:
            return Pose2D.from_array(odom[-1])
        fraction = (elapsed_ns - int(stamps_ns[row])) / int(stamps_ns[row + 1] - stamps_ns[row])
        return interpolate(Pose2D.from_array(odom[row]), Pose2D.from_array(odom[row + 1]), fraction)


class RecordedLidar:
    """The scanner of a recorded drive."""

    def __init__(self, recording: Recording, start_ns: int) -> None:
        self._recording = recording
        self._start_ns = start_ns
        self._elapsed_ns = -1
        self._read = 0
        # Robot time goes on after the end, and a lidar that falls silent would be a broken one.
        self._period_ns = int(np.median(np.diff(recording.stamps_ns)))

    def read(self) -> LidarReading:
        """Hand over the scans since the last call."""
        scans: list[LidarScan] = []
        while self._stamp_ns(self._read) <= self._elapsed_ns:
            scans.append(self._scan(self._read))
            self._read += 1
        return LidarReading(tuple(scans), Link(name="lidar", state="up"))

    def advance(self, elapsed_ns: int) -> None:
        """Play up to this time since the recording began [ns]."""
        self._elapsed_ns = max(self._elapsed_ns, elapsed_ns)

    def _stamp_ns(self, number: int) -> int:
        stamps_ns = self._recording.stamps_ns
        beyond = number - (len(stamps_ns) - 1)
        if beyond <= 0:
            return int(stamps_ns[number])
        return int(stamps_ns[-1]) + beyond * self._period_ns

    def _scan(self, number: int) -> LidarScan:
        scans = self._recording.scans
        return dataclasses.replace(
            scans[min(number, len(scans) - 1)], stamp_ns=self._start_ns + self._stamp_ns(number)
        )


class RecordedHardware:
    """A robot whose drive has been recorded.

    Args:
        recording: the drive.
        start_ns: robot time of its first row.
    """

    def __init__(self, recording: Recording, start_ns: int) -> None:
        self._start_ns = start_ns
        self._end_ns = start_ns + int(recording.stamps_ns[-1])
        self._now_ns = start_ns
        self._chassis = RecordedChassis(recording, start_ns)
        self._lidar = RecordedLidar(recording, start_ns)

    @property
    def chassis(self) -> RecordedChassis:
        """The wheels."""
        return self._chassis

    @property
    def lidar(self) -> RecordedLidar:
        """The scanner."""
        return self._lidar

    @property
    def has_ended(self) -> bool:
        """Whether all of the drive has been played."""
        return self._now_ns >= self._end_ns

    def advance(self, now_ns: int) -> None:
        """Play up to robot time `now_ns`."""
        self._now_ns = max(self._now_ns, now_ns)
        self._chassis.advance(now_ns - self._start_ns)
        self._lidar.advance(now_ns - self._start_ns)

    def close(self) -> None:
        """Let go of the recording."""
