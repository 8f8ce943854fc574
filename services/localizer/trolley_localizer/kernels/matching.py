"""Compare beams with the map: weigh particles, align one pose, classify each beam."""

import math

import numpy as np
from numpy.typing import NDArray

from trolley.geometry.kernels import solve_spd
from trolley.gridmap.kernels import interpolate
from trolley.jit import kernel, lean_kernel, loose_kernel
from trolley.scanning import Points
from trolley_localizer.kernels.elementary import sin_cos
from trolley_localizer.kernels.layout import Cloud, Lines

_BLOCK = 32
"""Number of end points computed at once; those left over would run one by one."""


@loose_kernel("contract")
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
        # One cell further: the ring. From there on truncation is floor, since nothing is negative.
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
    return interpolate(field, x + 0.5, y + 0.5)  # the ring shifts the cells by one


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


@kernel
def is_known_at(known: NDArray[np.uint8], row: float, col: float) -> bool:
    """Say whether the map knows what is at a place, counted in cells from its ring on."""
    is_inside = 0.0 <= row < known.shape[0] and 0.0 <= col < known.shape[1]
    return is_inside and known[int(row), int(col)] != 0


@kernel
def mark_known(
    out_is_known: NDArray[np.uint8],
    known: NDArray[np.uint8],
    points: Points,
    pose: NDArray[np.float64],
) -> int:
    """Mark the beams that end where the map knows what is there; returns how many.

    Args:
        out_is_known: (n,), overwritten.
        known: (rows + 2, cols + 2), with a ring of one cell.
        points: (n,) end points in `base_link` [cells].
        pose: (3,) x, y [cells], yaw [rad] in `grid`.
    """
    cos = math.cos(pose[2])
    sin = math.sin(pose[2])
    count = 0
    for j in range(points.x.size):
        col = pose[0] + cos * points.x[j] - sin * points.y[j] + 1.0
        row = pose[1] + sin * points.x[j] + cos * points.y[j] + 1.0
        out_is_known[j] = is_known_at(known, row, col)
        count += out_is_known[j]
    return count


EXPLAINED = 0
NOT_ON_MAP = 1
BEHIND_MIRROR = 2
SUSPECTED = 3
UNUSED = 4
"""Classes of beams; from BEHIND_MIRROR on a beam says nothing about the map."""


@kernel
def mark_crossing(
    out_class: NDArray[np.uint8],
    pose: NDArray[np.float64],
    end: Points,
    start: Points,
    lines: Lines,
    depth: float,
    mark: int,
) -> int:
    """Mark the beams that cross a line and end behind it, seen from a pose.

    Args:
        out_class: (n,) `mark` is written where a used beam meets a line.
        pose: (3,) x, y [cells], yaw [rad] in `grid`.
        end: (n,) end points in `base_link` [cells].
        start: (n,) where the laser was in `base_link` [cells].
        lines: mirrors and glass in `grid` [cells].
        depth: how far behind the line the end must lie [cells].
        mark: BEHIND_MIRROR or SUSPECTED.

    Returns:
        How many beams were marked.
    """
    cos = math.cos(pose[2])
    sin = math.sin(pose[2])
    marked = 0
    for i in range(end.x.size):
        if out_class[i] >= BEHIND_MIRROR:
            continue
        sx = pose[0] + cos * start.x[i] - sin * start.y[i]
        sy = pose[1] + sin * start.x[i] + cos * start.y[i]
        dx = pose[0] + cos * end.x[i] - sin * end.y[i] - sx
        dy = pose[1] + sin * end.x[i] + cos * end.y[i] - sy
        length = math.hypot(dx, dy)
        for k in range(lines.ax.size):
            ex = lines.bx[k] - lines.ax[k]
            ey = lines.by[k] - lines.ay[k]
            cross = dx * ey - dy * ex
            if abs(cross) < 1e-9:
                continue
            wx = lines.ax[k] - sx
            wy = lines.ay[k] - sy
            along_beam = (wx * ey - wy * ex) / cross
            along_line = (wx * dy - wy * dx) / cross
            if (
                along_beam > 0.0
                and 0.0 <= along_line <= 1.0
                and (1.0 - along_beam) * length >= depth
            ):
                out_class[i] = mark
                marked += 1
                break
    return marked


@kernel
def explain_beams(
    out_class: NDArray[np.uint8],
    pose: NDArray[np.float64],
    end: Points,
    field: NDArray[np.float32],
    near: float,
) -> tuple[int, int]:
    """Separate the beams that end at a wall of the map from those that do not.

    Args:
        out_class: (n,) EXPLAINED or NOT_ON_MAP is written where a beam is neither unused nor
            behind a mirror.
        pose: (3,) x, y [cells], yaw [rad] in `grid`.
        end: (n,) end points in `base_link` [cells].
        field: (rows + 2, cols + 2) distance to the nearest wall [cells].
        near: an end point within this distance of a wall is explained [cells].

    Returns:
        How many beams were explained, and how many were looked at.
    """
    cos = math.cos(pose[2])
    sin = math.sin(pose[2])
    explained = 0
    looked_at = 0
    for i in range(end.x.size):
        if out_class[i] >= BEHIND_MIRROR:
            continue
        x = pose[0] + cos * end.x[i] - sin * end.y[i]
        y = pose[1] + sin * end.x[i] + cos * end.y[i]
        looked_at += 1
        if sample_field(field, x, y) <= near:
            out_class[i] = EXPLAINED
            explained += 1
        else:
            out_class[i] = NOT_ON_MAP
    return explained, looked_at


@kernel
def first_wall(
    field: NDArray[np.float32], x: float, y: float, dx: float, dy: float, limit: float
) -> float:
    """Return the distance along a ray to the first wall of the map, infinite without one [cells].

    Args:
        field: (rows + 2, cols + 2) distance to the nearest wall [cells].
        x: where the ray begins [cells], `y` alike.
        y: see `x`.
        dx: its direction, a unit vector with `dy`.
        dy: see `dx`.
        limit: no farther than this [cells].
    """
    before = 0.0
    travelled = 0.5
    last_row = field.shape[0] - 1
    last_col = field.shape[1] - 1
    while travelled < limit:
        col = x + travelled * dx + 1.0
        row = y + travelled * dy + 1.0
        if not (0.0 <= col < last_col and 0.0 <= row < last_row):
            return math.inf
        free = np.float64(field[int(row), int(col)])
        if free < 0.5:
            # The border of the cell lies between the last two steps.
            for _ in range(5):
                middle = 0.5 * (before + travelled)
                if field[int(y + middle * dy + 1.0), int(x + middle * dx + 1.0)] < 0.5:
                    travelled = middle
                else:
                    before = middle
            return travelled
        before = travelled
        # Cell centres lie within 0.71 of any point of the cell: a shorter step cannot miss.
        travelled += max(free - 1.42, 0.5)
    return math.inf


@kernel
def expect_walls(
    out_x: NDArray[np.float64],
    out_y: NDArray[np.float64],
    out_lead: NDArray[np.float64],
    pose: NDArray[np.float64],
    end: Points,
    start: Points,
    field: NDArray[np.float32],
    limit: float,
) -> None:
    """Find where the map says that beams should have ended.

    Args:
        out_x: (n,) columns, overwritten; where the beam ended if the map has no wall there [cells].
        out_y: (n,) rows alike.
        out_lead: (n,) by how much each beam ended before its wall, negative behind it, overwritten;
            not a number where the map has no wall.
        pose: (3,) x, y [cells], yaw [rad] in `grid`.
        end: (n,) end points in `base_link` [cells].
        start: (n,) where the laser was in `base_link` [cells].
        field: (rows + 2, cols + 2) distance to the nearest wall [cells].
        limit: walls farther than this are not looked for [cells].
    """
    cos = math.cos(pose[2])
    sin = math.sin(pose[2])
    for i in range(end.x.size):
        dx = end.x[i] - start.x[i]
        dy = end.y[i] - start.y[i]
        length = math.hypot(dx, dy)
        heading = pose[2] + math.atan2(dy, dx)
        from_x = pose[0] + cos * start.x[i] - sin * start.y[i]
        from_y = pose[1] + sin * start.x[i] + cos * start.y[i]
        along_x, along_y = math.cos(heading), math.sin(heading)
        ahead = first_wall(field, from_x, from_y, along_x, along_y, limit)
        out_lead[i] = ahead - length if ahead < math.inf else math.nan
        reached = ahead if ahead < math.inf else length
        out_x[i] = from_x + reached * along_x
        out_y[i] = from_y + reached * along_y


@kernel
def count_through(
    pose: NDArray[np.float64],
    end: Points,
    start: Points,
    classes: NDArray[np.uint8],
    field: NDArray[np.float32],
    known: NDArray[np.uint8],
    margin: float,
    every: int,
) -> tuple[int, int, int, int]:
    """Count the beams that ought to have ended at a nearer wall of the map.

    Args:
        pose: (3,) x, y [cells], yaw [rad] in `grid`.
        end: (n,) end points in `base_link` [cells].
        start: (n,) where the laser was in `base_link` [cells].
        classes: (n,) EXPLAINED or NOT_ON_MAP; other beams are left out.
        field: (rows + 2, cols + 2) distance to the nearest wall [cells].
        known: (rows + 2, cols + 2) where the map knows what is there.
        margin: a wall within this distance of the end does not count [cells].
        every: only every n-th beam is looked at.

    Returns:
        How many went through a wall and end at one, on free floor, and where nothing is known; and
        how many were looked at.
    """
    cos = math.cos(pose[2])
    sin = math.sin(pose[2])
    through = 0
    astray = 0
    beyond = 0
    looked_at = 0
    for i in range(0, end.x.size, every):
        if classes[i] >= BEHIND_MIRROR:
            continue
        dx = end.x[i] - start.x[i]
        dy = end.y[i] - start.y[i]
        looked_at += 1
        length = math.hypot(dx, dy)
        heading = pose[2] + math.atan2(dy, dx)
        from_x = pose[0] + cos * start.x[i] - sin * start.y[i]
        from_y = pose[1] + sin * start.x[i] + cos * start.y[i]
        ahead = first_wall(
            field, from_x, from_y, math.cos(heading), math.sin(heading), length - margin
        )
        if ahead < math.inf:
            col = pose[0] + cos * end.x[i] - sin * end.y[i] + 1.0
            row = pose[1] + sin * end.x[i] + cos * end.y[i] + 1.0
            if classes[i] == EXPLAINED:
                through += 1
            elif is_known_at(known, row, col):
                astray += 1
            else:
                beyond += 1
    return through, astray, beyond, looked_at


_MAX_SHIFT = 2.0
"""Most that a Gauss-Newton step moves the pose [cells]."""
_MAX_TURN = 0.1
"""Most that a Gauss-Newton step turns the pose [rad]."""


@lean_kernel
def slope_at(field: NDArray[np.float32], x: float, y: float) -> tuple[float, float, float]:
    """Interpolate a field between cell centres, with its slopes along x and y; off the map all 0.

    Args:
        field: (rows + 2, cols + 2), with a ring of one cell.
        x: column [cells].
        y: row [cells].
    """
    col = x + 0.5
    row = y + 0.5
    if not (0.0 <= col <= field.shape[1] - 1.001 and 0.0 <= row <= field.shape[0] - 1.001):
        return 0.0, 0.0, 0.0
    c = int(col)
    r = int(row)
    fx = col - c
    fy = row - r
    low = field[r, c] + fx * (field[r, c + 1] - field[r, c])
    high = field[r + 1, c] + fx * (field[r + 1, c + 1] - field[r + 1, c])
    gx = (1.0 - fy) * (field[r, c + 1] - field[r, c]) + fy * (field[r + 1, c + 1] - field[r + 1, c])
    return low + fy * (high - low), gx, high - low


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
    for j in range(points.x.size):
        turned_x = cos * points.x[j] - sin * points.y[j]
        turned_y = sin * points.x[j] + cos * points.y[j]
        d, gx, gy = slope_at(field, pose[0] + turned_x, pose[1] + turned_y)
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
def gather_depth(
    out_hessian: NDArray[np.float64],
    out_gradient: NDArray[np.float64],
    field: NDArray[np.float32],
    points: Points,
    laser: tuple[float, float],
    pose: NDArray[np.float64],
    tuning: NDArray[np.float64],
) -> None:
    """Add the normal equations of pose and depth: by how much beams are longer.

    Args:
        out_hessian: (4, 4) of x, y, yaw, depth, added to; symmetric.
        out_gradient: (4,), added to.
        field: (rows + 2, cols + 2) distance to the nearest wall [cells].
        points: (n,) end points in `base_link` [cells].
        laser: x, y of the laser in `base_link` [cells].
        pose: (3,) x, y [cells], yaw [rad] in `grid`.
        tuning: as `refine_pose` has it.
    """
    cos = math.cos(pose[2])
    sin = math.sin(pose[2])
    scale = -0.5 / (tuning[0] * tuning[0])
    slope = np.empty(4)
    for j in range(points.x.size):
        turned_x = cos * points.x[j] - sin * points.y[j]
        turned_y = sin * points.x[j] + cos * points.y[j]
        d, slope[0], slope[1] = slope_at(field, pose[0] + turned_x, pose[1] + turned_y)
        slope[2] = slope[1] * turned_x - slope[0] * turned_y
        along_x = points.x[j] - laser[0]
        along_y = points.y[j] - laser[1]
        ahead_x = cos * along_x - sin * along_y
        ahead_y = sin * along_x + cos * along_y
        length = max(math.sqrt(along_x * along_x + along_y * along_y), 1.0)
        slope[3] = (slope[0] * ahead_x + slope[1] * ahead_y) / length
        weight = tuning[1] * math.exp(scale * d * d)
        for a in range(4):
            out_gradient[a] += weight * d * slope[a]
            for b in range(4):
                out_hessian[a, b] += weight * slope[a] * slope[b]


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
        iterations: maximum number of steps.

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
