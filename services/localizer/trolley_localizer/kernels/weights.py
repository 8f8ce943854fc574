"""Score particles and single poses against the likelihood field."""

import math

import numpy as np
from numpy.typing import NDArray

from trolley.jit import kernel
from trolley_localizer.kernels.layout import Cloud, Points


@kernel
def score_particles(
    out_score: NDArray[np.float32],
    cloud: Cloud,
    points: Points,
    table: NDArray[np.uint16],
    index: NDArray[np.int32],
) -> None:
    """Sum the table under each particle's beam end points.

    Args:
        out_score: (particles,), overwritten: sum over the beams of 0 ... 65535.
        cloud: the particles.
        points: (beams,) end points in `base_link` [cells].
        table: (rows + 2, cols + 2) score of each cell, with a ring of one cell for "off the map".
        index: (beams,) scratch. Two phases keep the index arithmetic in vector registers.

    Source:
        Thrun, Burgard, Fox, Probabilistic Robotics (2005), table 6.3, as one look-up per beam.
    """
    one = np.float32(1.0)
    zero = np.float32(0.0)
    stride = np.int32(table.shape[1])
    last_row = np.float32(table.shape[0] - 1)
    last_col = np.float32(table.shape[1] - 1)
    flat = table.ravel()
    beams = points.x.size
    for i in range(cloud.x.size):
        cos = np.float32(math.cos(cloud.yaw[i]))
        sin = np.float32(math.sin(cloud.yaw[i]))
        # One cell on: the ring. From there on truncation is floor, since nothing is negative.
        x = cloud.x[i] + one
        y = cloud.y[i] + one
        for j in range(beams):
            col = x + cos * points.x[j] - sin * points.y[j]
            row = y + sin * points.x[j] + cos * points.y[j]
            col = min(max(col, zero), last_col)
            row = min(max(row, zero), last_row)
            index[j] = np.int32(row) * stride + np.int32(col)
        total = np.uint32(0)
        for j in range(beams):
            total += np.uint32(flat[np.uint32(index[j])])
        out_score[i] = np.float32(total)


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
