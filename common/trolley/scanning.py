"""The front end of everything that estimates a pose: a scan, and the odometry that belongs to it.

assemble    wait for the odometry of the last beam, interpolate it at both ends of the scan
check       refuse old stamps and numbers that are not finite
gate        the motion since the scan before, unless the odometry jumped

What comes next, `trolley.deskewing`, is compiled.
"""

import math
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D, integrate_twist, interpolate
from trolley.messages import Odometry, Scan, Transform
from trolley.messages.types import floats_from_bytes

MAX_EXTRAPOLATION_S = 0.2
"""Odometry is carried on by its twist for at most this long [s]."""
MAX_WAIT_S = 0.1
"""A scan waits for the odometry of its last beam for at most this long [s, robot time]."""
REACH_M = 100.0
"""No lidar sits farther from the middle of its robot, and none drives farther during a scan: the
odometry was reset meanwhile [m]."""
_MOST_NS = 2.0**62
"""No scan takes longer, whatever it says: 146 years [ns]."""


@dataclass(frozen=True, slots=True)
class FrontEndParams:
    """What may differ between those who use scans. All values were set by hand."""

    least_range_m: float
    """Shorter ranges are invalid, whatever the sensor claims to measure [m]."""
    usable_range_share: float
    """Echoes beyond this share of the sensor's range count as none: some sensors say so."""
    telling_range_m: float
    """Shorter beams end at any wall that the robot stands at and tell little of where it is [m]."""
    min_telling_share: float
    """A scan of which a smaller share of the echoes is telling is blind (a covered lidar)."""
    min_telling: int = 15
    """A scan with fewer telling echoes is blind."""
    max_speed_mps: float = 4.0
    """No wheeled indoor robot is faster: more is a reset or a fault of the odometry [m/s]."""
    max_jump_m: float = 0.5
    """What the odometry may be off by between two scans, beside `max_speed_mps` [m]."""
    max_blind_s: float = 10.0
    """No robot drives on for longer without a scan [s]."""


class Reject(Enum):
    """Why a scan gave no estimate."""

    NO_LASER_MOUNTING = "it is not known where the lidar is mounted"
    NO_ODOMETRY = "there is no odometry for the time of the scan"
    OLD_STAMP = "the scan is not newer than the previous one"
    BAD_ODOMETRY = "the odometry is not finite, or leads out of reach during the scan"
    BAD_GEOMETRY = "the scan's angles, ranges or mounting are not finite, or out of reach"


@dataclass(frozen=True, slots=True, eq=False)
class ScanInput:
    """One revolution of the lidar and where the wheels were at its first and last beam."""

    stamp_ns: int
    """Robot time of beam 0 [ns]."""
    ranges: NDArray[np.float32]
    """(n,) [m]; no echo is +inf, invalid is 0. May be read-only."""
    angle_min: float
    """Direction of beam 0 in `laser` [rad]."""
    angle_increment: float
    """Direction from one beam to the next [rad]."""
    range_min: float
    """Nearest echo that the sensor can measure [m]."""
    range_max: float
    """Farthest echo that the sensor can measure [m]."""
    base_T_laser: Pose2D
    """Where the lidar is mounted."""
    odom_T_base: Pose2D
    """Odometry at the first beam."""
    odom_T_base_end: Pose2D
    """Odometry at the last beam, which is earlier for a lidar that turns clockwise."""

    @property
    def motion(self) -> Pose2D:
        """The motion of the base during the scan: its pose at the last beam, seen from beam 0."""
        return self.odom_T_base.inverse() @ self.odom_T_base_end


@dataclass(frozen=True, slots=True)
class Motion:
    """What the odometry says about the time between two scans."""

    step: Pose2D
    """From the pose at the earlier scan to the pose at the later one; identity after a jump."""
    elapsed_s: float
    """Robot time between them [s]."""
    is_jump: bool = False
    """No robot drives that fast: the odometry was reset, or is faulty."""


# Assemble.


class ScanAssembler:
    """Joins each scan with the odometry at its first and its last beam.

    The newest scan waits until the odometry of its last beam is there, or is overdue.
    """

    def __init__(self) -> None:
        self._waiting: Scan | None = None
        self._since_ns = 0
        self._replaced: list[Scan] = []

    @property
    def is_waiting(self) -> bool:
        """Whether a scan waits for its odometry."""
        return self._waiting is not None

    def add(self, scan: Scan, now_ns: int) -> None:
        """Let a scan wait from now on (local monotonic time); the one before waits no longer."""
        if self._waiting is not None:
            self._replaced.append(self._waiting)
        self._waiting, self._since_ns = scan, now_ns

    def take(
        self, odometry: Sequence[Odometry], laser: Transform | None, now_ns: int, rate: float
    ) -> list[ScanInput | Reject]:
        """Return the scans that need not wait any longer, oldest first, and why one is unusable.

        Args:
            odometry: the last seconds of it, oldest first.
            laser: where the lidar is mounted, if known.
            now_ns: local monotonic time.
            rate: of robot time to it.
        """
        due, self._replaced = self._replaced, []
        if self._waiting is not None and self._is_due(self._waiting, odometry, now_ns, rate):
            due.append(self._waiting)
            self._waiting = None
        return [assemble(scan, odometry, laser) for scan in due]

    def _is_due(self, scan: Scan, odometry: Sequence[Odometry], now_ns: int, rate: float) -> bool:
        waited_s = (now_ns - self._since_ns) * 1e-9 * rate
        return waited_s >= MAX_WAIT_S or is_covered(odometry, max(scan.stamp_ns, end_ns(scan)))

    def clear(self) -> None:
        """Drop the scan that waits."""
        self._waiting = None
        self._replaced = []


def assemble(
    scan: Scan, odometry: Sequence[Odometry], laser: Transform | None
) -> ScanInput | Reject:
    """Join a scan with the mounting of the lidar and the odometry at its ends."""
    if laser is None or laser.parent != "base_link":
        return Reject.NO_LASER_MOUNTING
    first, last = pose_at(odometry, scan.stamp_ns), pose_at(odometry, end_ns(scan))
    if first is None or last is None:
        return Reject.NO_ODOMETRY
    return ScanInput(
        stamp_ns=scan.stamp_ns,
        ranges=np.asarray(floats_from_bytes(scan.ranges), np.float32),
        angle_min=scan.angle_min,
        angle_increment=scan.angle_increment,
        range_min=scan.range_min,
        range_max=scan.range_max,
        base_T_laser=laser.pose,
        odom_T_base=first,
        odom_T_base_end=last,
    )


def pose_at(history: Sequence[Odometry], stamp_ns: int) -> Pose2D | None:
    """Return odom_T_base at a moment: interpolated along an arc, or carried on by the twist.

    Args:
        history: messages, oldest first.
        stamp_ns: robot time [ns].

    Returns:
        None if the history is empty or ends or begins too far from the moment.
    """
    if not history:
        return None
    index = bisect_left(history, stamp_ns, key=lambda message: message.stamp_ns)
    if 0 < index < len(history):
        before, after = history[index - 1], history[index]
        span_ns = after.stamp_ns - before.stamp_ns
        share = (stamp_ns - before.stamp_ns) / span_ns if span_ns > 0 else 1.0
        return interpolate(before.pose, after.pose, share)
    edge = history[0] if index == 0 else history[-1]
    away_s = (stamp_ns - edge.stamp_ns) * 1e-9
    if abs(away_s) > MAX_EXTRAPOLATION_S:
        return None
    return integrate_twist(edge.pose, edge.twist, away_s)


def is_covered(history: Sequence[Odometry], stamp_ns: int) -> bool:
    """Say whether odometry has arrived from a moment or later."""
    return bool(history) and history[-1].stamp_ns >= stamp_ns


def end_ns(scan: Scan) -> int:
    """Return robot time of a scan's last beam [ns]; earlier than the first's if clockwise."""
    beams = len(scan.ranges) // 4
    lasts_ns = max(beams - 1, 0) * scan.time_increment * 1e9
    return scan.stamp_ns + round(min(max(lasts_ns, -_MOST_NS), _MOST_NS))


# Check and gate.


def problem_of(scan: ScanInput, last_stamp_ns: int | None) -> Reject | None:
    """Say why a scan cannot be used; None if it can."""
    if last_stamp_ns is not None and scan.stamp_ns <= last_stamp_ns:
        return Reject.OLD_STAMP
    if not (scan.odom_T_base.is_finite() and scan.odom_T_base_end.is_finite()):
        return Reject.BAD_ODOMETRY
    if not _is_within_reach(scan.motion):
        return Reject.BAD_ODOMETRY
    numbers = (scan.angle_min, scan.angle_increment, scan.range_min, scan.range_max)
    if not (all(math.isfinite(n) for n in numbers) and scan.base_T_laser.is_finite()):
        return Reject.BAD_GEOMETRY
    return None if _is_within_reach(scan.base_T_laser) else Reject.BAD_GEOMETRY


def _is_within_reach(pose: Pose2D) -> bool:
    return math.hypot(pose.x, pose.y) <= REACH_M


def motion_since(before: ScanInput | None, scan: ScanInput, params: FrontEndParams) -> Motion:
    """Return the motion since the scan before, None if this is the first."""
    if before is None:
        return Motion(Pose2D.identity(), 0.0)
    step = before.odom_T_base.inverse() @ scan.odom_T_base
    elapsed_s = (scan.stamp_ns - before.stamp_ns) * 1e-9
    driven_s = min(elapsed_s, params.max_blind_s)
    if math.hypot(step.x, step.y) > params.max_jump_m + params.max_speed_mps * driven_s:
        return Motion(Pose2D.identity(), elapsed_s, is_jump=True)
    return Motion(step, elapsed_s)


class Points(NamedTuple):
    """Points in `base_link` at the scan's stamp.

    Attributes:
        x: (n,) float64, forward.
        y: (n,) float64, to the left.
    """

    x: NDArray[np.float64]
    y: NDArray[np.float64]
