"""Score particles and single poses against the likelihood field."""

import math

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel
from trolley.scanning.deskew import Points
from trolley_localizer.kernels.elementary import sin_cos
from trolley_localizer.kernels.layout import Cloud

# End points are computed in whole blocks: those left over would run one by one.
_BLOCK = 32


@kernel
def score_particles(
    out_score: NDArray[np.int32],
    cloud: Cloud,
    points: Points,
    table: NDArray[np.uint16],
) -> None:
    """Sum the table under each particle's beam end points.

    Args:
        out_score: (particles,), overwritten: sum over the beams of 0 ... 65535.
        cloud: the particles.
        points: (beams,) end points in `base_link` [cells].
        table: (rows + 2, cols + 2) score of each cell, with a ring of one cell for "off the map".

    Source:
        Thrun, Burgard, Fox, Probabilistic Robotics (2005), table 6.3, as one look-up per beam.
    """
    beams = points.x.size
    padded = (beams + _BLOCK - 1) // _BLOCK * _BLOCK
    end_x = np.zeros(padded)
    end_y = np.zeros(padded)
    end_x[:beams] = points.x
    end_y[:beams] = points.y
    cos = np.empty(cloud.yaw.size)
    sin = np.empty(cloud.yaw.size)
    for i in range(cloud.yaw.size):
        sin[i], cos[i] = sin_cos(cloud.yaw[i])
    index = np.empty(padded, np.int32)
    whole = beams - beams % 4
    flat = table.ravel()
    stride = np.int32(table.shape[1])
    last_row = np.float64(table.shape[0] - 1)
    last_col = np.float64(table.shape[1] - 1)
    for i in range(cloud.x.size):
        # One cell on: the ring. From there on truncation is floor, since nothing is negative.
        x = cloud.x[i] + 1.0
        y = cloud.y[i] + 1.0
        c = cos[i]
        s = sin[i]
        # Two phases: here vector registers, below plain loads, by four so that they stay plain.
        for j in range(padded):
            col = min(max(x + c * end_x[j] - s * end_y[j], 0.0), last_col)
            row = min(max(y + s * end_x[j] + c * end_y[j], 0.0), last_row)
            index[j] = np.int32(row) * stride + np.int32(col)
        total = np.uint64(0)
        for first in range(0, whole, 4):
            for j in range(4):
                total += np.uint64(flat[np.uint32(index[first + j])])
        for j in range(whole, beams):
            total += np.uint64(flat[np.uint32(index[j])])
        out_score[i] = np.int32(total)


@kernel
def sample_field(field: NDArray[np.float32], x: float, y: float) -> float:
    """Interpolate a field between cell centres; off the map the value of the ring holds.

    Args:
        field: (rows + 2, cols + 2), with a ring of one cell.
        x: column [cells].
        y: row [cells].
    """
    col = min(max(x + 0.5, 0.0), field.shape[1] - 1.001)
    row = min(max(y + 0.5, 0.0), field.shape[0] - 1.001)
    c = int(col)
    r = int(row)
    fx = col - c
    fy = row - r
    low = field[r, c] + fx * (field[r, c + 1] - field[r, c])
    high = field[r + 1, c] + fx * (field[r + 1, c + 1] - field[r + 1, c])
    return low + fy * (high - low)


@kernel
def score_pose(
    field: NDArray[np.float32],
    points: Points,
    pose: NDArray[np.float64],
    sigma: float,
) -> float:
    """Return the mean robust score of one pose, 0 ... 1.

    Args:
        field: (rows + 2, cols + 2) distance to the nearest wall [cells].
        points: (n,) end points in `base_link` [cells].
        pose: (3,) x, y [cells], yaw [rad] in `grid`.
        sigma: distance at which a beam's score has fallen to 0.61 [cells].
    """
    cos = math.cos(pose[2])
    sin = math.sin(pose[2])
    scale = -0.5 / (sigma * sigma)
    total = 0.0
    for j in range(points.x.size):
        x = pose[0] + cos * points.x[j] - sin * points.y[j]
        y = pose[1] + sin * points.x[j] + cos * points.y[j]
        d = sample_field(field, x, y)
        total += math.exp(scale * d * d)
    return total / max(points.x.size, 1)
