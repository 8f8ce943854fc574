"""Scan-to-map alignment of one pose by Gauss-Newton steps on the distance field."""

import math

import numpy as np
from numpy.typing import NDArray

from trolley.geometry.kernels import solve_spd
from trolley.jit import kernel
from trolley.scanning.deskew import Points

_MAX_SHIFT = 2.0
_MAX_TURN = 0.1


@kernel
def _accumulate(
    hessian: NDArray[np.float64],
    gradient: NDArray[np.float64],
    field: NDArray[np.float32],
    points: Points,
    pose: NDArray[np.float64],
    sigma: float,
    gain: float,
) -> None:
    """Add the normal equations of all beams, weighted by Welsch's function of their distance."""
    cos = math.cos(pose[2])
    sin = math.sin(pose[2])
    scale = -0.5 / (sigma * sigma)
    last_row = field.shape[0] - 1.001
    last_col = field.shape[1] - 1.001
    for j in range(points.x.size):
        turned_x = cos * points.x[j] - sin * points.y[j]
        turned_y = sin * points.x[j] + cos * points.y[j]
        col = pose[0] + turned_x + 0.5
        row = pose[1] + turned_y + 0.5
        if not (0.0 <= col <= last_col and 0.0 <= row <= last_row):
            continue
        c = int(col)
        r = int(row)
        fx = col - c
        fy = row - r
        low = field[r, c] + fx * (field[r, c + 1] - field[r, c])
        high = field[r + 1, c] + fx * (field[r + 1, c + 1] - field[r + 1, c])
        d = low + fy * (high - low)
        gx = (1.0 - fy) * (field[r, c + 1] - field[r, c]) + fy * (
            field[r + 1, c + 1] - field[r + 1, c]
        )
        gy = high - low
        gyaw = gy * turned_x - gx * turned_y
        weight = gain * math.exp(scale * d * d)
        gradient[0] += weight * d * gx
        gradient[1] += weight * d * gy
        gradient[2] += weight * d * gyaw
        hessian[0, 0] += weight * gx * gx
        hessian[1, 0] += weight * gy * gx
        hessian[1, 1] += weight * gy * gy
        hessian[2, 0] += weight * gyaw * gx
        hessian[2, 1] += weight * gyaw * gy
        hessian[2, 2] += weight * gyaw * gyaw


@kernel
def refine_pose(
    pose: NDArray[np.float64],
    out_information: NDArray[np.float64],
    field: NDArray[np.float32],
    points: Points,
    prior: NDArray[np.float64],
    prior_information: NDArray[np.float64],
    tuning: NDArray[np.float64],
    iterations: int,
) -> None:
    """Move a pose to where beams and prior agree best.

    Minimises sum gain * rho(distance of end point to wall) + the prior's Mahalanobis distance.

    Args:
        pose: (3,) start x, y [cells], yaw [rad] in `grid`; overwritten by the result.
        out_information: (3, 3), overwritten: inverse covariance from the beams alone.
        field: (rows + 2, cols + 2) distance to the nearest wall [cells].
        points: (n,) end points in `base_link` [cells].
        prior: (3,) expected pose, e.g. from odometry.
        prior_information: (3, 3) its inverse covariance.
        tuning: (2,) width of Welsch's function [cells] and the information of one beam [1/cells^2].
        iterations: at most so many steps.

    Source:
        Biber, Strasser, The Normal Distributions Transform (2003), for the scheme; Dennis, Welsch,
        Techniques for nonlinear least squares and robust regression (1978), for the weights.
    """
    hessian = np.zeros((3, 3))
    gradient = np.zeros(3)
    delta = np.zeros(3)
    offset = np.zeros(3)
    for _ in range(iterations):
        hessian[:] = 0.0
        gradient[:] = 0.0
        _accumulate(hessian, gradient, field, points, pose, tuning[0], tuning[1])
        for a in range(3):
            offset[a] = pose[a] - prior[a]
            for b in range(a + 1):
                out_information[a, b] = hessian[a, b]
                out_information[b, a] = hessian[a, b]
        for a in range(3):
            for b in range(3):
                gradient[a] += prior_information[a, b] * offset[b]
                if b <= a:
                    hessian[a, b] += prior_information[a, b]
        if not solve_spd(hessian, gradient, delta):
            return
        length = math.hypot(delta[0], delta[1])
        shrink = min(1.0, _MAX_SHIFT / max(length, 1e-9), _MAX_TURN / max(abs(delta[2]), 1e-9))
        for a in range(3):
            pose[a] -= shrink * delta[a]
        if length < 1e-3 and abs(delta[2]) < 1e-5:
            return
