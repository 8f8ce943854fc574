"""The two interfaces behind which all hardware lies: a chassis that drives, a lidar that sees.

Nothing here blocks. A driver of a serial device has a reader thread that only stores what arrives
and wakes base; `read` hands over what was stored since the last call. All stamps are robot time
[ns]: a real driver stamps at arrival with the clock that base gives it, a simulation or a
recording stamps by its own steps.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D, Twist2D
from trolley.messages import Battery, Imu, Link, Scan

CallSoon = Callable[[Callable[[], None]], None]
"""Calls a function on the service's thread, as soon as that is free."""


class DriverError(Exception):
    """A driver cannot start: one sentence that says what is wrong and what to do about it."""


@dataclass(frozen=True, slots=True)
class MotionSample:
    """What the wheels measured since the sample before.

    Attributes:
        stamp_ns: the end of the measured interval, robot time.
        previous_T_base: motion of `base_link` in the interval, given in `base_link` as it lay at
            the interval's start, as the wheels report it (slip and wrong scales included). A driver
            of a board that reports velocities integrates them along an arc.
        twist: velocity at `stamp_ns` as measured [m/s, rad/s].
    """

    stamp_ns: int
    previous_T_base: Pose2D
    twist: Twist2D


@dataclass(frozen=True, slots=True)
class Note:
    """What a device says for a person to read; base logs it, at most one of a kind in 5 s."""

    level: Literal["info", "warning", "error"]
    kind: str
    text: str


Sector = tuple[float, float]
"""Bearings in `base_link` from ... to, counter-clockwise [rad]."""


@dataclass(frozen=True, slots=True)
class Contact:
    """What a bumper, or a sensor that only says that something is there, feels now.

    Base makes echoes of it, just outside of the robot's outline.

    Attributes:
        name: of its table `[base.scans.NAME]`.
        sectors: where it feels something; () for nothing.
        beyond_m: how far outside of the outline that is.
    """

    name: str
    sectors: tuple[Sector, ...]
    beyond_m: float = 0.01


@dataclass(frozen=True, slots=True)
class ChassisReading:
    """Everything a chassis had to say since the last `read`, oldest first.

    Attributes:
        motions: measured motions; they join without gaps while the link is up.
        link: the connection to the board; while it is not `up` nothing may be driven.
        imu: inertial readings, turned into `base_link`; empty without such a sensor.
        battery: the newest charge, None if the board does not measure it.
        alarms: codes of `trolley.codes` that hold now, as `bumper`, `cliff` or `button`.
        notes: what the board or its driver has to say.
        counts: what happened since the last `read`, for the counters of `health/base`.
        num_jumps: how many motions the driver left out, since no robot can do them.
        contacts: what its bumpers and the like feel now, each one's state in every reading.
        ranges: what its range sensors measured; `frame` is the name of the table
            `[base.scans.NAME]`.
        is_gone: its port has gone or cannot be opened, whatever base itself may have missed.
    """

    motions: tuple[MotionSample, ...]
    link: Link
    imu: tuple[Imu, ...] = ()
    battery: Battery | None = None
    alarms: tuple[str, ...] = ()
    notes: tuple[Note, ...] = ()
    counts: Mapping[str, int] = field(default_factory=dict[str, int])
    num_jumps: int = 0
    contacts: tuple[Contact, ...] = ()
    ranges: tuple[Scan, ...] = ()
    is_gone: bool = False


class Chassis(Protocol):
    """Wheels, motors and whatever else sits on the motor board."""

    def drive(self, twist: Twist2D) -> None:
        """Drive with this velocity until the next call; the caller has limited it.

        The board itself must stop when no call comes for half a second.
        """
        ...

    def read(self) -> ChassisReading:
        """Hand over what was measured since the last call; never blocks."""
        ...

    def restart(self) -> bool:
        """Restart the board, whose motors then stand; False where that cannot be done."""
        ...


def _no_intensities() -> NDArray[np.float32]:
    return np.empty(0, dtype=np.float32)


def _none_silent() -> NDArray[np.bool_]:
    return np.empty(0, dtype=np.bool_)


@dataclass(frozen=True, slots=True, eq=False)
class LidarScan:
    """One revolution in the wire's grid: beam i at `angle_min + i * angle_increment`.

    Attributes:
        stamp_ns: robot time of beam 0.
        angle_min: direction of beam 0 in frame `laser` [rad].
        angle_increment: > 0 [rad]; a clockwise sensor's driver has sorted its beams.
        time_increment: beam i was measured at `stamp_ns` + i * this [s]; < 0 if clockwise.
        range_min: nearest distance that the sensor can measure [m].
        range_max: farthest [m].
        ranges: (beams,) float32 [m]; no echo = +inf, invalid = 0.
        intensities: (beams,) float32, or (0,) if the sensor has none.
        silent: (beams,) whether the sensor measured there and nothing came back, for one with which
            the robot may creep on there; else (0,).
    """

    stamp_ns: int
    angle_min: float
    angle_increment: float
    time_increment: float
    range_min: float
    range_max: float
    ranges: NDArray[np.float32]
    intensities: NDArray[np.float32] = field(default_factory=_no_intensities)
    silent: NDArray[np.bool_] = field(default_factory=_none_silent)


@dataclass(frozen=True, slots=True)
class LidarReading:
    """Revolutions that were completed since the last `read`, oldest first, and the link's state.

    `notes`, `counts` and `is_gone` are as in `ChassisReading`.
    """

    scans: tuple[LidarScan, ...]
    link: Link
    notes: tuple[Note, ...] = ()
    counts: Mapping[str, int] = field(default_factory=dict[str, int])
    is_gone: bool = False


class Lidar(Protocol):
    """A two-dimensional scanner."""

    def read(self) -> LidarReading:
        """Hand over the revolutions completed since the last call; never blocks."""
        ...


class Hardware(Protocol):
    """One robot's devices, opened together."""

    @property
    def chassis(self) -> Chassis:
        """The wheels."""
        ...

    @property
    def lidar(self) -> Lidar:
        """The scanner."""
        ...

    def advance(self, now_ns: int) -> None:
        """Bring the devices to robot time `now_ns`, which never goes back.

        A simulation steps its world so far, a recording plays so far; real devices, which need
        nobody to move their time, do nothing.
        """
        ...

    @property
    def has_ended(self) -> bool:
        """Whether a recording has been played to its end; always False for other devices."""
        ...

    def close(self) -> None:
        """Stop the wheels and let go of the devices; may be called more than once."""
        ...
