"""What is kept of a drive: what was commanded, what wheels and gyro said, where the robot stood."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D, Twist2D, log_pose
from trolley.messages import Imu
from trolley_base.drivers import MotionSample


class SetupRefused(Exception):
    """It cannot go on: one sentence that says what is wrong and what to do about it."""


SILENCE_S = 1.5
"""Longest silence of a device before the drive is ended [s]."""


def refuse_silence(what: str, heard_ns: int, now_ns: int) -> None:
    """Refuse to go on without a device.

    Args:
        what: the motor board or the lidar.
        heard_ns: robot time of the last that it said.
        now_ns: robot time.
    """
    if now_ns - heard_ns > SILENCE_S * 1e9:
        raise SetupRefused(f"The {what} has fallen silent.")


@dataclass(frozen=True, slots=True, eq=False)
class Stand:
    """Where the robot stood for a moment.

    Attributes:
        start_ns: robot time from which it stood.
        end_ns: the end of the last scan taken there.
        start_T_laser: where the lidar was, seen from where it was at the first stand. If the lidar
            turns the other way than its driver believes, all this is seen as in a mirror.
        ranges: (beams,) the usual range of each beam [m], inf or 0 where it mostly found nothing.
        is_plain: the walls in sight tell too little of where along them the lidar was.
    """

    start_ns: int
    end_ns: int
    start_T_laser: Pose2D
    ranges: NDArray[np.float32]
    is_plain: bool = False

    @property
    def middle_ns(self) -> int:
        """A moment at which it surely stood."""
        return (self.start_ns + self.end_ns) // 2


@dataclass(frozen=True, slots=True)
class Waypoint:
    """Where the lidar was at the stamp of a scan.

    Attributes:
        stamp_ns: robot time.
        start_T_laser: followed from scan to scan since the first, and never corrected: good for
            short ways only.
    """

    stamp_ns: int
    start_T_laser: Pose2D


@dataclass(frozen=True, slots=True)
class Command:
    """A velocity that was commanded from a robot time on."""

    stamp_ns: int
    twist: Twist2D


@dataclass(slots=True)
class Record:
    """A drive."""

    commands: list[Command] = field(default_factory=list[Command])
    """Changes of the command, oldest first."""
    motions: list[MotionSample] = field(default_factory=list[MotionSample])
    """As the board reports them."""
    imu: list[Imu] = field(default_factory=list[Imu])
    stands: list[Stand] = field(default_factory=list[Stand])
    waypoints: list[Waypoint] = field(default_factory=list[Waypoint])
    """Of each scan, standing or not."""

    @property
    def command(self) -> Twist2D:
        """The command now."""
        return self.commands[-1].twist if self.commands else Twist2D.zero()

    def told_since(self, stamp_ns: int) -> list[Twist2D]:
        """Return the commands since a robot time, and the one before, newest first."""
        found = [self.command]
        for command in reversed(self.commands):
            found.append(command.twist)
            if command.stamp_ns < stamp_ns:
                break
        return found

    def wheel_motions(self) -> "WheelMotions":
        """Return all that the wheels reported as arrays."""
        arcs = [log_pose(one.previous_T_base) for one in self.motions]
        return WheelMotions(
            np.array([one.stamp_ns for one in self.motions], np.int64),
            np.array([arc.vx for arc in arcs], np.float64),
            np.array([arc.wz for arc in arcs], np.float64),
        )


@dataclass(frozen=True, slots=True, eq=False)
class WheelMotions:
    """What the wheels reported.

    Attributes:
        stamps_ns: (n,) the end of each interval, robot time.
        way: (n,) distance driven in it, backwards negative [m].
        turn: (n,) angle turned in it, counter-clockwise [rad].
    """

    stamps_ns: NDArray[np.int64]
    way: NDArray[np.float64]
    turn: NDArray[np.float64]

    def split_at(self, stamps_ns: NDArray[np.int64]) -> "WheelMotions":
        """Return the same with further ends of intervals: speeds are constant within each."""
        first, last = self.stamps_ns[0], self.stamps_ns[-1]
        inside = stamps_ns[(stamps_ns > first) & (stamps_ns < last)]
        ends = np.union1d(self.stamps_ns, inside)

        def split(moved: NDArray[np.float64]) -> NDArray[np.float64]:
            return np.diff(np.interp(ends, self.stamps_ns, np.cumsum(moved)), prepend=0.0)

        return WheelMotions(ends, split(self.way), split(self.turn))

    def between(self, start_ns: int, end_ns: int) -> slice:
        """Return which of them lie between two moments."""
        first, last = np.searchsorted(self.stamps_ns, [start_ns, end_ns], side="right")
        return slice(int(first), int(last))
