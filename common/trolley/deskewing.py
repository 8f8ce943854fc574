"""Put the beams of a scan where they would be had the robot stood still at the scan's stamp."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.geometry import Pose2D, log_pose
from trolley.jit import kernel
from trolley.scanning import FrontEndParams, Points, ScanInput


@dataclass(frozen=True, slots=True, eq=False)
class DeskewedScan:
    """All beams of a scan in `base_link` at its stamp, in the unit of length that was asked for."""

    ends: Points
    """(n,) where each beam ended; zero where it has no echo."""
    starts: Points
    """(n,) where the laser was."""
    echoes: NDArray[np.int64]
    """(m,) indices of the beams with an echo."""
    motion: Pose2D
    """Motion of the base during the scan that was taken out."""


def deskew(
    scan: ScanInput,
    params: FrontEndParams,
    max_range_m: float,
    unit_m: float = 1.0,
    *,
    is_still: bool = False,
) -> DeskewedScan:
    """Project a scan into `base_link` at its stamp, corrected for the motion during the scan.

    Args:
        scan: as it was measured.
        params: which ranges are valid.
        max_range_m: farther echoes are left out [m].
        unit_m: unit of length of the result [m], such as the cell edge of a map.
        is_still: the robot stood still during the scan, whatever its wheels did.
    """
    ranges = np.array(scan.ranges, np.float32, order="C")  # writable, as the kernel has it
    count = ranges.size
    ends = Points(np.empty(count), np.empty(count))
    starts = Points(np.empty(count), np.empty(count))
    is_echo = np.empty(count, np.uint8)
    motion = Pose2D.identity() if is_still else scan.motion
    arc = log_pose(motion)
    nearest = max(scan.range_min, params.least_range_m)
    farthest = min(params.usable_range_share * scan.range_max, max_range_m)
    deskew_beams(
        ends,
        starts,
        is_echo,
        ranges,
        np.array([scan.angle_min, scan.angle_increment]),
        np.array([nearest, farthest, unit_m]),
        scan.base_T_laser.as_array(),
        np.array([arc.vx, arc.vy, arc.wz]),
    )
    return DeskewedScan(ends, starts, np.flatnonzero(is_echo), motion)


def is_blind(reach_m: NDArray[np.float32] | NDArray[np.float64], params: FrontEndParams) -> bool:
    """Say whether echoes at such distances (n,) are too few, or too near, to tell anything."""
    telling = int(np.count_nonzero(reach_m > params.telling_range_m))
    return is_too_little(telling, reach_m.size, params)


def is_too_little(telling: int, echoes: int, params: FrontEndParams) -> bool:
    """Say whether so many telling echoes of so many are too few to tell anything."""
    return telling < max(params.min_telling, params.min_telling_share * echoes)


@kernel
def deskew_beams(
    out_ends: Points,
    out_starts: Points,
    out_is_echo: NDArray[np.uint8],
    ranges: NDArray[np.float32],
    angles: NDArray[np.float64],
    limits: NDArray[np.float64],
    base_T_laser: NDArray[np.float64],
    arc: NDArray[np.float64],
) -> None:
    """Put the beams into `base_link` at the scan's stamp, corrected for the motion since.

    Args:
        out_ends: (n,) where the beams ended, overwritten; zero where there is no echo [unit].
        out_starts: (n,) where the laser was, overwritten [unit].
        out_is_echo: (n,), overwritten: 1 where the beam has an echo within the limits.
        ranges: (n,) [m]; NaN, infinite, zero and negative values are no echo.
        angles: (2,) angle of beam 0 and step [rad] in `laser`.
        limits: (3,) nearest and farthest echo to use [m], and the unit of the results [m].
        base_T_laser: (3,) x, y [m], yaw [rad].
        arc: (3,) velocity ahead, to the left and of turning with which the base gets from the stamp
            to the last beam [m, m, rad per scan]. On a straight line in place of the arc the middle
            of a scan would be up to a millimetre off towards one side, in each scan the same.
    """
    count = ranges.size
    scale = 1.0 / limits[2]
    for i in range(count):
        share = i / max(count - 1, 1)
        turned = share * arc[2]
        sin_half = math.sin(0.5 * turned)
        sin = 2.0 * sin_half * math.cos(0.5 * turned)
        cos = 1.0 - 2.0 * sin_half * sin_half
        along = share * sin / turned if turned != 0.0 else share
        aside = 2.0 * share * sin_half * sin_half / turned if turned != 0.0 else 0.0
        start_x = along * arc[0] - aside * arc[1] + cos * base_T_laser[0] - sin * base_T_laser[1]
        start_y = aside * arc[0] + along * arc[1] + sin * base_T_laser[0] + cos * base_T_laser[1]
        out_starts.x[i] = scale * start_x
        out_starts.y[i] = scale * start_y
        reach = np.float64(ranges[i])
        if not (limits[0] <= reach <= limits[1]):
            out_is_echo[i] = 0
            out_ends.x[i] = 0.0
            out_ends.y[i] = 0.0
            continue
        heading = turned + base_T_laser[2] + angles[0] + i * angles[1]
        out_is_echo[i] = 1
        out_ends.x[i] = scale * (start_x + reach * math.cos(heading))
        out_ends.y[i] = scale * (start_y + reach * math.sin(heading))
