"""Point-to-line alignment of a scan with surfels by Gauss-Newton steps."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trolley.geometry.kernels import solve_spd
from trolley.jit import kernel
from trolley.scan_matching.layout import AlignmentParams, Cloud, Surfels
from trolley.scan_matching.surfels import PARTNERS, nearest_surfel


class StepParams(NamedTuple):
    """Limits of a Gauss-Newton step. Set by hand."""

    max_shift: float = 0.3
    """Greatest shift of one step [m]."""
    max_turn: float = 0.15
    """Greatest turn of one step [rad]."""
    without_normal: float = 0.3
    """Weight of a point without a direction of its own: it may be on the other side of a corner."""


STEP = StepParams()


@kernel
def accumulate(
    out_hessian: NDArray[np.float64],
    out_gradient: NDArray[np.float64],
    out_count: NDArray[np.int64],
    surfels: Surfels,
    cloud: Cloud,
    pose: NDArray[np.float64],
    tuning: tuple[float, float, float],
) -> None:
    """Sum the normal equations of all points, for each keyframe that owns their surfels.

    Args:
        out_hessian: (k, 3, 3), overwritten; k = 1 sums over all keyframes.
        out_gradient: (k, 3), overwritten.
        out_count: (k,), overwritten: points with a partner.
        surfels: of the neighbourhood.
        cloud: the scan.
        pose: (3,) map_T_base.
        tuning: reach for partners [m], width of the weights [m], information of a point [1/m^2].
    """
    reach, width, gain = tuning
    out_hessian[:] = 0.0
    out_gradient[:] = 0.0
    out_count[:] = 0
    cos = math.cos(pose[2])
    sin = math.sin(pose[2])
    apart = out_count.size > 1
    for i in range(cloud.points.shape[0]):
        tx = cos * cloud.points[i, 0] - sin * cloud.points[i, 1]
        ty = sin * cloud.points[i, 0] + cos * cloud.points[i, 1]
        nx = cos * cloud.normals[i, 0] - sin * cloud.normals[i, 1]
        ny = sin * cloud.normals[i, 0] + cos * cloud.normals[i, 1]
        x = pose[0] + tx
        y = pose[1] + ty
        at = nearest_surfel(surfels, (x, y, nx, ny), reach, PARTNERS)
        if at < 0:
            continue
        mx = surfels.normal[at, 0]
        my = surfels.normal[at, 1]
        off = mx * (x - surfels.place[at, 0]) + my * (y - surfels.place[at, 1])
        robust = 1.0 / (1.0 + (off / width) * (off / width))
        weight = gain * robust * robust
        if nx == 0.0 and ny == 0.0:
            weight *= STEP.without_normal
        turn = my * tx - mx * ty
        k = surfels.owner[at] if apart else 0
        out_count[k] += 1
        out_gradient[k, 0] += weight * off * mx
        out_gradient[k, 1] += weight * off * my
        out_gradient[k, 2] += weight * off * turn
        out_hessian[k, 0, 0] += weight * mx * mx
        out_hessian[k, 1, 0] += weight * mx * my
        out_hessian[k, 1, 1] += weight * my * my
        out_hessian[k, 2, 0] += weight * turn * mx
        out_hessian[k, 2, 1] += weight * turn * my
        out_hessian[k, 2, 2] += weight * turn * turn
    for k in range(out_count.size):
        out_hessian[k, 0, 1] = out_hessian[k, 1, 0]
        out_hessian[k, 0, 2] = out_hessian[k, 2, 0]
        out_hessian[k, 1, 2] = out_hessian[k, 2, 1]


@kernel
def align(
    pose: NDArray[np.float64],
    out_information: NDArray[np.float64],
    surfels: Surfels,
    cloud: Cloud,
    prior: NDArray[np.float64],
    prior_information: NDArray[np.float64],
    params: AlignmentParams,
) -> int:
    """Move a pose to where the scan's points lie on the surfels and the prior agrees, too.

    Args:
        pose: (3,) map_T_base; overwritten by the result.
        out_information: (3, 3), overwritten: inverse covariance from the scan alone, in `map`.
        surfels: of the neighbourhood.
        cloud: the scan.
        prior: (3,) expected pose, e.g. from odometry.
        prior_information: (3, 3) its inverse covariance in `map`.
        params: see there.

    Returns:
        How many points have a partner in the end.

    Source:
        Censi, An ICP variant using a point-to-line metric (2008); Geman, McClure, Statistical
        methods for tomographic image reconstruction (1987), for the weights.
    """
    hessian = np.zeros((1, 3, 3))
    gradient = np.zeros((1, 3))
    count = np.zeros(1, np.int64)
    whole = np.zeros((3, 3))
    slope = np.zeros(3)
    delta = np.zeros(3)
    offset = np.zeros(3)
    reach = params.first_reach
    for _ in range(params.iterations):
        width = max(params.width, 0.3 * reach)
        accumulate(hessian, gradient, count, surfels, cloud, pose, (reach, width, params.gain))
        for a in range(3):
            offset[a] = pose[a] - prior[a]
        offset[2] -= 2.0 * math.pi * math.floor(offset[2] / (2.0 * math.pi) + 0.5)
        for a in range(3):
            slope[a] = gradient[0, a]
            for b in range(3):
                out_information[a, b] = hessian[0, a, b]
                whole[a, b] = hessian[0, a, b] + prior_information[a, b]
                slope[a] += prior_information[a, b] * offset[b]
        if not solve_spd(whole, slope, delta):
            break
        length = math.hypot(delta[0], delta[1])
        shrink = min(
            1.0, STEP.max_shift / max(length, 1e-9), STEP.max_turn / max(abs(delta[2]), 1e-9)
        )
        for a in range(3):
            pose[a] -= shrink * delta[a]
        if reach <= params.last_reach and length < 2e-4 and abs(delta[2]) < 5e-5:
            break
        reach = max(0.6 * reach, params.last_reach)
    return count[0]
