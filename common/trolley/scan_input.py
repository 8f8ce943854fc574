"""A scan with the odometry that belongs to it, as algorithms take it."""

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D
from trolley.messages import Scan
from trolley.messages.types import floats_from_bytes


class Reject(Enum):
    """Why a scan gave no estimate."""

    OLD_STAMP = "the scan is not newer than the one before"
    BAD_ODOMETRY = "the odometry is not finite"
    BAD_GEOMETRY = "the scan's angles, ranges or mounting are not finite"


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

    @classmethod
    def of(cls, scan: Scan, base_T_laser: Pose2D, first: Pose2D, last: Pose2D) -> "ScanInput":
        """Join a message with odom_T_base at its first and its last beam."""
        return cls(
            stamp_ns=scan.stamp_ns,
            ranges=np.asarray(floats_from_bytes(scan.ranges), np.float32),
            angle_min=scan.angle_min,
            angle_increment=scan.angle_increment,
            range_min=scan.range_min,
            range_max=scan.range_max,
            base_T_laser=base_T_laser,
            odom_T_base=first,
            odom_T_base_end=last,
        )


def problem_of(scan: ScanInput, last_stamp_ns: int | None) -> Reject | None:
    """Say why a scan cannot be used; None if it can."""
    if last_stamp_ns is not None and scan.stamp_ns <= last_stamp_ns:
        return Reject.OLD_STAMP
    if not (scan.odom_T_base.is_finite() and scan.odom_T_base_end.is_finite()):
        return Reject.BAD_ODOMETRY
    numbers = (scan.angle_min, scan.angle_increment, scan.range_min, scan.range_max)
    if not (all(math.isfinite(n) for n in numbers) and scan.base_T_laser.is_finite()):
        return Reject.BAD_GEOMETRY
    return None
