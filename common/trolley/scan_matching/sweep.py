"""One scan and the odometry that belongs to it, as points in `base_link`."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trolley.deskewing import deskew, is_blind
from trolley.geometry import Pose2D, interpolate
from trolley.scan_matching import lines as kernels
from trolley.scan_matching.layout import Cloud
from trolley.scanning import FrontEndParams, ScanInput

SPACING_M = 0.025
"""Distance below which neighbouring points of a scan say the same [m]."""

FRONT_END = FrontEndParams(
    least_range_m=1e-3,
    usable_range_share=0.995,
    telling_range_m=0.4,
    min_telling_share=0.0,
)


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
    seen = deskew(scan, FRONT_END, max_range_m, is_still=is_still)
    points = np.column_stack([seen.ends.x[seen.echoes], seen.ends.y[seen.echoes]])
    beams = seen.echoes.astype(np.int32)
    count = beams.size
    laser = (interpolate(Pose2D.identity(), seen.motion, 0.5) @ scan.base_T_laser).as_array()[:2]
    normals = np.empty((count, 2))
    kernels.fit_normals(normals, points, beams, laser, scan.angle_increment)
    kept = np.empty(count, np.int64)
    kept = kept[: kernels.thin_points(kept, points, SPACING_M)]
    blind = is_blind(np.hypot(*(points[kept] - laser).T), FRONT_END)
    cloud = Cloud(points[kept], normals[kept])
    return Sweep(cloud, laser, blind)
