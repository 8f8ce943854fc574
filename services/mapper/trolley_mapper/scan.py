"""One scan and the odometry that belongs to it, as points in `base_link`."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D, interpolate
from trolley.scan_input import ScanInput
from trolley_mapper.kernels import lines as kernels
from trolley_mapper.kernels.layout import Cloud

# Neighbouring points of a scan nearer to each other than this tell the same [m].
SPACING_M = 0.025
# Shorter beams end near any wall that the robot stands at: they tell little of where it is [m].
_TELLING_M = 0.4
# A scan with fewer telling points says nothing (a covered lidar).
_MIN_TELLING = 15


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """The echoes of a scan in `base_link` at its stamp, corrected for the motion during it.

    Attributes:
        cloud: the points, thinned where they lie close, with the directions of their surfaces.
        laser: (2,) where the laser was in the middle of the scan [m].
        is_blind: there is too little to compare.
    """

    cloud: Cloud
    laser: NDArray[np.float64]
    is_blind: bool


def read_sweep(scan: ScanInput, max_range_m: float, is_still: bool = False) -> Sweep:
    """Put the echoes of a scan up to `max_range_m` [m] into `base_link`.

    A robot that stood still during the scan, whatever its wheels did, is `is_still`.
    """
    ranges = np.require(scan.ranges, np.float32, ["C", "W"])
    points, beams = np.empty((ranges.size, 2)), np.empty(ranges.size, np.int32)
    motion = scan.odom_T_base.inverse() @ scan.odom_T_base_end
    motion = Pose2D.identity() if is_still else motion
    nearest = max(scan.range_min, 1e-3)
    # An echo at the very end of the reach is how some sensors say that there was none.
    farthest = min(0.995 * scan.range_max, max_range_m)
    count = kernels.project_scan(
        points,
        beams,
        ranges,
        np.array([scan.angle_min, scan.angle_increment]),
        np.array([nearest, farthest]),
        scan.base_T_laser.as_array(),
        motion.as_array(),
    )
    points, beams = points[:count], beams[:count]
    laser = (interpolate(Pose2D.identity(), motion, 0.5) @ scan.base_T_laser).as_array()[:2]
    normals = np.empty((count, 2))
    kernels.fit_normals(normals, points, beams, laser, scan.angle_increment)
    kept = np.empty(count, np.int64)
    kept = kept[: kernels.thin_points(kept, points, SPACING_M)]
    telling = np.count_nonzero(np.hypot(*(points[kept] - laser).T) > _TELLING_M)
    cloud = Cloud(points[kept], normals[kept])
    return Sweep(cloud, laser, bool(telling < _MIN_TELLING))
